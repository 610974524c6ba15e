"""Obstacles around one arm, in NumPy: what is nearest to its capsules, and displacements that keep clear of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from reachlab.deploy.onboard.arm import Arm, cross, rotation_of
from reachlab.deploy.onboard.reading import in_words

LENGTH = 1e-9
"""Added to a length that divides [m]."""


SHAPES = {"position": (3,), "quaternion": (4,), "half": (3,), "radius": ()}
"""What an obstacle is made of, and of how many numbers."""

USUAL = {"quaternion": np.array([1.0, 0.0, 0.0, 0.0]), "half": np.zeros(3), "radius": np.array(0.0)}
"""What an obstacle has where nothing else is given."""

UNIT = 0.01
"""How far from 1 a quaternion's length may be."""


class Obstacles:
    """Obstacles: boxes swept by a ball. Without half sizes a ball, with that along z alone a capsule.

    Each is a dict with `position [3]` m and, where it has them, `quaternion [4]` wxyz, `half [3]` m and `radius` m.
    """

    def __init__(self, obstacles: Any) -> None:
        """Of dicts of arrays, as `read_obstacles` gives them.

        Raises:
            ValueError: one of them is none.
        """
        if isinstance(obstacles, str):
            raise ValueError("the obstacles are not a list of dicts of numbers")
        for number, one in enumerate(obstacles, 1):
            if wrong := _wrong_obstacle(one):
                raise ValueError(f"obstacle {number} {wrong}")
        whole = [{**USUAL, **one} for one in obstacles]
        self.position, turns, self.half, self.radius = (
            np.array([one[name] for one in whole]).reshape(-1, *shape) for name, shape in SHAPES.items()
        )
        self.rotation = np.array([rotation_of(turn / np.sqrt(turn @ turn)) for turn in turns]).reshape(-1, 3, 3)

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


def _wrong_obstacle(obstacle: dict[str, Any]) -> str:
    """What is wrong with an obstacle, empty where nothing is."""
    if unknown := [name for name in obstacle if name not in SHAPES]:
        return f"has {unknown[0]!r}, and an obstacle is made of {', '.join(SHAPES)}"
    if "position" not in obstacle:
        return "has no position"
    for name, numbers in obstacle.items():
        if not isinstance(numbers, np.ndarray) or numbers.shape != SHAPES[name] or not np.isfinite(numbers).all():
            return f"must have a {name} of {max(sum(SHAPES[name]), 1)} finite numbers, got {in_words(numbers)}"
    for name in ("half", "radius"):
        if name in obstacle and obstacle[name].min() < 0.0:
            return f"must have a {name} of at least 0 m, got {in_words(obstacle[name])}"
    turn = obstacle.get("quaternion", USUAL["quaternion"])
    return "" if abs(turn @ turn - 1.0) <= 2 * UNIT else f"must have a quaternion of length 1, got {in_words(turn)}"


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
