"""Grippers in an arm's model: that are mounted on its flange, and what is added to the one that its file has."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

from reachlab.settings.validation import InputError

PREFIX = "reachlab_gripper_"
"""Begin of the names of what is mounted."""

GRASP = f"{PREFIX}grasp"
"""Name of the tool frame between the finger tips; its z points out of the hand, and the fingers move along its y."""

TIPS = (f"{PREFIX}tip_0", f"{PREFIX}tip_1")
"""Names of the geoms of the finger tips."""

SLIDES = tuple(f"{name}_slide" for name in TIPS)
"""Names of the fingers' joints."""

BEYOND = 0.008
"""From the grasp frame to the ends of the finger tips [m]."""

PAD = (0.009, 0.006, 0.0265)
"""Half sides of what touches of a finger [m]."""

COLOUR = (0.32, 0.34, 0.38, 1.0)


@dataclass(frozen=True)
class ParallelGripper:
    """A gripper of two fingers that move together.

    Attributes:
        length: from the flange to the point between the finger tips, which end `BEYOND` further [m].
        palm: half sides `[3]` of its housing [m].
        tip: half sides `[3]` of the part of a finger that touches [m].
        stroke: way of one finger [m].
        mass, finger_mass: of the housing and of a finger [kg].
        speed: of a finger, at most [m/s].
        force: with which a finger grips [N].
    """

    length: float
    palm: tuple[float, float, float]
    tip: tuple[float, float, float]
    stroke: float
    mass: float
    finger_mass: float
    speed: float
    force: float


GRIPPERS = {
    # About the Franka Hand: 0.73 kg, 2 × 40 mm, 0.1034 m from the flange to the point between the finger tips, 0.05 m/s
    # a finger, 30 to 70 N (Franka Robotics, Franka Hand product manual).
    "parallel": ParallelGripper(0.105, (0.03, 0.1, 0.03), PAD, 0.04, 0.6, 0.06, 0.05, 30.0),
}
"""Grippers by name."""


class Place(NamedTuple):
    """Where something is on a body, by its number in the file: position `[3]` m and quaternion `[4]` wxyz."""

    body: int
    position: tuple[float, ...]
    quaternion: tuple[float, ...]


@dataclass(frozen=True)
class Gripper:
    """Fingers that one opening drives, in proportion.

    Attributes:
        closed, open: positions of the fingers' joints [rad or m] where they meet, and where they are widest open; in a
            spec of the robot these joints come after the arm's.
        widest: opening between the finger tips at the widest [m].
        speed: of the opening, at most [m/s].
        force: with which a finger grips [N].
        way: shares of the way from closed to open at evenly spaced openings from 0 to the widest.
    """

    closed: tuple[float, ...]
    open: tuple[float, ...]
    widest: float
    speed: float
    force: float
    way: tuple[float, ...] = (0.0, 1.0)

    @property
    def slopes(self) -> Any:
        """Way of the fingers' joints for a metre of opening `[k]`, about half of the widest [rad/m or m/m]."""
        ends = self.fingers(self.widest * np.array([[0.25], [0.75]]))
        return (ends[1] - ends[0]) / (0.5 * self.widest)

    def fingers(self, opening: Any) -> Any:
        """Positions `[..., k]` of the fingers' joints at an opening `[..., 1]` m."""
        share = np.interp(opening / self.widest, np.linspace(0.0, 1.0, len(self.way)), self.way)
        return np.array(self.closed) + share * np.subtract(self.open, self.closed)

    def opening(self, fingers: Any) -> Any:
        """Opening `[..., 1]` m of fingers whose joints are at `[..., k]`."""
        share = ((fingers - np.array(self.closed)) / np.subtract(self.open, self.closed)).mean(axis=-1, keepdims=True)
        return self.widest * np.interp(share, self.way, np.linspace(0.0, 1.0, len(self.way)))


@dataclass(frozen=True)
class OwnGripper:
    """A gripper found in a file, see `reachlab.robots.derive.gripper`.

    Attributes:
        joints: numbers in the file of the joints that move fingers.
        drive: how one opening drives them.
        grasp: the frame between the pads, like `GRASP`.
        pads: what touches things in place of the finger tips.
    """

    joints: tuple[int, ...]
    drive: Gripper
    grasp: Place
    pads: tuple[Place, Place]


def fit(spec: mujoco.MjSpec, gripper: OwnGripper) -> None:
    """Add the grasp frame and the pads of a file's own gripper to its spec."""
    bodies = spec.bodies
    for name, pad in zip(TIPS, gripper.pads, strict=True):
        # Boxes of one size rather than the file's meshes: flat, whatever is drawn, and what `push` and `lift` expect.
        box = bodies[pad.body].add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=PAD, rgba=COLOUR, mass=0.0)
        box.pos, box.quat, box.contype, box.conaffinity = pad.position, pad.quaternion, 0, 0
    place = gripper.grasp
    bodies[place.body].add_site(name=GRASP, pos=place.position, quat=place.quaternion, size=[0.005] * 3)


def mount(spec: mujoco.MjSpec, gripper: str, frame: str) -> None:
    """Add a gripper, closed, to a spec.

    Raises:
        InputError: the spec has no such frame.
    """
    hand, site = GRIPPERS[gripper], spec.site(frame)
    body = spec.body(frame) if site is None else site.parent
    if body is None:
        raise InputError(f"has no frame {frame!r} to mount a gripper at.")
    place, turn = ([0.0] * 3, [1.0, 0.0, 0.0, 0.0]) if site is None else (site.pos, site.quat)
    box, reach = mujoco.mjtGeom.mjGEOM_BOX, hand.length + BEYOND - hand.tip[2]
    palm = body.add_body(name=f"{PREFIX}palm", pos=place, quat=turn)
    palm.add_geom(type=box, size=hand.palm, pos=[0, 0, hand.palm[2]], rgba=COLOUR)
    _weigh(palm, hand.mass, hand.palm, hand.palm[2])
    for name, joint, side in zip(TIPS, SLIDES, (1, -1), strict=True):
        finger = palm.add_body(name=f"{name}_finger", pos=[0.0, side * hand.tip[1], reach])
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        finger.add_joint(name=joint, type=slide, axis=[0, side, 0], range=[0, hand.stroke])
        finger.add_geom(name=name, type=box, size=hand.tip, rgba=COLOUR)
        _weigh(finger, hand.finger_mass, hand.tip, 0.0)
    palm.add_site(name=GRASP, pos=[0, 0, hand.length], size=[0.005] * 3)
    for geom in palm.find_all("geom"):
        geom.contype = geom.conaffinity = 0
        geom.mass = 0.0


def _weigh(body: mujoco.MjsBody, mass: float, half: tuple[float, ...], height: float) -> None:
    """Give a body the mass and inertia of a box, whatever its file says that inertias are taken from."""
    square = [side**2 for side in half]
    body.mass, body.ipos, body.explicitinertial = mass, [0.0, 0.0, height], True
    body.inertia = [mass * (sum(square) - own) / 3 for own in square]
