"""An arm found in a model file: its joints from base to tool, with everything else locked."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from reachlab.robots.chain import Chain, chain_from_model, path_joints
from reachlab.robots.isolation import Isolation, apply, isolate
from reachlab.robots.model_file import ModelFile
from reachlab.robots.tool_frames import find_tool


@dataclass(frozen=True)
class Arm:
    """An arm in its file.

    Attributes:
        isolation: how it is cut out; without servos of ours.
        whole: the compiled file.
        model: the compiled arm alone; without pictures, as the file.
        chain: its joints.
        names: of the joints.
        tool: its tool frame.
        home: joints of the file's keyframe `home` `[n]`; None without one.
        notices: what was chosen, a sentence each.
    """

    isolation: Isolation
    whole: mujoco.MjModel
    model: mujoco.MjModel
    chain: Chain
    names: tuple[str, ...]
    tool: str
    home: tuple[float, ...] | None
    notices: tuple[str, ...]

    @property
    def tool_body(self) -> int:
        """Body of the arm that holds the tool frame, or is it."""
        site = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, self.tool)
        return int(self.model.site_bodyid[site]) if site >= 0 else int(self.model.body(self.tool).id)

    @property
    def base(self) -> np.ndarray:
        """Where the body stands that the first joint moves against, `[3]` m."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        return data.xpos[self.model.body_parentid[self.model.jnt_bodyid[0]]].copy()


def find_arm(file: ModelFile, tool: str | None, base: str | None) -> Arm:
    """The arm that ends in a tool frame, by default the one found, and begins at a body, by default the first.

    Raises:
        ValueError: there is no such frame or body, or no arm between them.
    """
    whole = file.spec(pictures=False).compile()
    below = _body(whole, base) if base else 0
    notices: tuple[str, ...] = ()
    if not tool:
        mimics = [name for name, joint in file.joints.items() if joint.mimics]
        found = find_tool(whole, mimics, below)
        tool = found.name
        if not tool:
            raise ValueError("nothing in it has a name that is moved by a joint: name a body or site, and say --tool")
        if found.others:
            notices = (f"it has several arms; this one ends in {tool!r}, others in {', '.join(found.others)}",)
    numbers = path_joints(whole, tool, below)
    for number in numbers:
        fact = file.joints.get(str(whole.joint(number).name))
        if fact and fact.mimics:
            raise ValueError(
                f"joint {whole.joint(number).name!r} of the arm follows joint {fact.mimics!r}, and every joint of a"
                " chain has to move by itself: choose a --tool before it"
            )
    key = mujoco.mj_name2id(whole, mujoco.mjtObj.mjOBJ_KEY, "home")
    rest = whole.key_qpos[key] if key >= 0 else whole.qpos0
    isolation = isolate(whole, numbers, rest)
    spec = file.spec(pictures=False)
    apply(spec, isolation)
    model = spec.compile()
    return Arm(
        isolation=isolation,
        whole=whole,
        model=model,
        chain=chain_from_model(model, tool),
        names=tuple(str(model.joint(joint).name) for joint in range(model.njnt)),
        tool=tool,
        home=tuple(float(rest[whole.jnt_qposadr[number]]) for number in numbers) if key >= 0 else None,
        notices=notices,
    )


def _body(model: mujoco.MjModel, name: str) -> int:
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if body < 0:
        names = ", ".join(model.body(i).name for i in range(1, model.nbody) if model.body(i).name)
        raise ValueError(f"base {name!r} is no body of the model, which has {names or '(none with a name)'}")
    return body
