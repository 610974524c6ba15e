"""Loading of robots: from the catalogue, or from a model file of one's own."""

from __future__ import annotations

import functools
import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.robots.catalogue import ROBOTS, KnownRobot, find_model_file
from reachlab.robots.derive.arm import Arm, find_arm
from reachlab.robots.derive.gripper import GRIPPED, UnrecognisedError, driven, mounted_gripper, own_gripper
from reachlab.robots.derive.servos import LAG, Loads, default_torques, find_loads, payload, servos, too_heavy, too_weak
from reachlab.robots.derive.workspace import Derived, derive, orientation
from reachlab.robots.files.gripper import GRASP, SLIDES
from reachlab.robots.files.model_file import ModelFile, with_gripper, with_own_gripper
from reachlab.robots.files.picture_files import some
from reachlab.robots.files.urdf import JointFacts
from reachlab.robots.kinematics.limits import is_limited, own_servos, speed_limits, torque_limits
from reachlab.robots.robot import CATALOGUE, DEFAULT, DERIVED, FILE, JERK_RATE, RAMP_RATE, Robot
from reachlab.robots.shapes.self_contact import untouching
from reachlab.settings.arguments import typed
from reachlab.settings.cache import kept
from reachlab.settings.validation import InputError

DEFAULT_SPEED = 1.5
"""Joint speed limit where none is known [rad/s or m/s]; slow for an industrial arm."""

FLANGE = "flange"
"""Kind of the tool frame at which a gripper is mounted."""

OWN = "own"
"""The gripper in the file; for most arms of the catalogue it is one that is mounted."""

SHORTAGES = {
    too_weak: f"Joints follow fast commands later than {LAG:g} s where the torque limit is less than what gravity,"
    " friction and damping take at full speed",
    too_heavy: f"Joints overshoot where the torque limit is less than what stops them from full speed within {LAG:g} s",
}
"""What becomes of joints whose torque limit is less than what they need, by what finds them."""

logger = logging.getLogger(__name__)

FAST = 50.0
"""Speed limit of a hinge that seems to be in degrees [rad/s]: joints of arms turn by a tenth of it."""

HUGE = 10.0
"""Size of a workspace, in those of the tutorial's arm, of which lengths seem to be in millimetres."""

PARALLEL = "parallel"
"""The gripper that is mounted where a file has none."""

VERSION = 9
"""Of the derivation of home and boxes: what an older one left in the cache is derived again."""


@typed
def load_robot(
    name: str | Path,
    tool: str | None = None,
    *,
    kind: str | None = None,
    base: str | None = None,
    packages: Sequence[str] = (),
    gripper: str = "",
    grips: bool = False,
) -> Robot:
    """Robot of the catalogue, or of an MJCF (.xml) or URDF (.urdf) file, with a tool frame.

    What neither the file nor the catalogue states is derived or a default; `Robot.sources` says which, and
    `Robot.notices` what was guessed. Deriving takes seconds the first time, and is kept in the user's cache.

    Args:
        name: name in `ROBOTS` or path of a file.
        tool: site or body; by default the catalogue's, or of a file the one that is named like a tool, see
            `tool_frames`, else the arm's last body.
        kind: which of the catalogue's tool frames it is by default, see `KnownRobot.tools`; the first one without.
        base: body that holds the arm; the joints before it are locked.
        packages: where ROS packages are that the file names, each as `NAME=FOLDER`.
        gripper: name of one that is mounted at the tool frame, in place of which comes the point between its fingers;
            `own` is the catalogue's for this arm, else the file's own, else `parallel`.
        grips: its fingers are driven, rather than locked where they meet.

    Raises:
        InputError: unknown name, tool or gripper, missing or broken file, or an arm without hinge and slide joints.
    """
    name = str(name)
    file = find_model_file(name, packages)
    known = ROBOTS.get(name)
    if known and not tool:
        tool = known.tools.get(FLANGE if gripper else kind or "") or next(iter(known.tools.values()))
    if gripper == OWN and known:
        gripper = known.gripper
    return _load(file, name if known else str(Path(name).absolute()), tool, base, gripper, grips)


NO_BOX = (
    "no box above its base was found all of which its tool reaches: its workspace and its goals are around the points"
    " that it does reach, and many of theirs are out of reach."
)


@functools.cache
def _load(file: ModelFile, name: str, tool: str | None, base: str | None, gripper: str, grips: bool) -> Robot:
    known, why = ROBOTS.get(name), ""
    try:
        if gripper == OWN:
            try:
                own = own_gripper(file, find_arm(file, tool, base), parallel=GRIPPED if grips else 0.0)
                file, tool = with_own_gripper(file, own), GRASP
            except UnrecognisedError as reason:
                gripper, why = PARALLEL, f"a parallel gripper is mounted, as none of its own was recognised: {reason}."
        if gripper and gripper != OWN:
            file, tool = with_gripper(file, gripper, tool or find_arm(file, None, base).tool), GRASP
        arm = find_arm(file, tool, base)
    except ValueError as error:
        found = f"; `reachlab robot {name}` shows the frame that is found by itself" if tool else ""
        raise InputError(f"robot {name!r}: {' '.join(str(error).split()).rstrip('.')}{found}.") from None
    listed = known or KnownRobot(file.file, "", {})
    loads, servoed = find_loads(arm.model, arm.tool), own_servos(arm.model)
    limits, sources = _limits(file, arm, listed, loads)
    speed, torque = np.array(limits["speed"]), np.array(limits["torque"])
    usable = np.where(np.isinf(torque), default_torques(loads, speed), torque)
    mass = float(arm.model.body_subtreemass[arm.model.jnt_bodyid[0]])
    load = payload(loads, usable, mass)
    gains = zip(arm.isolation.joints, servos(loads, usable, load), strict=True)
    isolation = replace(arm.isolation, servos={own: gain for i, (own, gain) in enumerate(gains) if i not in servoed})
    hand = None
    if gripper and grips:
        hand = file.own.drive if file.own else mounted_gripper(gripper)
        fingers = file.own.joints if file.own else [int(arm.whole.joint(slide).id) for slide in SLIDES]
        isolation = driven(isolation, arm.whole, fingers, hand)
    places = _places(file, arm, listed, limits["speed"])
    notices = [*file.notices, *arm.notices, *[why] * bool(why), *_at_odds(arm, loads, usable, speed)]
    sources["home"] = CATALOGUE if listed.home else FILE if places.home == arm.home else DERIVED
    if arm.home and sources["home"] == DERIVED:
        notices.append("the file's home is not used: from there little can be reached on straight ways.")
    for what in ("workspace", "goal_box", "held_quaternion"):
        sources[what] = DERIVED if getattr(listed, what) is None else CATALOGUE
    notices += [NO_BOX] * (sources["workspace"] == DERIVED and not places.shares)
    robot = Robot(
        name=name if known else file.file.stem,
        model=file,
        tool=arm.tool,
        joint_names=arm.names,
        chain=arm.chain,
        **limits,
        **places._asdict(),
        mass=mass,
        payload=load,
        isolation=isolation,
        sources=sources,
        pybullet=listed.pybullet,
        gripper=hand,
    )
    if robot.scale > HUGE:
        notices.append(f"Its workspace is {robot.scale:.0f} times the tutorial arm's: are its lengths in millimetres?")
    return replace(robot, notices=tuple(notices))


def _at_odds(arm: Arm, loads: Loads, torque: np.ndarray, speed: np.ndarray) -> Iterator[str]:
    """Sentences on joints whose limits `[n]` of torque and of speed do not go together, or cannot be meant."""
    servoed, units = own_servos(arm.model), ["N" if slides else "Nm" for slides in arm.chain.slides]
    for short, what in SHORTAGES.items():
        needed = {i: most for i, most in short(loads, torque, speed).items() if i not in servoed}
        if needed:
            joints = (f"{arm.names[i]} has {torque[i]:.3g} of {most:.3g} {units[i]}" for i, most in needed.items())
            yield f"{what}: {', '.join(joints)}."
    if fast := np.array(arm.names)[~np.array(arm.chain.slides) & (speed > FAST)].tolist():
        yield f"Speed limits above {FAST:g} rad/s (are they in degrees?): {some(fast)}."


def _limits(
    file: ModelFile, arm: Arm, listed: KnownRobot, loads: Loads
) -> tuple[dict[str, Any], dict[str, str | tuple[str, ...]]]:
    """Limits of each joint `[n]` by name, see `Robot`, and which they are, joint by joint.

    Those that the catalogue lists, else those of the file, else defaults.
    """
    n = arm.chain.n
    sources: dict[str, str | tuple[str, ...]] = {
        "position": tuple(FILE if is_limited(arm.model, joint) else DEFAULT for joint in range(n))
    }

    def filled(what: str, stated: Sequence[float | None], defaults: Sequence[float]) -> tuple[float, ...]:
        if (known := getattr(listed, what)) is not None:
            sources[what] = (CATALOGUE,) * n
            return known
        sources[what] = tuple(DEFAULT if own is None else FILE for own in stated)
        return tuple(default if own is None else own for own, default in zip(stated, defaults, strict=True))

    facts = [file.joints.get(joint, JointFacts()) for joint in arm.names]
    speeds = [fact.speed or own for fact, own in zip(facts, speed_limits(arm.whole, arm.isolation.joints), strict=True)]
    speed = filled("speed", speeds, [DEFAULT_SPEED] * n)
    held = default_torques(loads, np.array(speed))
    held[list(own_servos(arm.model))] = np.inf
    torque = filled("torque", torque_limits(arm.whole, arm.isolation.joints), held.tolist())
    acceleration = filled("acceleration", [None] * n, [RAMP_RATE * limit for limit in speed])
    jerk = filled("jerk", [None] * n, [JERK_RATE * limit for limit in acceleration])
    return {"speed": speed, "torque": torque, "acceleration": acceleration, "jerk": jerk}, sources


def _places(file: ModelFile, arm: Arm, listed: KnownRobot, speed: tuple[float, ...]) -> Derived:
    """Home, boxes and the tool's orientation: what the catalogue lists, and what is derived where it does not."""
    home = listed.home or arm.home
    if home and listed.workspace and listed.goal_box:
        held = listed.held_quaternion or orientation(arm.chain, home)
        return Derived(home, held, listed.workspace, listed.goal_box, {})
    found = _derived(file, replace(arm, home=home), speed)
    stated = {name: value for name in Derived._fields if (value := getattr(listed, name, None)) is not None}
    shares = {name: share for name, share in found.shares.items() if name not in stated}
    return found._replace(**stated, shares=shares)


def _derived(file: ModelFile, arm: Arm, speed: tuple[float, ...]) -> Derived:
    """Home and boxes of an arm; from the cache if they were derived before."""
    asked = (VERSION, file.digest, arm.tool, arm.isolation.joints, arm.chain, arm.home, speed)

    def find() -> Derived:
        logger.warning(
            "reachlab: finding home and workspace of %s, tool %s: a few seconds, once.", file.file.name, arm.tool
        )
        return derive(arm.chain, np.array(speed), arm.base, arm.home, untouching(file, arm))

    return kept("robots", asked, find, Derived, Derived._asdict)
