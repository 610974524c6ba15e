"""Where the observation camera stands, and what it sees where."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.robot import TUTORIAL_WORKSPACE, Robot
from reachlab.tasks.tabletop import working_box

LOOKS_AT, DISTANCE, PITCH = (0.55, 0.0, 0.05), 0.7, -70.0
"""Point in the middle of the picture [m], how far the camera is from it [m], and how it looks down [deg]; it looks
against the x axis (PyBullet's yaw of 90°). The tutorial's."""

LOW_PITCH, ABOVE, FILLED = -25.0, 0.05, 0.966
"""How it looks down at objects on a table [deg], how high above the table it looks, beside the tutorial's arm [m], and
what share of the picture's width the part of the table takes at its near side over which the hand works. From above the
hand would hide what it pushes."""

FIELD_OF_VIEW = 60.0
"""Angle from the picture's lower to its upper edge [deg]. The tutorial's."""

EDGE = float(np.tan(np.radians(FIELD_OF_VIEW / 2)))
"""Half the side of what is seen, for a distance of 1."""

FLATTEST = 0.05
"""How steeply a ray has to go down to meet the table, so that each meets it [m for a distance of 1 m]."""


def camera_pose(robot: Robot, *, objects: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Position `[3]` m and rotation `[3, 3]` of the camera: the picture's right, its up and what is behind, as columns.

    It is the tutorial's, so far away that it sees the arm's workspace; objects it sees from in front, under the hand.
    """
    pitch = LOW_PITCH if objects else PITCH
    back = np.array([np.cos(np.radians(pitch)), 0.0, -np.sin(np.radians(pitch))])
    if objects:
        low, high = working_box(robot)
        above, (deep, wide, _) = ABOVE * robot.scale, (high - low) / 2
        middle = np.array([*(low + high)[:2] / 2, robot.table_top + above])
        distance = wide / (EDGE * FILLED) + deep * back[0] - above * back[2]
    else:
        sides, usual = (np.subtract(high, low)[:2] for low, high in (robot.workspace, TUTORIAL_WORKSPACE))
        middle, distance = robot.placed(LOOKS_AT), DISTANCE * max(robot.scale, *(sides / usual))
    right = np.array([0.0, 1.0, 0.0])
    return middle + distance * back, np.stack([right, np.cross(back, right), back], axis=1)


def in_picture(robot: Robot, point: Array) -> Array:
    """Where a point on the table `[..., 3]` m is in the picture of objects `[..., 2]`: to the right and up, within ±1.

    A point that the camera does not see is at the nearest edge.
    """
    position, rotation = (jnp.array(part, jnp.float32) for part in camera_pose(robot, objects=True))
    seen = (point - position) @ rotation
    return jnp.clip(seen[..., :2] / (EDGE * jnp.maximum(-seen[..., 2:], FLATTEST)), -1.0, 1.0)


def on_table(robot: Robot, place: Array) -> Array:
    """The point on the table `[..., 3]` m, in the workspace, that is seen at a place of the picture `[..., 2]`."""
    position, rotation = (jnp.array(part, jnp.float32) for part in camera_pose(robot, objects=True))
    ray = EDGE * place @ rotation[:, :2].T - rotation[:, 2]
    far = (position[2] - robot.table_top) / jnp.maximum(-ray[..., 2:], FLATTEST)
    low, high = np.array(robot.workspace, np.float32)
    low[2] = high[2] = robot.table_top
    return jnp.clip(position + far * ray, low, high)
