"""Transforms of a chain's links, in NumPy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def joint_transform(slide: bool, value: float | np.ndarray) -> np.ndarray:
    """Transforms `[..., 4, 4]` of a joint that is moved by `value [...]`: along its z axis, or about it."""
    transform = np.tile(np.eye(4), (*np.shape(value), 1, 1))
    if slide:
        transform[..., 2, 3] = value
        return transform
    cos, sin = np.cos(value), np.sin(value)
    transform[..., :2, :2] = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)
    return transform


def moved_links(frames: np.ndarray, slides: Sequence[bool] | np.ndarray, q: np.ndarray) -> list[np.ndarray]:
    """Transforms `[..., 4, 4]` of what each of `n` joints moves, at joint vectors `q [..., n]`.

    Before each joint stands one of `frames [n or more, 4, 4]`.
    """
    found = [np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))]
    for joint, slide in enumerate(slides):
        found.append(found[-1] @ frames[joint] @ joint_transform(slide, q[..., joint]))
    return found[1:]
