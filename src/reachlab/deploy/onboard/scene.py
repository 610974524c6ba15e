"""Obstacles around one arm, in NumPy: what is nearest to its capsules, and displacements that keep clear of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from reachlab.deploy.onboard.arm import Arm, cross, rotation_of

LENGTH = 1e-9
"""Added to a length that divides [m]."""


class Obstacles:
    """Obstacles: boxes swept by a ball. Without half sizes a ball, with that along z alone a capsule.

    Each is a dict with `position [3]` m and, where it has them, `quaternion [4]` wxyz, `half [3]` m and `radius` m.
    """

    def __init__(self, obstacles: Any) -> None:
        """Of a list of dicts.

        Raises:
            ValueError: a number is missing, or is not finite.
        """
        self.position = np.array([one["position"] for one in obstacles], float).reshape(-1, 3)
        turns = [rotation_of(np.array(one.get("quaternion", (1, 0, 0, 0)), float)) for one in obstacles]
        self.rotation = np.array(turns).reshape(-1, 3, 3)
        self.half = np.array([one.get("half", (0, 0, 0)) for one in obstacles], float).reshape(-1, 3)
        self.radius = np.array([one.get("radius", 0.0) for one in obstacles], float)
        parts = (self.position, self.rotation, self.half, self.radius)
        if len({len(part) for part in parts}) > 1 or not all(np.isfinite(part).all() for part in parts):
            raise ValueError("every obstacle needs a position, and finite numbers")

    def off(self, place: np.ndarray) -> np.ndarray:
        """How far places `[K, P, 3]`, each in an obstacle's frame, are out of its box."""
        half = self.half[:, None]
        return place - np.minimum(np.maximum(place, -half), half)

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Points `[P, 3]` in the frame of each obstacle `[K, P, 3]`."""
        return (points[None] - self.position[:, None]) @ self.rotation

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance `[P]` m from points `[P, 3]` to the nearest of them; far where there are none."""
        if not len(self.radius):
            return np.full(len(points), np.inf)
        away = np.sqrt((self.off(self.inside(points)) ** 2).sum(axis=-1)) - self.radius[:, None]
        return away.min(axis=0)


class Nearest(NamedTuple):
    """What is nearest to an arm's capsules.

    The distance `[..., C]` m from it, the direction from it and where on the capsule's axis `[..., C, 3]`.
    """

    distance: np.ndarray
    normal: np.ndarray
    point: np.ndarray


class Scene:
    """What an arm among obstacles has to know of itself: its capsules, and how far to stay away."""

    def __init__(self, arm: Arm, facts: dict[str, Any], constants: dict[str, float]) -> None:
        """Of the facts about an arm's capsules that its joints move, and the constants of the dampers."""
        self._arm, self._constants = arm, constants
        self._links = np.array(facts["links"], int)
        self._starts, self._ends = (np.array(facts[side], float) for side in ("starts", "ends"))
        self._radii = np.array(facts["radii"], float)
        self._floors = np.array([-np.inf if floor is None else floor for floor in facts["floors"]])
        self._scale = facts["scale"]
        low, high = np.array(facts["goal_box"], float)
        axes = [np.linspace(a, b, int(constants["BASIS"])) for a, b in zip(low, high)]
        self._basis = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def nearest(self, links: np.ndarray, obstacles: Obstacles) -> Nearest:
        """What is nearest to each capsule of arms whose links are at `[B, n, 4, 4]`."""
        own = links[:, self._links - 1]
        rotation, place = own[..., :3, :3], own[..., :3, 3]
        start, end = (place + (rotation @ side[:, :, None])[..., 0] for side in (self._starts, self._ends))
        point = np.where(start[..., 2:] < end[..., 2:], start, end)
        distance, normal = point[..., 2] - self._floors, np.broadcast_to([0.0, 0.0, 1.0], point.shape)
        if len(obstacles.radius):
            others, ways, points = self._beside(start.reshape(-1, 3), end.reshape(-1, 3), obstacles)
            chosen, row = others.argmin(axis=0), np.arange(distance.size)
            other = others[chosen, row].reshape(distance.shape)
            nearer = other < distance
            distance = np.where(nearer, other, distance)
            normal = np.where(nearer[..., None], ways[chosen, row].reshape(normal.shape), normal)
            point = np.where(nearer[..., None], points[chosen, row].reshape(point.shape), point)
        return Nearest(distance - self._radii, normal, point)

    def _beside(
        self, start: np.ndarray, end: np.ndarray, obstacles: Obstacles
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        a, b = obstacles.inside(start), obstacles.inside(end)
        along = b - a
        low, high = np.zeros(a.shape[:2]), np.ones(a.shape[:2])
        for _ in range(int(self._constants["BISECTIONS"])):
            share = (low + high) / 2
            falls = (obstacles.off(a + along * share[..., None]) * along).sum(axis=-1) < 0
            low, high = np.where(falls, share, low), np.where(falls, high, share)
        place = a + along * ((low + high) / 2)[..., None]
        way = obstacles.off(place)
        length = np.sqrt((way**2).sum(axis=-1))
        back = np.swapaxes(obstacles.rotation, 1, 2)
        turned, points = (way / (length + LENGTH)[..., None]) @ back, place @ back + obstacles.position[:, None]
        return length - obstacles.radius[:, None], turned, points

    def keep_clear(self, links: np.ndarray, around: Nearest, step: np.ndarray) -> np.ndarray:
        """Joint displacement `[n]` that brings no capsule nearer to an obstacle than the dampers allow.

        From where the links are sent `[n, 4, 4]`, and what is `around` them.
        """
        k, (distance, normal, point) = self._constants, around
        axes, origins = links[:, :3, 2], links[:, :3, 3]
        moves = cross(axes[None], point[:, None] - origins[None])
        moves = np.where(self._arm.slides[:, None], axes, moves)
        rows = (normal[:, None] * moves).sum(axis=-1) * (np.arange(self._arm.n) < self._links[:, None])
        least = -k["RATE"] * np.maximum(distance - k["STOP"] * self._scale, -k["STOP"])
        scaled = rows / ((rows**2).sum(axis=1) + k["TINY"])[:, None]
        for _ in range(int(k["SWEEPS"])):
            if (rows @ step >= least).all():
                break
            for row, limit, change in zip(rows, least, scaled):
                missing = limit - row @ step
                if missing > 0:
                    step = step + missing * change
        return step

    def clearance(self, around: Nearest) -> np.ndarray:
        """Of each capsule the direction away from what is nearest, shorter the further away, `[3 C]`."""
        distance, normal, _ = around
        near = self._constants["CLOSE"] * self._scale
        close = near / (near + np.maximum(distance, 0.0))
        return (close * normal.T).ravel()

    def basis(self, obstacles: Obstacles) -> np.ndarray:
        """Nearness of obstacles to the points of a grid `[p]`."""
        near = self._constants["CLOSE"]
        return near / (near + np.maximum(obstacles.distance(self._basis) / self._scale, 0.0))
