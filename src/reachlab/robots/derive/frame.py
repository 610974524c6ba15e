"""The frame that places are in: that of the robot's file, and where the arm's base stands in it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np

if TYPE_CHECKING:
    from reachlab.robots.robot import Robot

ALIKE = 1e-6
"""Two frames so near to each other are one [m, and of a quaternion's parts]."""


class Frame(NamedTuple):
    """A frame of places.

    Attributes:
        name: of the body that stands in its origin, `world` where none does.
        base: the body that holds the first joint.
        position: where that stands in the frame `[3]` [m].
        quaternion: how it is turned there, wxyz.
    """

    name: str
    base: str
    position: tuple[float, ...]
    quaternion: tuple[float, ...]

    def in_words(self) -> str:
        """The frame as people read it."""
        if self.name == self.base:
            return f"the frame of {self.base!r}, the arm's base"
        place, turn = (", ".join(f"{value:.4g}" for value in part) for part in (self.position, self.quaternion))
        where = f"the arm's base {self.base!r} stands at ({place}) m, turned by the quaternion ({turn}) wxyz"
        return f"the frame of {self.name!r} in the robot's file, where {where}"


def frame_of(robot: Robot) -> Frame:
    """The frame in which goals and boxes of a robot are."""
    model = robot.spec(pictures=False).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    base = at = int(model.body_parentid[model.jnt_bodyid[0]])
    while at and not _in_origin(data, at):
        at = int(model.body_parentid[at])
    name, held = (str(model.body(body).name) or f"body {body}" for body in (at, base))
    return Frame(name, held, tuple(data.xpos[base].tolist()), tuple(data.xquat[base].tolist()))


def _in_origin(data: mujoco.MjData, body: int) -> bool:
    return bool(np.abs(np.array([*data.xpos[body], *data.xquat[body, 1:]])).max() < ALIKE)
