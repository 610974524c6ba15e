"""Views of the observation camera: the tutorial's, or light, colours and pose at random."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reachlab.render.scene import pose_around
from reachlab.robots.robot import Robot
from reachlab.tasks.camera import camera_pose
from reachlab.tasks.schema import SIZE

NEAR, FAR = 0.1, 100.0
"""Near and far plane [m]. The tutorial's."""

SHIFT, TURN = 0.02, 2.0
"""Random views: the camera is displaced along and turned about each axis within this [m, deg]; the former in proportion
to the arm's workspace."""

AMBIENT, AMBIENT_SPREAD = 0.45, 0.2
"""Light from everywhere, and how far it varies in random views [share of white]."""

LAMP, LAMP_SPREAD = 0.5, 0.25
"""Light of the lamp, and how far it varies in random views [share of white]."""

LAMP_DIRECTION, LAMP_TILT = (-0.3, 0.2, -1.0), 0.6
"""Where the lamp shines, and how far each part of that varies in random views."""

TABLE, GROUND, TARGET = (0.9, 0.3), (0.7, 0.4), (0.16, 0.14)
"""Greys of table, ground and target (the blue of the tutorial's object), and how far they vary [share of white]."""

BODY = (0.45, 0.15)
"""Grey of the bodies beside the arm, and how far it varies in random views [share of white]."""

ARM_SPREAD = 0.5
"""How far the grey of each of the arm's parts varies in random views [share of white]."""

DARKEST = 0.02
"""No grey is drawn below this."""

ARM_GREYS = 24
"""Random greys of the arm's parts; with more parts they are used again."""

SHADE = 0.3
"""Random views: the picture's edges are brighter or darker than its middle by at most this share."""

GRAIN = 8.0
"""Random views: spread of the grain that lies on every surface, at most [of 255]. It stands for their textures."""


class Views(NamedTuple):
    """Views of `B` environments.

    Attributes:
        position: of the camera `[B, 3]` [m].
        rotation: the picture's right, its up and what is behind the camera, as columns `[B, 3, 3]`.
        ambient, lamp: light `[B]` [share of white].
        lamp_direction: where the lamp shines `[B, 3]`.
        table, ground, target, body: greys `[B]` [share of white].
        arm: what is added to the greys of the arm's parts `[B, ARM_GREYS]`.
        shade: how much brighter the picture is at its right and its lower edge than in the middle `[B, 2]` [share].
        grain: spread of the grain `[B]` [of 255].
        grain_corner: where it is cut from a larger pattern `[B, 2]` [pixels].
    """

    position: np.ndarray
    rotation: np.ndarray
    ambient: np.ndarray
    lamp: np.ndarray
    lamp_direction: np.ndarray
    table: np.ndarray
    ground: np.ndarray
    target: np.ndarray
    arm: np.ndarray
    shade: np.ndarray
    grain: np.ndarray
    grain_corner: np.ndarray
    body: np.ndarray


NUMBERS = (*(3, 3), *(1, 1, 3), *(1, 1, 1, ARM_GREYS), *(2, 1, 2), 1)
"""Random numbers that each field of `Views` takes in a random view, in their order."""

SAMPLES = sum(NUMBERS)
"""Random numbers of a view."""


def make_views(samples: np.ndarray, robot: Robot, *, objects: bool = False, angles: tuple[float, ...] = ()) -> Views:
    """Views on a robot of `samples [B, SAMPLES]` in -1 to 1; zeros are that of `camera_pose`, or see `pose_around`."""
    from scipy.spatial.transform import Rotation

    parts = np.split(np.asarray(samples, np.float64), np.cumsum(NUMBERS)[:-1], axis=1)
    varied = Views(*(part[:, 0] if part.shape[1] == 1 else part for part in parts))
    position, rotation = pose_around(robot, *angles) if angles else camera_pose(robot, objects=objects)
    turn = Rotation.from_rotvec(TURN * varied.rotation, degrees=True).as_matrix()

    def grey(nominal: tuple[float, float], share: np.ndarray) -> np.ndarray:
        return np.clip(nominal[0] + nominal[1] * share, DARKEST, 1.0)

    return Views(
        position=position + SHIFT * robot.scale * varied.position,
        rotation=turn @ rotation,
        ambient=AMBIENT + AMBIENT_SPREAD * varied.ambient,
        lamp=LAMP + LAMP_SPREAD * varied.lamp,
        lamp_direction=np.array(LAMP_DIRECTION) + LAMP_TILT * varied.lamp_direction,
        table=grey(TABLE, varied.table),
        ground=grey(GROUND, varied.ground),
        target=grey(TARGET, varied.target),
        arm=ARM_SPREAD * varied.arm,
        shade=SHADE * varied.shade,
        grain=GRAIN * np.abs(varied.grain),
        grain_corner=((varied.grain_corner + 1) / 2 * SIZE).astype(int),
        body=grey(BODY, varied.body),
    )


def develop(pictures: np.ndarray, views: Views) -> np.ndarray:
    """Pictures `[B, size, size]` uint8, or with colours behind, with the shade and the grain of their views."""
    if not (views.shade.any() or views.grain.any()):
        return pictures
    size, behind = pictures.shape[1], (slice(None), slice(None), *[None] * (pictures.ndim - 3))
    across = np.linspace(-1, 1, size, dtype=np.float32)
    pattern = np.random.default_rng(0).standard_normal((SIZE + size, SIZE + size), np.float32)
    out = np.empty_like(pictures)
    for i, (right, down) in enumerate(views.shade.astype(np.float32)):
        row, column = views.grain_corner[i]
        grain = np.float32(views.grain[i]) * pattern[row : row + size, column : column + size]
        light = 1 + right * across + down * across[:, None]
        out[i] = np.clip(pictures[i] * light[behind] + grain[behind], 0, 255)
    return out


def greys(pictures: np.ndarray) -> np.ndarray:
    """Greys `[...]` uint8 of colours `[..., 3]` uint8."""
    return np.rint(pictures @ np.array(LUMA, np.float32)).astype(np.uint8)


LUMA = (0.299, 0.587, 0.114)
"""Weights of red, green and blue in a grey (ITU-R BT.601); OpenCV's and the tutorial's."""
