"""Objects that move when they are touched, in any engine: their friction, how they vary, and where they are."""

from __future__ import annotations

import numpy as np

from reachlab.control.bodies import Bodies
from reachlab.tasks.task import Scene

TURNING, ROLLING = 0.01, 0.001
"""Friction against turning about the contact's normal, and against rolling [m]."""

MASS_SPREAD = (0.3, 3.0)
"""Where objects vary: least and largest share of the mass."""


def mass_and_share(scene: Scene, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass [kg] of objects and share of the scene's friction `[B, 1]`, as `numbers [B, 2]` in -1 to 1 say.

    Where these are `[B, 0]` both are the scene's.
    """
    if not numbers.shape[1]:
        return np.full((len(numbers), 1), scene.mass), np.ones((len(numbers), 1))
    (low, high), (least, most), share = np.log(MASS_SPREAD), scene.friction_spread, (1 + numbers) / 2
    return scene.mass * np.exp(low + (high - low) * share[:, :1]), least + (most - least) * share[:, 1:]


def with_objects(bodies: Bodies, pose: np.ndarray, velocity: np.ndarray) -> Bodies:
    """Bodies `[B, K]`, in NumPy, whose last ones are at poses `[B, k, 7]` and move at velocities `[B, k, 6]`."""
    fixed = bodies.kind.shape[1] - pose.shape[1]
    parts = {"position": pose[..., :3], "quaternion": pose[..., 3:], "velocity": velocity}
    joined = {
        name: np.concatenate([np.asarray(getattr(bodies, name))[:, :fixed], part], axis=1)
        for name, part in parts.items()
    }
    return Bodies(**joined, size=bodies.size, kind=bodies.kind)  # pyright: ignore[reportArgumentType]
