"""An arm found in a model file: its joints from base to tool, with everything else locked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from reachlab.robots.derive.isolation import Isolation, apply, isolate
from reachlab.robots.derive.tool import find_tools
from reachlab.robots.files.gripper import SLIDES
from reachlab.robots.files.model_file import ModelFile
from reachlab.robots.files.picture_files import some
from reachlab.robots.kinematics.chain import Chain, chain_from_model, listed, moving_joints, path_joints, path_of
from reachlab.robots.kinematics.limits import LARGEST, is_limited

TURNS = 4 * np.pi
"""Two turns [rad]; an arm all of whose joints turn no more than so many degrees has limits in radians."""


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
    below = mujoco.mj_name2id(whole, mujoco.mjtObj.mjOBJ_BODY, base) if base else 0
    if below < 0:
        raise ValueError(f"base {base!r} is no body of the model, which has {listed(whole.body, whole.nbody)}")
    found = find_tools(whole, [name for name, joint in file.joints.items() if joint.mimics], below)
    notices = []
    if not tool:
        if not found:
            raise ValueError("nothing in it has a name that is moved by a joint: name a body or site, and say --tool")
        tool = found[0]
        if found[1:]:
            notices = [f"it has several arms; this one ends in {tool!r}, others in {', '.join(found[1:])}"]
    numbers = path_joints(whole, tool, below)
    _check_joints(file, whole, numbers)
    shorter = path_joints(whole, found[0], below) if found else []
    fingers = file.own.joints if file.own else [whole.joint(slide).id for slide in SLIDES] if file.mounted else ()
    notices += _notices(whole, numbers, shorter, fingers)
    if standing := _standing(whole, numbers[0]):
        notices.append(
            f"Solid things stand beside the arm: {some(standing)}. It may run into them, and tasks that judge contacts"
            " take them for its base, within capsules: thicker than what is flat."
        )
    if any((one ^ other).intersection(numbers) for one, other in _held_together(whole)):
        notices.append("Constraints that connect or weld the arm to something that stands are left out.")
    key = mujoco.mj_name2id(whole, mujoco.mjtObj.mjOBJ_KEY, "home")
    rest = whole.key_qpos[key] if key >= 0 else whole.qpos0
    if file.own:
        rest = rest.copy()
        rest[whole.jnt_qposadr[list(file.own.joints)]] = file.own.drive.closed
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


def _standing(model: mujoco.MjModel, first: int) -> list[str]:
    """Bodies with solid shapes that stand still and hold nothing of the arm with that first joint."""
    holding = path_of(model, int(model.body_parentid[model.jnt_bodyid[first]]))[1:]
    solid = (model.geom_contype | model.geom_conaffinity) > 0
    solid &= model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)
    still = [int(body) for body in np.unique(model.geom_bodyid[solid]) if not model.body_weldid[body]]
    return [str(model.body(body).name) for body in still if body not in holding]


def _check_joints(file: ModelFile, whole: mujoco.MjModel, numbers: list[int]) -> None:
    """Make sure that each joint of an arm moves by itself, and somewhere.

    Raises:
        ValueError: one does not.
    """
    for number in numbers:
        low, high = whole.jnt_range[number]
        if low >= high and (low or high):  # which MuJoCo takes as no limits
            raise ValueError(
                f"joint {whole.joint(number).name!r} has the position limits {low:g} to {high:g}: the upper one has to"
                " be the larger one"
            )
    for one, other in _held_together(whole):
        if (one - other) and (other - one) and (looped := (one ^ other).intersection(numbers)):
            names = " and ".join(repr(whole.joint(number).name) for number in sorted(looped))
            raise ValueError(
                f"an equality constraint closes a loop through the joint {names} of the arm, and every joint of a chain"
                " has to move by itself: choose a --tool before it"
            )
    for what, joints in _couplings(file, whole):
        coupled = joints.intersection(numbers)
        if len(coupled) > 1 or (coupled and coupled == joints):
            names = " and ".join(repr(whole.joint(number).name) for number in sorted(coupled))
            raise ValueError(
                f"{what} couples the joint {names} of the arm, and every joint of a chain has to move by itself: choose"
                " a --tool before it"
            )


def _couplings(file: ModelFile, model: mujoco.MjModel) -> Iterator[tuple[str, set[int]]]:
    """What couples several joints or holds one in place, and the numbers of these joints."""
    tendons = [_joints_of(model, tendon) for tendon in range(model.ntendon)]
    yield from ((f"tendon {model.tendon(i).name!r}", joints) for i, joints in enumerate(tendons) if len(joints) > 1)
    for i in np.flatnonzero(model.eq_active0):
        one, other = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        if model.eq_type[i] == int(mujoco.mjtEq.mjEQ_JOINT):
            yield "an equality constraint", {one}
        elif model.eq_type[i] == int(mujoco.mjtEq.mjEQ_TENDON):
            yield "an equality constraint", tendons[one] | (tendons[other] if other >= 0 else set())
    for name, fact in file.joints.items():
        if fact.mimics:
            yield f"its mimic of {fact.mimics!r}", {mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)}


def _held_together(model: mujoco.MjModel) -> Iterator[tuple[set[int], set[int]]]:
    """Joints that move each of two bodies which a constraint connects or welds."""
    kinds = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
    for i in np.flatnonzero(model.eq_active0):
        ends = [int(model.eq_obj1id[i]), int(model.eq_obj2id[i])]
        if model.eq_type[i] not in kinds:
            continue
        if model.eq_objtype[i] == int(mujoco.mjtObj.mjOBJ_SITE):
            ends = [int(model.site_bodyid[site]) for site in ends]
        yield moving_joints(model, ends[0]), moving_joints(model, ends[1])


def _joints_of(model: mujoco.MjModel, tendon: int) -> set[int]:
    """Numbers of the joints on which a fixed tendon acts."""
    wraps = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    fixed = model.wrap_type[wraps] == int(mujoco.mjtWrap.mjWRAP_JOINT)
    return set(model.wrap_objid[wraps][fixed].tolist())


def _notices(whole: mujoco.MjModel, numbers: list[int], shorter: list[int], gripper: Sequence[int]) -> list[str]:
    """Sentences on the joints of an arm, given the joints up to the tool frame that would be found by itself."""
    beyond = numbers[len(shorter) :] if shorter and numbers[: len(shorter)] == shorter else []
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    others = [
        joint for joint in range(whole.njnt) if joint not in (*numbers, *gripper) and whole.jnt_type[joint] != free
    ]
    absurd = [joint for joint in numbers if whole.jnt_limited[joint] and not is_limited(whole, joint)]
    hinges = [joint for joint in numbers if whole.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_HINGE)]
    narrow = np.ptp(whole.jnt_range[hinges], axis=1) < np.radians(TURNS)
    in_degrees = hinges if (narrow & whole.jnt_limited[hinges].astype(bool)).all() else []
    wide = [
        joint
        for joint in hinges
        if is_limited(whole, joint) and TURNS < np.abs(whole.jnt_range[joint]).max() <= LARGEST
    ]
    noted = {
        "Joints of the gripper that are joints of the arm here; a --tool before them leaves them out": beyond,
        "Joints that are not on the way to the tool are locked": others,
        f"Position limits beyond ±{LARGEST:g} rad or m are taken as none, so a turn or a metre either way (are they in"
        " degrees or millimetres?)": absurd,
        "Position limits of more than two turns either way, as degrees would be where radians are needed": wide,
        "All joints turn so little as if their limits were radians where the file has degrees, "
        'which an MJCF has without <compiler angle="radian"/>': in_degrees,
    }
    return [
        f"{what}: {some(whole.joint(joint).name or f'number {joint}' for joint in joints)}."
        for what, joints in noted.items()
        if joints
    ]
