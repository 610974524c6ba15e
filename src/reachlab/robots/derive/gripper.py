"""Grippers that are driven: which joints in a file move fingers, and how one opening drives them.

Joints, equalities and linkages are settled by MuJoCo with the leading joints held at either end of their range; what
is far out on both sides then are the finger tips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from reachlab.robots.derive.arm import Arm
from reachlab.robots.derive.fingers import APART, DRIVEN, STAYS, FoundHand, Tip, UnrecognisedError
from reachlab.robots.derive.isolation import Finger, Isolation, Servo
from reachlab.robots.files.gripper import GRIPPERS, Gripper, OwnGripper
from reachlab.robots.files.model_file import ModelFile
from reachlab.robots.kinematics.limits import force_limit, is_limited

STIFFNESS, DAMPING, INERTIA = 1500.0, 22.0, 0.05
"""Of a gripper's servos, as felt in its opening [N/m, N s/m], and inertia of their drives [kg]: the fingers are
critically damped, and the whole force of 30 N is there where they are commanded 2 cm into what they grip."""

FORCE, MOST_FORCE = 30.0, 50.0
"""Force of a gripper where the file states none, and beyond which what it states is a placeholder [N]."""

SPEED, MOST_SPEED = 0.1, 0.2
"""The same of the speed of its opening [m/s]."""


WIDEST, GRIPPED = 0.1, 0.05
"""Opening beyond which fingers are not opened, and at which their pads are parallel, as if they gave way, and the grasp
frame is midway, so that a hand with one jaw goes over an object of 3 to 4 cm [m]."""


OPENINGS = 17
"""Openings at which the way of the fingers is found."""


def driven(isolation: Isolation, whole: mujoco.MjModel, joints: Sequence[int], gripper: Gripper) -> Isolation:
    """An isolation of a file in which a gripper's joints are driven, each by its share of the opening's servo."""
    slopes = gripper.slopes
    share = float(1 / (slopes @ slopes))
    ends = zip(joints, gripper.closed, gripper.open, slopes, strict=True)
    fingers = [
        Finger(
            *(joint, int(whole.jnt_bodyid[joint]), closed, opened),
            servo=Servo(STIFFNESS * share, DAMPING * share, gripper.force * share * abs(slope)),
            inertia=INERTIA * share,
        )
        for joint, closed, opened, slope in ends
    ]
    return replace(isolation, fingers=tuple(fingers))


def mounted_gripper(name: str) -> Gripper:
    """How one opening drives the slides of a gripper that is mounted, see `mount`."""
    hand = GRIPPERS[name]
    return Gripper((0.0, 0.0), (hand.stroke, hand.stroke), 2 * hand.stroke, 2 * hand.speed, hand.force)


def own_gripper(file: ModelFile, arm: Arm, *, parallel: float = GRIPPED) -> OwnGripper:
    """The gripper that a file has beyond its arm, whose pads are parallel at an opening [m], as if they gave way.

    Raises:
        UnrecognisedError: it has none of two fingers; the sentence says what was found.
    """
    model = file.spec().compile()
    hand = FoundHand(model, arm.isolation.joints)
    if not hand.joints:
        raise UnrecognisedError("it has no joints beyond the arm's")
    leads = _leads(model, hand.joints)
    if len(leads) not in (1, 2):
        names = ", ".join(repr(model.joint(joint).name) for joint in leads) or "none"
        raise UnrecognisedError(f"one or two joints with limits have to move its fingers, and it has {names}")
    ends = hand.ends(leads)
    tips = hand.tips(ends, len(leads))
    closed, opened = min(
        ((ends[which], ends[tuple(1 - i for i in which)]) for which in ends),
        key=lambda pair: hand.distance(pair[0], tips),
    )
    way = hand.between(opened, tips) - hand.between(closed, tips)
    if np.linalg.norm(way) < APART:
        raise UnrecognisedError("its joints do not move two finger tips apart")
    return _measured(file, hand, leads, tips, (closed, opened), way, parallel)


def _measured(
    file: ModelFile,
    hand: FoundHand,
    leads: Sequence[int],
    tips: tuple[Tip, Tip],
    limits: tuple[np.ndarray, np.ndarray],
    apart: np.ndarray,
    parallel: float,
) -> OwnGripper:
    """A gripper whose tips are known, and where its joints are closed and widest open `[nq]`."""
    model, (closed, opened) = hand.model, limits
    frame = hand.frame(closed, tips, apart)  # [3, 3], its axes in columns, in the world
    shares = np.linspace(0.0, 1.0, 8 * OPENINGS + 1)
    ends, rising = _rising(hand.gaps(closed, opened, shares, tips, frame), shares)
    if ends[0] > STAYS or ends[-1] < ends[0] + APART:
        raise UnrecognisedError(f"its finger tips are {1000 * ends[0]:.0f} to {1000 * ends[-1]:.0f} mm apart")
    middle = closed + float(np.interp(min(parallel, ends[-1]), ends, rising)) * (opened - closed)
    pads, grasp, faces = hand.pads(middle, tips, frame)
    gaps, shares = _rising(hand.gaps(closed, opened, shares, faces, frame), shares)
    # The opening is 0 where the pads would meet, which may be beyond the limits of the joints.
    slope = (shares[-1] - shares[0]) / (gaps[-1] - gaps[0])
    gaps, shares = np.insert(gaps, 0, 0.0), np.insert(shares, 0, shares[0] - slope * gaps[0])
    widest = float(gaps[-1])
    along = np.interp(np.linspace(0.0, widest, OPENINGS), gaps, shares)
    ends = closed + along[:1] * (opened - closed), closed + along[-1:] * (opened - closed)
    moved = np.abs(ends[1] - ends[0])[model.jnt_qposadr[hand.joints]]
    alike = np.array([moved[model.jnt_type[hand.joints] == model.jnt_type[j]].max() for j in hand.joints])
    joints = [j for j, large in zip(hand.joints, moved > DRIVEN * alike, strict=True) if large]
    low, high = ([float(end[model.jnt_qposadr[j]]) for j in joints] for end in ends)
    way = tuple(((along - along[0]) / (along[-1] - along[0])).tolist())
    drive = Gripper(tuple(low), tuple(high), widest, SPEED, FORCE, way)
    slopes = dict(zip(joints, map(float, drive.slopes), strict=True))
    facts = {j: file.joints.get(model.joint(j).name) for j in leads if j in slopes}
    speeds = [fact.speed / abs(slopes[j]) for j, fact in facts.items() if fact and fact.speed]
    force = min(force_limit(model, leads, slopes) or FORCE, MOST_FORCE)
    drive = replace(drive, speed=min(min(speeds, default=SPEED), MOST_SPEED), force=force)
    return OwnGripper(tuple(joints), drive, grasp, pads)


def _rising(gaps: np.ndarray, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part `[P]` of gaps between fingers [m] along which they open, and the shares of the way that go with it."""
    last = int(np.argmax(gaps >= min(WIDEST, gaps.max())))
    first = int(np.flatnonzero(gaps[: last + 1] <= max(gaps[: last + 1].min(), 0.0))[-1])
    rising = gaps[first : last + 1]
    return np.maximum.accumulate(rising + 1e-9 * np.arange(len(rising))), shares[first : last + 1]


def _leads(model: mujoco.MjModel, joints: Sequence[int]) -> list[int]:
    """Those of a hand's joints that lead the others: with an actuator if any has one, following none of them."""
    driven_ones = set()
    for actuator in range(model.nu):
        target, kind = int(model.actuator_trnid[actuator, 0]), model.actuator_trntype[actuator]
        if kind == int(mujoco.mjtTrn.mjTRN_JOINT):
            driven_ones.add(target)
        elif kind == int(mujoco.mjtTrn.mjTRN_TENDON):
            first = model.tendon_adr[target]
            driven_ones |= set(model.wrap_objid[first : first + model.tendon_num[target]].tolist())
    leads = [j for j in joints if is_limited(model, j)]
    leads = [j for j in leads if j in driven_ones] or leads
    couplings = np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT))
    followers = {int(model.eq_obj1id[i]) for i in couplings if int(model.eq_obj2id[i]) in leads}
    return [j for j in leads if j not in followers]
