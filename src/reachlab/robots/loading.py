"""Loading of robots: from the catalogue, or from a model file of one's own."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from reachlab.robots.arm import Arm, find_arm
from reachlab.robots.catalogue import ROBOTS, KnownRobot, find_model_file
from reachlab.robots.derivation import derived
from reachlab.robots.isolation import own_servos
from reachlab.robots.joint_limits import is_limited, speed_limits, torque_limits
from reachlab.robots.model_file import JointFacts, ModelFile
from reachlab.robots.robot import CATALOGUE, DEFAULT, DERIVED, FILE, Robot
from reachlab.robots.servos import LAG, Loads, default_torques, find_loads, payload, servos, too_heavy, too_weak
from reachlab.robots.workspace import Derived, orientation
from reachlab.settings.validation import InputError

DEFAULT_SPEED = 1.5
"""Joint speed limit where none is known [rad/s or m/s]; slow for an industrial arm."""

RAMP_RATE, JERK_RATE = 10.0, 20.0
"""Limits of acceleration and jerk where none are known: full speed in a tenth of a second, and full acceleration in a
twentieth [1/s]."""

UNKNOWN = JointFacts(None, None, None)
"""What a file says of a joint that it says nothing of."""


def load_robot(
    name: str,
    tool: str | None = None,
    *,
    kind: str | None = None,
    base: str | None = None,
    packages: Sequence[str] = (),
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

    Raises:
        InputError: unknown name or tool, missing or broken file, or an arm without hinge and slide joints.
    """
    file = find_model_file(name, packages)
    known = ROBOTS.get(name)
    if known and not tool:
        tool = known.tools.get(kind or "") or next(iter(known.tools.values()))
    return _load(file, name if known else str(Path(name).absolute()), tool, base)


@functools.cache
def _load(file: ModelFile, name: str, tool: str | None, base: str | None) -> Robot:
    known = ROBOTS.get(name)
    try:
        arm = find_arm(file, tool, base)
    except ValueError as error:
        found = f"; `reachlab robot {name}` shows the frame that is found by itself" if tool else ""
        raise InputError(f"robot {name!r}: {' '.join(str(error).split()).rstrip('.')}{found}.") from None
    listed = known or KnownRobot(file.file, "", "", {})
    loads = find_loads(arm.model, range(arm.chain.n), arm.tool_body)
    speed, torque, sources = _limits(file, arm, listed, loads)
    usable = np.where(np.isinf(torque), default_torques(loads, np.array(speed)), torque)
    mass = float(arm.model.body_subtreemass[arm.model.jnt_bodyid[0]])
    load = payload(loads, usable, mass)
    gains, servoed = servos(loads, usable, load), own_servos(arm.model, range(arm.chain.n))
    acceleration, jerk = _shaping(listed, speed, sources)
    added = {own: gains[i] for i, own in enumerate(arm.isolation.joints) if i not in servoed}
    weak, heavy = (
        {i: needed for i, needed in short(loads, usable, np.array(speed)).items() if i not in servoed}
        for short in (too_weak, too_heavy)
    )
    places, notices = _places(file, arm, listed, speed), [*file.notices, *arm.notices]
    notices += _shortage(
        arm,
        weak,
        torque,
        f"follow fast commands later than {LAG:g} s",
        "gravity, friction and damping take at full speed",
    )
    notices += _shortage(arm, heavy, torque, "overshoot", f"stops them from full speed within {LAG:g} s")
    sources["home"] = CATALOGUE if listed.home else FILE if places.home == arm.home else DERIVED
    if arm.home and sources["home"] == DERIVED:
        notices.append("the file's home is not used: from there little can be reached on straight ways.")
    for what in ("workspace", "goal_box", "held_quaternion"):
        sources[what] = DERIVED if getattr(listed, what) is None else CATALOGUE
    return Robot(
        name=name if known else file.file.stem,
        model=file,
        tool=arm.tool,
        joint_names=arm.names,
        chain=arm.chain,
        home=places.home,
        speed=speed,
        torque=torque,
        acceleration=acceleration,
        jerk=jerk,
        workspace=places.workspace,
        goal_box=places.goal_box,
        held_quaternion=places.held_quaternion,
        mass=mass,
        payload=load,
        isolation=replace(arm.isolation, servos=added),
        sources=sources,
        shares=places.shares,
        notices=tuple(notices),
        pybullet=listed.pybullet,
    )


def _limits(
    file: ModelFile, arm: Arm, listed: KnownRobot, loads: Loads
) -> tuple[tuple[float, ...], tuple[float, ...], dict[str, str | tuple[str, ...]]]:
    """Speed and torque limits `[n]`, and where these and the position limits come from."""
    n = arm.chain.n
    facts = [file.joints.get(joint, UNKNOWN) for joint in arm.names]
    stated = speed_limits(arm.whole, n)
    speeds = [fact.speed or own for fact, own in zip(facts, stated, strict=True)]
    torques = torque_limits(arm.whole, arm.isolation.joints)
    torques = [own or fact.torque for own, fact in zip(torques, facts, strict=True)]
    servoed = own_servos(arm.model, range(n))
    speed, speed_sources = _filled(listed.speed, speeds, [DEFAULT_SPEED] * n)
    defaults = default_torques(loads, np.array(speed))
    unlimited = [float("inf") if joint in servoed else float(defaults[joint]) for joint in range(n)]
    torque, torque_sources = _filled(listed.torque, torques, unlimited)
    position = tuple(FILE if is_limited(arm.model, joint) else DEFAULT for joint in range(n))
    return speed, torque, {"position": position, "speed": speed_sources, "torque": torque_sources}


def _shortage(arm: Arm, needed: dict[int, float], torque: tuple[float, ...], then: str, what: str) -> list[str]:
    """A sentence on the joints whose torque limit is less than what they need, by number; none without such joints."""
    units = ["N" if slides else "Nm" for slides in arm.chain.slides]
    joints = [f"{arm.names[i]} has {torque[i]:.3g} of {most:.3g} {units[i]}" for i, most in needed.items()]
    return [f"Joints {then} where the torque limit is less than what {what}: {', '.join(joints)}."] if joints else []


def _shaping(
    listed: KnownRobot, speed: tuple[float, ...], sources: dict[str, str | tuple[str, ...]]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Limits of acceleration and jerk `[n]`, which no model file states; where they come from is noted."""
    nothing: list[float | None] = [None] * len(speed)
    usual = [RAMP_RATE * limit for limit in speed]
    acceleration, sources["acceleration"] = _filled(listed.acceleration, nothing, usual)
    jerk, sources["jerk"] = _filled(listed.jerk, nothing, [JERK_RATE * limit for limit in acceleration])
    return acceleration, jerk


def _filled(
    listed: tuple[float, ...] | None, stated: Sequence[float | None], defaults: Sequence[float]
) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """What the catalogue lists, else what the file states, else the default; and which it was, joint by joint."""
    if listed is not None:
        return listed, (CATALOGUE,) * len(listed)
    figures = tuple(default if own is None else own for own, default in zip(stated, defaults, strict=True))
    return figures, tuple(DEFAULT if own is None else FILE for own in stated)


def _places(file: ModelFile, arm: Arm, listed: KnownRobot, speed: tuple[float, ...]) -> Derived:
    """Home, boxes and the tool's orientation: what the catalogue lists, and what is derived where it does not."""
    home = listed.home or arm.home
    if home and listed.workspace and listed.goal_box:
        held = listed.held_quaternion or orientation(arm.chain, home)
        return Derived(home, held, listed.workspace, listed.goal_box, {})
    found = derived(file, replace(arm, home=home), speed)
    stated = {name: value for name in Derived._fields if (value := getattr(listed, name, None)) is not None}
    shares = {name: share for name, share in found.shares.items() if name not in stated}
    return found._replace(**stated, shares=shares)
