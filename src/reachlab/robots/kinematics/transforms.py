"""Transforms of a chain's links, in NumPy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def joint_transforms(slides: Sequence[bool] | np.ndarray, q: Sequence[float] | np.ndarray) -> np.ndarray:
    """Transforms `[..., n, 4, 4]` of joints at `q [..., n]`: along their z axes where they slide, else about them."""
    values, sliding = np.asarray(q, float), np.asarray(slides, bool)
    transforms = np.zeros((*values.shape, 4, 4)) + np.eye(4)
    turn = np.where(sliding, 0.0, values)
    cos, sin = np.cos(turn), np.sin(turn)
    transforms[..., 0, 0] = transforms[..., 1, 1] = cos
    transforms[..., 0, 1], transforms[..., 1, 0] = -sin, sin
    transforms[..., 2, 3] = np.where(sliding, values, 0.0)
    return transforms


def moved_links(frames: np.ndarray, slides: Sequence[bool] | np.ndarray, q: np.ndarray) -> list[np.ndarray]:
    """Transforms `[..., 4, 4]` of what each of `n` joints moves, at joint vectors `q [..., n]`.

    Before each joint stands one of `frames [n or more, 4, 4]`.
    """
    before, found = np.eye(4), []
    for joint, transform in enumerate(np.moveaxis(joint_transforms(slides, q), -3, 0)):
        before = before @ frames[joint] @ transform
        found.append(before)
    return found


def motions(links: np.ndarray, slides: Sequence[bool] | np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How a point `[..., 3]` m and its frame are moved and turned by each joint, `[..., n, 3]`: the Jacobian's columns.

    `links [..., n, 4, 4]` are what the joints move.
    """
    axes, sliding = links[..., :3, 2], np.asarray(slides, bool)[:, None]
    moves = np.where(sliding, axes, np.cross(axes, point[..., None, :] - links[..., :3, 3]))
    return moves, np.where(sliding, 0.0, axes)
