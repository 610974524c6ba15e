"""Whether an arm is free among bodies: by MuJoCo, in microseconds, with the shapes that its contacts are judged by."""

from __future__ import annotations

import functools
from collections.abc import Mapping

import mujoco
import numpy as np

NEAR = 0.1
"""Distance beyond which `distances` tells none apart [m]."""


RESOLUTION = 0.03
"""Distance between the points of a path that have to be free [rad]."""


class CollisionChecker:
    """An arm, the table and room for bodies; it needs neither JAX nor a simulator."""

    def __init__(self, model: mujoco.MjModel, n: int, bodies: list[int]) -> None:
        """Of a model with an arm of `n` joints and geoms for bodies, see `contact_model.collision_checker`."""
        self._model, self._n, self._bodies, self._data = model, n, bodies, mujoco.MjData(model)
        holders = model.geom_bodyid[np.stack([model.pair_geom1, model.pair_geom2])]
        self._own = holders.min(axis=0) > 0

    def place(self, geoms: Mapping[str, np.ndarray]) -> None:
        """Put the bodies where they are, of MuJoCo's arrays `[K, *]` by name, see `contact_model.Geoms`."""
        for name, numbers in geoms.items():
            getattr(self._model, name)[self._bodies] = numbers

    def keep(self, outside: float, own: float) -> None:
        """Count as free what is so far from bodies and the table, and links that are so far from each other [m]."""
        self._model.pair_margin[:] = np.where(self._own, own, outside)

    def free(self, q: np.ndarray) -> bool:
        """Whether the arm is free at joints `q [n]`."""
        data = self._data
        data.qpos[: self._n] = q
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_collision(self._model, data)
        return data.ncon == 0

    def straight(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Whether the arm is free on the straight way between joints `[n]`."""
        way = end - start
        return all(self.free(start + share * way) for share in _shares(int(np.linalg.norm(way) / RESOLUTION)))

    def distances(self, q: np.ndarray) -> tuple[float, float]:
        """Distance of the arm at joints `q [n]` from bodies and the table, and of its links from each other [m]."""
        before = self._model.pair_margin.copy()
        self.keep(NEAR, NEAR)
        self.free(q)
        self._model.pair_margin[:] = before
        contacts = self._data.contact
        own = (self._model.geom_bodyid[contacts.geom] > 0).all(axis=1)
        return min(contacts.dist[~own], default=NEAR), min(contacts.dist[own], default=NEAR)


@functools.cache
def _shares(between: int) -> np.ndarray:
    """Shares of a way at which it is looked at `[between + 2]`: its ends first, then such that gaps are halved."""
    order = sorted(range(between + 1), key=lambda number: f"{number:016b}"[::-1])
    return np.array([between + 1, *order]) / (between + 1)
