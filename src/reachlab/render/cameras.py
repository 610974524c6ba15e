"""Poses of cameras that stand around the workspace."""

from __future__ import annotations

import itertools

import numpy as np

from reachlab.render.scene import distance_needed, drawn_spec, front, outline
from reachlab.render.view_randomisation import Pose
from reachlab.robots.robot import Robot
from reachlab.tasks.camera import FIELD_OF_VIEW

LOOKS_DOWN, STRAIGHT_DOWN = 40.0, 85.0
"""From the table up to a camera beside the workspace, and to one above it [deg]: the picture's upper edge is the arm's
far side."""

AHEAD, LEFT = 0.0, 90.0
"""About the vertical, from the way in front of the arm to a camera [deg]."""


def front_pose(robot: Robot, *, objects: bool = False) -> Pose:
    """Pose of a camera in front of the arm, see `camera_pose`."""
    del objects
    return _around(robot, AHEAD, LOOKS_DOWN)


def side_pose(robot: Robot, *, objects: bool = False) -> Pose:
    """Pose of a camera at the arm's left, see `camera_pose`."""
    del objects
    return _around(robot, LEFT, LOOKS_DOWN)


def top_pose(robot: Robot, *, objects: bool = False) -> Pose:
    """Pose of a camera above the workspace, see `camera_pose`."""
    del objects
    return _around(robot, AHEAD, STRAIGHT_DOWN)


def _around(robot: Robot, azimuth: float, elevation: float) -> Pose:
    """Pose of a camera from which, at these angles [deg], all goals, the workspace and the arm at home are seen."""
    around, up = np.radians(azimuth) + front(robot), np.radians(elevation)
    back = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    right = np.array([-np.sin(around), np.cos(around), 0.0])
    goals = np.array(list(itertools.product(*zip(*robot.goal_box, strict=True))))
    points = np.concatenate([goals, outline(robot, drawn_spec(robot).compile())])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    distance = distance_needed(points - middle, -back, FIELD_OF_VIEW, aspect=1.0)
    return middle + distance * back, np.stack([right, np.cross(back, right), back], axis=1)
