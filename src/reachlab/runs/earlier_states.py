"""Training states as they were saved, by this version and by earlier ones; of settings see `envs.earlier_configs`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from reachlab.control.bodies import Shape

FORMAT = 2
"""Version of the checkpoint format."""

Arrays = dict[str, np.ndarray]
"""Arrays of a state by name."""

RENAMED = {
    "env/target_q": "env/command",
    "env/progress/distance": "env/errors/distance",
    "env/progress/angle": "env/errors/angle",
    "env/progress/recent": "env/progress/errors/distance",
    "env/progress/recent_angle": "env/progress/errors/angle",
    "env/progress/mean_square": "env/progress",
    **{f"env/obstacles/{name}": f"env/arm/bodies/{name}" for name in ("position", "quaternion")},
}
"""Names of format 1, and what they are called now."""

ENGINE_NUMBERS = 11 * 2
"""Words of 32 bits that a body had at the end of the engine's state in format 1."""


def _with_bodies(arrays: Arrays) -> Arrays:
    """Format 1 had obstacles beside the arm's state, of other numbers."""
    new = {RENAMED.get(name, name): array for name, array in arrays.items()}
    half, radius = new.pop("env/obstacles/half", None), new.pop("env/obstacles/radius", None)
    if half is None or radius is None:
        return new
    box, long = half[..., :1] > 0, half[..., 2:] > 0
    rounded = np.concatenate([radius[..., None], half[..., 2:], np.zeros_like(half[..., :1])], axis=-1)
    kind = np.where(box, Shape.BOX, np.where(long, Shape.CAPSULE, Shape.BALL))[..., 0]
    new["env/arm/bodies/size"] = np.where(box, half, rounded)
    new["env/arm/bodies/kind"] = kind.astype(np.int32)
    new["env/arm/bodies/velocity"] = np.zeros((*radius.shape, 6), np.float32)
    new["env/arm/engine"] = np.ascontiguousarray(new["env/arm/engine"][:, : -ENGINE_NUMBERS * radius.shape[1]])
    return new


UPGRADES: dict[int, Callable[[Arrays], Arrays]] = {1: _with_bodies}
"""By format what makes the next one of it."""


def upgraded(arrays: Arrays, written: int) -> Arrays:
    """Arrays of a state that was written in a format of an earlier version, as this version names them."""
    for older in range(written, FORMAT):
        arrays = UPGRADES[older](arrays)
    return arrays
