"""An arm found in a model file: its joints from base to tool, with everything else locked."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from reachlab.robots.chain import Chain, chain_from_model, path_joints
from reachlab.robots.coupling import BY_ITSELF, check_uncoupled
from reachlab.robots.isolation import Isolation, apply, isolate
from reachlab.robots.joint_limits import LARGEST, is_limited
from reachlab.robots.model_file import ModelFile
from reachlab.robots.tool_frames import find_tool
from reachlab.robots.urdf import some


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
    found = find_tool(whole, [name for name, joint in file.joints.items() if joint.mimics], below)
    notices = []
    if not tool:
        tool = found.name
        if not tool:
            raise ValueError("nothing in it has a name that is moved by a joint: name a body or site, and say --tool")
        if found.others:
            notices = [f"it has several arms; this one ends in {tool!r}, others in {', '.join(found.others)}"]
    numbers = path_joints(whole, tool, below)
    _check_joints(file, whole, numbers)
    shorter = path_joints(whole, found.name, below) if found.name else []
    notices += _notices(whole, numbers, shorter)
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
        notices=tuple(notices),
    )


def _check_joints(file: ModelFile, whole: mujoco.MjModel, numbers: list[int]) -> None:
    """Make sure that each joint of an arm moves by itself, and somewhere."""
    for number in numbers:
        low, high = whole.jnt_range[number]
        if low >= high and (low or high):  # which MuJoCo takes as no limits
            raise ValueError(
                f"joint {whole.joint(number).name!r} has the position limits {low:g} to {high:g}: the upper one has to"
                " be the larger one"
            )
        fact = file.joints.get(str(whole.joint(number).name))
        if fact and fact.mimics:
            raise ValueError(
                f"joint {whole.joint(number).name!r} of the arm follows joint {fact.mimics!r}, {BY_ITSELF} it"
            )
    check_uncoupled(whole, numbers)


def _notices(whole: mujoco.MjModel, numbers: list[int], shorter: list[int]) -> list[str]:
    """Sentences on the joints of an arm, given the joints up to the tool frame that would be found by itself."""
    beyond = numbers[len(shorter) :] if shorter and numbers[: len(shorter)] == shorter else []
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    others = [joint for joint in range(whole.njnt) if joint not in numbers and whole.jnt_type[joint] != free]
    absurd = [joint for joint in numbers if whole.jnt_limited[joint] and not is_limited(whole, joint)]
    noted = {
        "Joints of the gripper that are joints of the arm here; a --tool before them leaves them out": beyond,
        "Joints that are not on the way to the tool are locked": others,
        f"Position limits beyond ±{LARGEST:g} rad or m are taken as none, so a turn or a metre either way": absurd,
    }
    return [
        f"{what}: {some(whole.joint(joint).name or f'number {joint}' for joint in joints)}."
        for what, joints in noted.items()
        if joints
    ]


def _body(model: mujoco.MjModel, name: str) -> int:
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if body < 0:
        names = ", ".join(model.body(i).name for i in range(1, model.nbody) if model.body(i).name)
        raise ValueError(f"base {name!r} is no body of the model, which has {names or '(none with a name)'}")
    return body
