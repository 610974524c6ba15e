"""A controller that runs an exported policy on an arm, with NumPy and the standard library alone.

    controller = Controller("policy/")
    controller.reset(measured_q)
    while True:  # at every control period, with seconds of a clock that never runs back
        command = controller.step(measured_q, measured_qd, goal, time)

`command` are joint positions in the order of `controller.joints`, for a position controller that follows at once.

Written by reachlab 0.1.0 from its own modules: mend it there.
"""

from __future__ import annotations

import hashlib
import json
import math
import numpy as np
import struct
from collections import deque
from collections.abc import Callable
from copy import copy
from pathlib import Path
from typing import Any
from typing import Any, NamedTuple


# --- arm: Kinematics of one arm, in NumPy: the tool's pose, its Jacobian, and inverse kinematics.


TINY = 1e-6
"""Added to a length that divides [m]."""

JOINTS_OF_A_POSE = 6
"""Joints that place a tool in any orientation; with fewer its tilt alone is held."""


class Frames:
    """Where an arm's links are: transforms `[..., n, 4, 4]` of what each joint moves, and the tool's.

    Attributes:
        links: of the frames in which the joints turn or slide, after their motion.
        position: of the tool `[..., 3]` [m].
        rotation: its axes as columns `[..., 3, 3]`.
    """

    def __init__(self, links: np.ndarray, tool: np.ndarray) -> None:
        """Frames of the links and the tool."""
        self.links, self.position, self.rotation = links, tool[..., :3, 3], tool[..., :3, :3]

    def row(self, number: int) -> Frames:
        """Those of one of several joint vectors."""
        one = copy(self)
        one.links, one.position, one.rotation = self.links[number], self.position[number], self.rotation[number]
        return one


class Arm:
    """A serial chain of hinge and slide joints. Joints are `[..., n]` rad or m, in any number."""

    def __init__(self, facts: dict[str, Any], limits: dict[str, np.ndarray], constants: dict[str, float]) -> None:
        """The arm of a policy's facts, the limits of its joints, and the constants of its inverse kinematics."""
        self.fixed = np.array(facts["frames"], float)
        self.slides = np.array(facts["slides"], bool)
        self.hinges, self.any_slides = ~self.slides, bool(self.slides.any())
        self.lower, self.upper, self.speed = (limits[name] for name in ("lower", "upper", "speed"))
        self.home, self.approach = (np.array(facts[name], float) for name in ("home", "approach"))
        self.n, self.constants = len(self.slides), constants
        self.poses = self.n >= JOINTS_OF_A_POSE

    def frames(self, q: np.ndarray) -> Frames:
        """Where the links are at joints `[..., n]`."""
        fixed = self.fixed[:-1]
        cos, sin = (np.where(self.slides, usual, f(q))[..., None] for usual, f in ((1.0, np.cos), (0.0, np.sin)))
        moved = np.empty((*q.shape, 4, 4))
        moved[..., 0] = fixed[:, :, 0] * cos + fixed[:, :, 1] * sin
        moved[..., 1] = fixed[:, :, 1] * cos - fixed[:, :, 0] * sin
        moved[..., 2] = fixed[:, :, 2]
        moved[..., 3] = fixed[:, :, 3]
        if self.any_slides:
            moved[..., 3] += fixed[:, :, 2] * np.where(self.slides, q, 0.0)[..., None]
        for i in range(1, self.n):
            moved[..., i, :, :] = moved[..., i - 1, :, :] @ moved[..., i, :, :]
        return Frames(moved, moved[..., -1, :, :] @ self.fixed[-1])

    def linear(self, frames: Frames) -> np.ndarray:
        """How the joints move the tool `[..., n, 3]`."""
        axes, arms = frames.links[..., :3, 2], frames.position[..., None, :] - frames.links[..., :3, 3]
        moves = cross(axes, arms)
        return np.where(self.slides[:, None], axes, moves) if self.any_slides else moves

    def angular(self, frames: Frames) -> np.ndarray:
        """How the joints turn the tool `[..., n, 3]`."""
        return np.where(self.hinges[:, None], frames.links[..., :3, 2], 0.0)

    def point_step(self, frames: Frames, command: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Displacement `[n]` of a command `[n]` that moves the tool by `wanted [3]` m, linearised where it is now."""
        columns = self.linear(frames)
        stopped, free = np.zeros(self.n), np.ones(self.n)
        step = stopped
        for _ in range(int(self.constants["LIMIT_PASSES"])):
            left = wanted - stopped @ columns
            solved = least_squares(columns * free[:, None], left, self.constants["POINT_DAMPING"])
            asked = command + (stopped + solved)
            allowed = np.minimum(np.maximum(asked, self.lower), self.upper)
            step, met = allowed - command, (allowed != asked) & (free > 0)
            if not met.any():
                break
            free = np.where(met, 0.0, free)
            stopped = np.where(free > 0, 0.0, step)
        return step

    def displaced(self, q: np.ndarray, displacement: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Joints `[n]` one step from `[n]` towards a tool displaced by `[3]` m, in an orientation `[3, 3]`."""
        frames = self.frames(q)
        turn, columns = self.turn_to(frames, rotation)
        size = np.sqrt((turn**2).sum())
        turn = turn * (self.constants["MAX_TURN"] / max(size, self.constants["MAX_TURN"]))
        error = np.concatenate([displacement, turn])
        return self.bounded_step(q, columns, error, self.constants["DAMPING"], self.constants["MAX_JOINT_STEP"])

    def turn_to(self, frames: Frames, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation error `[..., 3]` from the tool to an orientation `[3, 3]`, and the Jacobian `[..., n, 6]` for it."""
        linear, angular = self.linear(frames), self.angular(frames)
        if self.poses:
            return rotation_error(frames.rotation, rotation), np.concatenate([linear, angular], axis=-1)
        axis, down = frames.rotation @ self.approach, (rotation @ self.approach)[2]
        out = frames.position - frames.links[..., 0, :3, 3]
        length = np.sqrt(out[..., 0] ** 2 + out[..., 1] ** 2) + TINY
        across = np.stack([-out[..., 1] / length, out[..., 0] / length, np.zeros_like(length)], axis=-1)
        aside = np.sqrt(max(1.0 - down**2, 0.0))
        wanted = np.stack([aside * across[..., 1], -aside * across[..., 0], np.full_like(length, down)], axis=-1)
        turn = across * (across * cross(axis, wanted)).sum(axis=-1, keepdims=True)
        about = across[..., None, :]
        return turn, np.concatenate([linear, about * (about * angular).sum(axis=-1, keepdims=True)], axis=-1)

    def bounded_step(
        self, q: np.ndarray, columns: np.ndarray, error: np.ndarray, damping: Any, bound: float
    ) -> np.ndarray:
        """Joints `[..., n]` after a step that mends an error `[..., 6]`, of at most `bound` a joint, in the limits."""
        step = least_squares(columns, error, damping)
        scale = bound / np.maximum(np.abs(step).max(axis=-1, keepdims=True), bound)
        clipped = np.clip(q + scale * step, self.lower, self.upper)
        linear = columns[..., :3]
        left = scale * error[..., :3] - ((clipped - q)[..., None] * linear).sum(axis=-2)
        free = (clipped > self.lower) & (clipped < self.upper)
        repair = least_squares(linear * free[..., None], left, damping)
        shorten = bound / np.maximum(np.abs(repair).max(axis=-1, keepdims=True), bound)
        return np.clip(clipped + shorten * repair, self.lower, self.upper)


def least_squares(columns: np.ndarray, error: np.ndarray, damping: Any) -> np.ndarray:
    """Damped least-squares step `[..., n]` of a Jacobian `[..., n, m]` for an error `[..., m]`."""
    gram = np.swapaxes(columns, -1, -2) @ columns
    gram = gram + np.asarray(damping)[..., None, None] * np.eye(gram.shape[-1])
    return (columns @ np.linalg.solve(gram, error[..., None]))[..., 0]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Vector product `[..., 3]`; of so few numbers faster than NumPy's."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def rotation_error(current: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Rotation vector `[..., 3]` from one orientation `[..., 3, 3]` to another, as 2 sin(θ/2) times the axis."""
    return 2.0 * quaternion_of(target @ np.swapaxes(current, -1, -2))[..., 1:]


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternion wxyz `[..., 4]` with w >= 0 of an orientation `[..., 3, 3]` (Shepperd 1978)."""
    if rotation.ndim == 2:
        return _single_quaternion(rotation)
    r = rotation
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    mx, my, mz = r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]
    px, py, pz = r[..., 2, 1] + r[..., 1, 2], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 0] + r[..., 0, 1]
    rows = (
        (1.0 + xx + yy + zz, mx, my, mz),
        (mx, 1.0 + xx - yy - zz, pz, py),
        (my, pz, 1.0 - xx + yy - zz, px),
        (mz, py, px, 1.0 - xx - yy + zz),
    )
    candidates = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    diagonal = np.stack([row[i] for i, row in enumerate(rows)], axis=-1)
    best = diagonal.argmax(axis=-1)[..., None]
    chosen = np.take_along_axis(candidates, best[..., None], axis=-2)[..., 0, :]
    scale = np.where(chosen[..., :1] < 0.0, -0.5, 0.5) / np.sqrt(np.take_along_axis(diagonal, best, axis=-1))
    return chosen * scale


def _single_quaternion(rotation: np.ndarray) -> np.ndarray:
    """The same of one orientation `[3, 3]`: a few numbers are faster outside NumPy."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    rows = (
        (1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy),
        (zy - yz, 1.0 + xx - yy - zz, yx + xy, xz + zx),
        (xz - zx, yx + xy, 1.0 - xx + yy - zz, zy + yz),
        (yx - xy, xz + zx, zy + yz, 1.0 - xx - yy + zz),
    )
    best = max(range(4), key=lambda i: rows[i][i])
    scale = (-0.5 if rows[best][0] < 0.0 else 0.5) / rows[best][best] ** 0.5
    return scale * np.array(rows[best])


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """Axes as columns `[3, 3]` of an orientation `[4]`, wxyz."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


# --- reading: Numbers as callers give them, whatever that is, and as people read them.


UNREADABLE = "not made of numbers"
"""What stands for a value that is not made of numbers; a log holds it as it is."""


def read_numbers(value: Any) -> Any:
    """An array of floats that nobody else holds; None of None, and `UNREADABLE` of what is not made of numbers."""
    if value is None:
        return None
    try:
        return np.array(value, float)
    except Exception:  # a caller's object may raise anything, and an arm that moves has to be stopped in order
        return UNREADABLE


def read_seconds(value: Any) -> float | None:
    """A finite time [s], or None."""
    try:
        seconds = float(value) if isinstance(value, (int, float, np.floating, np.integer)) else math.nan
    except Exception:  # as above: an int may be too large for a float
        return None
    return seconds if math.isfinite(seconds) else None


def read_obstacles(value: Any) -> Any:
    """A list of dicts of arrays; None of None, and `UNREADABLE` of anything else."""
    if value is None:
        return None
    try:
        return [{str(name): read_numbers(part) for name, part in one.items()} for one in value]
    except Exception:  # as above
        return UNREADABLE


def in_words(numbers: Any) -> str:
    """Numbers as text, to four digits; anything else as it is."""
    if not isinstance(numbers, (np.ndarray, np.generic)):
        return str(numbers)
    four = "{:.4g}".format
    return np.array2string(np.asarray(numbers), separator=", ", max_line_width=10_000, formatter={"float_kind": four})


# --- scene: Obstacles around one arm, in NumPy: what is nearest to its capsules, and displacements that keep clear of it.


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


# --- deciding: What a policy observes and what its action commands, in NumPy, for one arm: as in training.


class Goal:
    """Where the tool is asked to be.

    Attributes:
        position: `[3]` [m].
        quaternion: `[4]`, wxyz; None where any orientation will do.
        rotation: its axes as columns `[3, 3]`.
        velocity: `[3]` [m/s]; None where it does not move.
        joints: at which the tool is there `[n]`; None where they are not needed.
    """

    def __init__(
        self,
        position: np.ndarray,
        quaternion: np.ndarray | None = None,
        velocity: np.ndarray | None = None,
        joints: np.ndarray | None = None,
    ) -> None:
        """A goal; what a policy does not need may be left out."""
        self.velocity: Any
        self.joints: Any
        self.position, self.quaternion, self.velocity, self.joints = position, quaternion, velocity, joints
        self.rotation = np.eye(3) if quaternion is None else rotation_of(quaternion)


class Situation:
    """What is known in a control step: the measured joints, the goal, the last command and action, the obstacles."""

    def __init__(
        self,
        arm: Arm,
        q: np.ndarray,
        qd: np.ndarray,
        goal: Goal,
        command: np.ndarray,
        action: np.ndarray,
        obstacles: Any,
        scene: Any,
    ) -> None:
        """A situation; where the tool is follows, and in a scene what is around the arm as it is and as it is sent."""
        self.q, self.qd, self.goal, self.command, self.action = q, qd, goal, command, action
        self.obstacles = obstacles
        if scene is None:
            self.frames = arm.frames(q)
        else:
            both = arm.frames(np.stack([q, command]))
            self.frames, self.sent = both.row(0), both.links[1]
            self.around, self.around_sent = (Nearest(*row) for row in zip(*scene.nearest(both.links, obstacles)))
        self.way = goal.position - self.frames.position
        self.distance = float(np.sqrt(self.way @ self.way))
        self.turn = np.zeros(3) if goal.quaternion is None else rotation_error(self.frames.rotation, goal.rotation)


class Decider:
    """Observations and joint commands of one policy's task.

    Attributes:
        k: constants of its formulas.
        angle_weight: length for which an angle of 1 counts [m/rad].
        scene: what the arm has to know of itself among obstacles; None where there are none.
        size: numbers of an action.
    """

    def __init__(self, arm: Arm, facts: dict[str, Any]) -> None:
        """Of a policy's facts."""
        self._arm, self._facts, self.k = arm, facts, facts["constants"]
        self._fields = [field["name"] for field in facts["observation"]["fields"] if not field["picture"]]
        self._period, self._lag = float(facts["control_period"]), np.array(facts["arm"]["lag"], float)
        action = facts["action"]
        self._scale = np.array(action["scale"], float)
        self._low, self._high = (np.array(action[side], float) for side in ("low", "high"))
        self._held = rotation_of(np.array(facts["arm"]["held_quaternion"], float))
        self.angle_weight = float(facts["goal"]["angle_weight"])
        self.scene: Any = Scene(arm, facts["capsules"], self.k) if facts["capsules"] else None
        self._design = COMMANDED[action["name"]]
        self._most = arm.speed * self._period if facts["real_time"] else np.inf
        self.size = len(self._low)

    def observe(self, now: Situation) -> np.ndarray | None:
        """The observation's vector `[k]`, but for a picture; None where there is only that."""
        if not self._fields:
            return None
        return np.concatenate([OBSERVED[name](self, now) for name in self._fields])

    # --- actions ------------------------------------------------------------------------------------

    def command(self, now: Situation, action: np.ndarray) -> np.ndarray:
        """Joint command `[n]` that an action `[a]` asks for, no faster than the joints can follow."""
        wanted = self._design(self, now, action)
        return np.minimum(np.maximum(wanted, now.command - self._most), now.command + self._most)

    def move_tool(self, now: Situation, action: np.ndarray) -> np.ndarray:
        """The tool's command displaced, its orientation held."""
        return self._arm.displaced(now.command, action * self._scale, self._held)

    def move_joints(self, now: Situation, action: np.ndarray) -> np.ndarray:
        """Every joint's command displaced, as far as obstacles allow."""
        step = action * self._scale
        if now.obstacles is not None:
            step = self.scene.keep_clear(now.sent, now.around_sent, step)
            step = np.minimum(np.maximum(step, -self._scale), self._scale)
        return np.minimum(np.maximum(now.command + step, self._arm.lower), self._arm.upper)

    def correct_joints(self, now: Situation, action: np.ndarray) -> np.ndarray:
        """The same, added to what inverse kinematics would do."""
        corrected = self._towards(now) + self._worth(now) * action
        return self.move_joints(now, np.minimum(np.maximum(corrected, self._low), self._high))

    def _worth(self, now: Situation) -> float:
        k, away = self.k, now.distance
        if now.goal.velocity is not None:
            return k["MOVING_CORRECTION"]
        if now.goal.quaternion is not None:
            away += self.angle_weight * _angle(now.turn)
        most = k["CORRECTION"] if now.goal.joints is None else k["POSE_CORRECTION"]
        if now.obstacles is not None:
            most = k["CLUTTER_CORRECTION"]
        return most * min((away / k["CORRECTION_FADE"]) ** 2, 1.0)

    def _towards(self, now: Situation) -> np.ndarray:
        """What inverse kinematics would do, in actions `[n]`."""
        if now.goal.joints is not None:
            return self._to_joints(now)
        return self._to_point(now) if now.goal.velocity is None else self._with_point(now)

    def _to_joints(self, now: Situation) -> np.ndarray:
        k, period, speed = self.k, self._period, self._arm.speed
        way = now.goal.joints - now.q
        far = np.minimum(np.abs(way) / k["APPROACH_ANGLE"], 1.0)
        share = k["JOINT_NEAR"] + far * (k["JOINT_FAR"] - k["JOINT_NEAR"])
        rate = np.minimum(share / np.maximum(self._lag, k["TINY"]), 1 / period)
        asked = np.minimum(np.maximum(rate * way, -speed), speed)
        step = period * asked + far * k["FORESIGHT"] * self._lag * (asked - now.qd)
        return self._in_box(step)

    def _to_point(self, now: Situation) -> np.ndarray:
        k, lag = self.k, self._lag
        far = min(now.distance / k["APPROACH"], 1.0)
        caught_up = now.q + far * lag * now.qd
        gain = k["NEAR_GAIN"] + far * (k["FAR_GAIN"] - k["NEAR_GAIN"])
        share = min(gain * self._period / max(lag.max(), k["TINY"]), 1.0)
        return self._point_step(now, caught_up, now.goal.position, share)

    def _with_point(self, now: Situation) -> np.ndarray:
        lag = self._lag
        ahead = now.goal.position + (lag.max() + self.k["LEAD"] * self._period) * now.goal.velocity
        return self._point_step(now, now.q + lag * now.qd, ahead, 1.0)

    def _point_step(self, now: Situation, caught_up: np.ndarray, place: np.ndarray, share: float) -> np.ndarray:
        frames = self._arm.frames(caught_up)
        wanted = share * (place - frames.position)
        most = self.k["TOOL_SPEED"] * self._period / (np.sqrt(wanted @ wanted) + self.k["TINY"])
        return self._in_box(self._arm.point_step(frames, now.command, wanted * min(most, 1.0)))

    def _in_box(self, step: np.ndarray) -> np.ndarray:
        return np.minimum(np.maximum(step / self._scale, self._low), self._high)


def _angle(turn: np.ndarray) -> float:
    """Angle [rad] of a rotation error, which is twice the sine of its half."""
    return 2 * float(np.arcsin(min(np.sqrt(turn @ turn) / 2, 1.0)))


def _posed(quaternion: np.ndarray | None, position: np.ndarray, turned: Callable[[], Any]) -> np.ndarray:
    """A position, and where the goal has an orientation a quaternion too."""
    return position if quaternion is None else np.concatenate([position, turned()])


OBSERVED: dict[str, Callable[[Decider, Situation], np.ndarray]] = {
    "goal": lambda _, now: now.goal.position,
    "tool": lambda _, now: now.frames.position,
    "joints": lambda _, now: now.q,
    "joint_speeds": lambda _, now: now.qd,
    "lag": lambda _, now: now.command - now.q,
    "way": lambda _, now: now.way,
    "way_near": lambda decider, now: now.way / (now.distance + decider.k["NEAR"]),
    "last_action": lambda _, now: now.action,
    "tool_axes": lambda _, now: now.frames.rotation.T[:2].ravel(),
    "goal_axes": lambda _, now: now.goal.rotation.T[:2].ravel(),
    "turn": lambda _, now: now.turn,
    "turn_near": lambda decider, now: (
        now.turn / (np.sqrt(now.turn @ now.turn) + decider.k["NEAR"] / decider.angle_weight)
    ),
    "joint_way": lambda _, now: now.goal.joints - now.q,
    "goal_velocity": lambda _, now: now.goal.velocity,
    "clearance": lambda decider, now: decider.scene.clearance(now.around),
    "scene": lambda decider, now: decider.scene.basis(now.obstacles),
    "achieved_goal": lambda _, now: _posed(
        now.goal.quaternion, now.frames.position, lambda: quaternion_of(now.frames.rotation)
    ),
    "desired_goal": lambda _, now: _posed(now.goal.quaternion, now.goal.position, lambda: now.goal.quaternion),
}
"""What an observation may hold, by the name of its field: numbers `[k]` of a situation."""

COMMANDED: dict[str, Callable[[Decider, Situation, np.ndarray], np.ndarray]] = {
    "tool_delta": Decider.move_tool,
    "tool_step": Decider.move_tool,
    "joint_delta": Decider.move_joints,
    "joint_residual": Decider.correct_joints,
}
"""Action designs by name: the joint command `[n]` of an action `[a]`."""


# --- solving: Joints of a goal, found a few steps of a solver at a time, so that no control step waits for them.


class Solver:
    """Looks for joints at which the tool is at a goal.

    Of a pose the nearest of ten solutions; of a point the one next to home.

    Attributes:
        joints: those that were found `[n]`; None as long as, or where, none are.
        ended: it has ended.
    """

    def __init__(self, arm: Arm, position: np.ndarray, rotation: np.ndarray | None, near: np.ndarray) -> None:
        """For a position `[3]` m and an orientation `[3, 3]`, or any, next to joints `[n]`."""
        self._arm, self._position, self._rotation, self._near = arm, position, rotation, near
        self.joints: np.ndarray | None = None
        self.ended, self._steps = False, 0
        self._q = arm.home.copy()
        if rotation is not None:
            random = np.random.default_rng(0).uniform(arm.lower, arm.upper, (int(arm.constants["STARTS"]), arm.n))
            self._q = np.concatenate([near[None], arm.home[None], random])

    def advance(self, steps: int) -> None:
        """Take so many steps of the solver."""
        for _ in range(steps):
            if not self.ended:
                self._steps += 1
                (self._step_to_point if self._rotation is None else self._step_to_pose)()

    def _step_to_point(self) -> None:
        arm, k = self._arm, self._arm.constants
        frames = arm.frames(self._q)
        way = self._position - frames.position
        distance = np.sqrt(way @ way)
        if self._steps > k["POINT_ITERATIONS"]:
            self.joints, self.ended = (self._q if distance < k["POINT_NEAR"] else None), True
            return
        self._q = self._q + arm.point_step(
            frames, self._q, way * min(k["LONGEST_STEP"] / (distance + k["POINT_NEAR"]), 1.0)
        )

    def _step_to_pose(self) -> None:
        arm, k = self._arm, self._arm.constants
        frames = arm.frames(self._q)
        turn, columns = arm.turn_to(frames, np.asarray(self._rotation))
        error = np.concatenate([self._position - frames.position, turn], axis=-1)
        distance, angle = (np.sqrt((part**2).sum(axis=-1)) for part in (error[:, :3], turn))
        reached = (distance <= k["POSITION_TOLERANCE"]) & (angle <= k["ANGLE_TOLERANCE"])
        if reached.all() or self._steps > k["ITERATIONS"]:
            self._choose(reached)
            return
        damping = k["DAMPING"] + k["SUGIHARA"] * (distance**2 + angle**2)
        moved = arm.bounded_step(self._q, columns, error, damping, k["MAX_SOLVER_STEP"])
        self._q = np.where(reached[:, None], self._q, moved)

    def _choose(self, reached: np.ndarray) -> None:
        """Take the solution that is soonest reached; a hinge with more than a turn of play may be a turn away."""
        self.ended, arm = True, self._arm
        turns = np.where(arm.slides, 0.0, 2 * np.pi)
        back = self._q - turns * np.round((self._q - self._near) / (2 * np.pi))
        q = np.where((back >= arm.lower) & (back <= arm.upper), back, self._q)
        duration = np.where(reached, (np.abs(q - self._near) / arm.speed).max(axis=-1), np.inf)
        if reached.any():
            self.joints = q[duration.argmin()]


# --- aiming: The goal of a controller: taken as it is given, refused where it cannot be one, and the joints that it needs.


SOLVED_A_STEP = 4
"""Steps that the solver of a goal's joints takes in a control step."""

NEARBY = 0.1
"""How far outside the box of the goals that were trained a goal may be [m]."""


class Aim:
    """What the tool is asked to do.

    Attributes:
        goal: the goal; None where there is none, or its joints are still looked for.
        box: lower and upper corner `[2, 3]` of the goals that were trained [m].
        poses: goals are poses.
    """

    def __init__(self, arm: Arm, facts: dict[str, Any]) -> None:
        """Of an arm, and a policy's facts about its goals."""
        self._arm, self._facts, self.poses = arm, facts, bool(facts["orientation"])
        self.box = np.array([facts["low"], facts["high"]], float)
        self.clear()

    def clear(self) -> None:
        """Have no goal."""
        self.goal: Goal | None = None
        self._asked: tuple[Any, ...] | None = None
        self._solver: Solver | None = None
        self._time = 0.0

    def take(self, goal: Any, time: float, velocity: Any, joints: Any, near: np.ndarray) -> str:
        """Take a goal, and give why it is refused, if it is.

        Args:
            goal: numbers as `read_numbers` gives them, or None.
            time: of this control step [s].
            velocity: of the goal, likewise.
            joints: at which the tool is there, likewise.
            near: joints `[n]` next to which others are looked for.
        """
        if goal is None:
            self.goal = self._asked = None
            return ""
        joints = joints if self._facts["joints"] else None
        if wrong := self._wrong(goal, velocity, joints):
            return wrong
        if self._facts["moves"]:
            known = self._seen_velocity(goal[:3], time) if velocity is None else velocity
            self.goal, self._time = Goal(goal[:3], velocity=known), time
            return ""
        asked = (*goal.tolist(), None if joints is None else tuple(joints.tolist()))
        if asked != self._asked:
            self._asked, self._solver = asked, None
            self.goal = self._set(goal, joints, near)
        return self._look_for_joints()

    def _wrong(self, goal: Any, velocity: Any, joints: Any) -> str:
        wanted = {
            "goal": (goal, 7 if self.poses else 3),
            "goal's velocity": (velocity, 3),
            "goal's joints": (joints, self._arm.n),
        }
        for name, (numbers, size) in wanted.items():
            if isinstance(numbers, str):
                return f"the {name} must be {size} finite numbers, and is {numbers}"
            if numbers is not None and (numbers.shape != (size,) or not np.isfinite(numbers).all()):
                return f"the {name} must be {size} finite numbers, got {in_words(numbers)}"
        low, high = self.box
        if (goal[:3] < low - NEARBY).any() or (goal[:3] > high + NEARBY).any():
            return f"the goal {in_words(goal[:3])} is out of the workspace, {in_words(low)} to {in_words(high)} m"
        if self.poses and abs(np.linalg.norm(goal[3:]) - 1) > UNIT:
            return f"the goal's quaternion must have length 1, got {in_words(goal[3:])}"
        return ""

    def _set(self, goal: np.ndarray, joints: np.ndarray | None, near: np.ndarray) -> Goal | None:
        """The goal, or None where its joints have to be looked for."""
        if not self._facts["joints"]:
            return Goal(goal[:3])
        if joints is not None:
            return self._goal_at(joints)
        turned = Goal(goal[:3], goal[3:] / np.linalg.norm(goal[3:])).rotation if self.poses else None
        self._solver = Solver(self._arm, goal[:3], turned, near.copy())
        return None

    def _seen_velocity(self, place: np.ndarray, time: float) -> np.ndarray:
        """Velocity `[3]` m/s of a goal that is now at `[3]` m; nothing of one that has jumped."""
        last, passed = self.goal, time - self._time
        if last is None or passed <= 0:
            return np.zeros(3)
        velocity = (place - last.position) / passed
        return velocity if np.sqrt(velocity @ velocity) <= self._facts["fastest"] else np.zeros(3)

    def _look_for_joints(self) -> str:
        solver = self._solver
        if solver is None or self.goal is not None:
            return ""
        solver.advance(SOLVED_A_STEP)
        if not solver.ended:
            return ""
        if solver.joints is None:
            return "the goal is out of reach: no joints are found at which the tool is there"
        self.goal = self._goal_at(solver.joints)
        return ""

    def _goal_at(self, joints: np.ndarray) -> Goal:
        """The goal that the tool is at with joints `[n]`."""
        frames = self._arm.frames(joints)
        turned = quaternion_of(frames.rotation) if self.poses else None
        return Goal(frames.position, turned, joints=joints)


# --- folder: An exported folder, read with care: its parts belong together, and its limits are no wider than those exported.


FORMAT = 2
"""Of `policy.json`. In format 1 each limit stood twice, and none was protected."""

LIMITS = ("lower", "upper", "speed", "acceleration", "jerk")
"""Limits of a joint."""

FREE = ("limits", "sha256")
"""What the fingerprint of `policy.json` leaves out: the limits, which may be lowered, and the fingerprint."""


MOST = 2**28
"""Largest file of an exported folder [bytes]."""


def content_of(file: Path) -> bytes:
    """The bytes of a file of an exported folder; a pipe or a device is not waited for.

    Raises:
        OSError: it cannot be read, is not a regular file or is larger than `MOST`.
    """
    if file.exists() and not file.is_file():
        raise OSError(f"'{file}' is not a regular file")
    with file.open("rb") as opened:
        content = opened.read(MOST + 1)
    if len(content) > MOST:
        raise OSError(f"'{file}' is larger than {MOST >> 20} MB")
    return content


def fingerprint(facts: dict[str, Any]) -> str:
    """SHA-256 of the content of `policy.json` but for its limits, however its text is laid out."""
    kept = json.dumps({name: value for name, value in facts.items() if name not in FREE})
    plain = json.loads(kept, parse_int=_number, parse_float=_number)
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def _number(text: str) -> float:
    """A number of which some editors write 1.0 as 1, and -0.0 as 0."""
    return float(text) + 0.0


def read_folder(folder: Path) -> dict[str, Any]:
    """Content of the `policy.json` of an exported folder, in today's form.

    Raises:
        ValueError: it cannot be read, the folder's parts are of different exports or were changed, or a limit is wider
            than the one that was exported.
    """
    file = folder / "policy.json"
    try:
        facts = json.loads(content_of(file))
        known = facts["format"] in (1, FORMAT)
    except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
        why = (error.strerror if isinstance(error, OSError) else "") or repr(error)
        raise ValueError(
            f"'{file}' cannot be read as what `reachlab export` wrote ({why}): name a folder that it wrote."
        ) from None
    if not known:
        raise ValueError(
            f"'{file}' has format {facts['format']!r}, and formats 1 and {FORMAT} are read here: use the controller.py"
            " of its own folder, or export again."
        )
    try:
        if facts["format"] == 1:
            facts = _from_format_1(facts)
        elif fingerprint(facts) != facts["sha256"]:
            raise ValueError(
                f"'{file}' was changed beside its `limits`, the only part that may be: copy the exported folder again,"
                " or export again."
            )
        _check_files(folder, facts["files"])
        _check_limits(file, facts)
    except (AttributeError, LookupError, TypeError, OSError) as error:
        raise ValueError(f"'{file}' is not complete ({error!r}): copy the exported folder again.") from None
    return facts


def _check_files(folder: Path, files: dict[str, str]) -> None:
    """Refuse a file that was not exported together with `policy.json`; one that is not needed may be absent."""
    for name, expected in files.items():
        file = folder / name
        if file.exists() and hashlib.sha256(content_of(file)).hexdigest() != expected:
            raise ValueError(
                f"'{file}' is not the file that was exported with the policy.json beside it: the folder is made of"
                " different exports, or the file was changed; copy the whole folder again."
            )


def _check_limits(file: Path, facts: dict[str, Any]) -> None:
    limits, names = facts["limits"], [joint["name"] for joint in facts["joints"]]
    if sorted(limits) != sorted(names):
        raise ValueError(f"`limits` in '{file}' must be those of the joints {', '.join(names)}, got {list(limits)}.")
    for joint in facts["joints"]:
        if wrong := _wrong_limits(limits[joint["name"]], joint["widest"]):
            raise ValueError(
                f"`limits` of joint {joint['name']!r} in '{file}': {wrong} Limits may be lowered there, never widened."
            )


def _wrong_limits(limits: dict[str, Any], widest: dict[str, float]) -> str:
    """What is wrong with the limits of a joint, empty where nothing is."""
    if set(limits) != set(LIMITS):
        return f"they must be {', '.join(LIMITS)}, got {', '.join(limits)}."
    for name, value in limits.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < math.inf:
            return f"{name} must be a finite number, got {value!r}."
        if name in ("lower", "upper"):
            if not widest["lower"] <= value <= widest["upper"]:
                return f"{name} must be {widest['lower']:.6g} to {widest['upper']:.6g}, got {value!r}."
        elif not 0.0 < value <= widest[name]:
            return f"{name} must be above 0 and at most {widest[name]:.6g}, got {value!r}."
    return "" if limits["lower"] < limits["upper"] else "lower must be below upper."


def _from_format_1(facts: dict[str, Any]) -> dict[str, Any]:
    """Facts in today's form: of limits that stood at the joint and at the arm, the lower one holds."""
    arm, limits, joints = facts["arm"], {}, []
    for i, joint in enumerate(facts["joints"]):
        one = {name: joint[name] for name in LIMITS}
        one["lower"] = max(one["lower"], arm["lower"][i])
        one["upper"], one["speed"] = (min(one[name], arm[name][i]) for name in ("upper", "speed"))
        limits[joint["name"]] = one
        joints.append({**joint, "widest": one})
    return {**facts, "limits": limits, "joints": joints}


# --- log: A log of control steps, from which they can be taken again.


NOTED = ("q", "qd", "goal", "time", "velocity", "obstacles", "joints", "command", "problem")
"""What is kept of a control step."""

KEPT = 100_000
"""Entries that a log holds."""


class Log:
    """The last entries: control steps as `NOTED`, resets and stops as dicts. All of it is the log's own."""

    def __init__(self) -> None:
        """An empty one."""
        self._entries: deque[Any] = deque(maxlen=KEPT)

    def add(self, entry: Any) -> None:
        """Add an entry, of numbers as `reading` gives them."""
        self._entries.append(entry)

    def save(self, file: Path) -> None:
        """Write all of it, a line of JSON each."""
        with file.open("w", encoding="utf-8") as lines:
            for entry in self._entries:
                named = entry if isinstance(entry, dict) else dict(zip(NOTED, entry))
                lines.write(json.dumps(named, default=np.ndarray.tolist) + "\n")


def read_log(file: Path) -> list[dict[str, Any]]:
    """Entries of a log that was saved."""
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


# --- network: The policy's network in NumPy, and its weights from a file in the form of safetensors.


KINDS = {"F32": np.float32, "F64": np.float64}
"""Types of numbers in the file."""


def read_weights(file: Path) -> dict[str, np.ndarray]:
    """Arrays by name.

    Raises:
        ValueError: the file is not whole, or not in that form.
    """
    try:
        content = content_of(file)
        (size,) = struct.unpack("<Q", content[:8])
        header, data = json.loads(content[8 : 8 + size]), content[8 + size :]
        header.pop("__metadata__", None)
        arrays = {}
        for name, entry in header.items():
            first, end = entry["data_offsets"]
            arrays[name] = np.frombuffer(data[first:end], KINDS[entry["dtype"]]).reshape(entry["shape"])
    except (OSError, KeyError, ValueError, struct.error) as error:
        raise ValueError(f"'{file}' does not hold the weights of a policy: {error}") from None
    return arrays


class Network:
    """Actions of observations: a normaliser, layers with tanh between them, and for a picture an encoder before them.

    It computes as in training, in single precision.
    """

    def __init__(self, weights: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
        """The network of a policy's weights and facts."""
        self._layers, self._encoder = (_layers(weights, name) for name in ("actor", "encoder"))
        self._mean, self._scale = weights["normaliser.mean"], weights["normaliser.scale"]
        self._centre, self._half = weights["action.centre"], weights["action.half"]
        self._clip, self._bounds = np.float32(facts["observation_clip"]), None
        self._patch, self._white = int(facts["patch"]), np.float32(facts["white"])
        if facts["clip_actions"]:
            self._bounds = weights["action.low"], weights["action.high"]

    def act(self, vector: np.ndarray | None, picture: np.ndarray | None = None) -> np.ndarray:
        """Actions `[..., a]` of vectors `[..., k]` and pictures `[..., h, w]` uint8, of which one may be None."""
        parts = []
        if picture is not None:
            parts.append(self._encode(picture))
        if vector is not None:
            scaled = (vector.astype(np.float32) - self._mean) / self._scale
            parts.append(np.minimum(np.maximum(scaled, -self._clip), self._clip))
        x = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)
        for weight, bias in self._layers[:-1]:
            x = np.tanh(x @ weight + bias)
        weight, bias = self._layers[-1]
        action = self._centre + self._half * (x @ weight + bias)
        return action if self._bounds is None else np.minimum(np.maximum(action, self._bounds[0]), self._bounds[1])

    def _encode(self, picture: np.ndarray) -> np.ndarray:
        """Features `[..., f]`: of squares of the picture, then of all of them."""
        (patches, bias), (gather, bias_2), (output, bias_3) = self._encoder
        *batch, height, width = picture.shape
        side = self._patch
        x = picture.reshape(-1, height // side, side, width // side, side).transpose(0, 1, 3, 2, 4)
        x = x.reshape(-1, side**2).astype(np.float32) / self._white - np.float32(0.5)
        x = np.maximum(x @ patches + bias, 0).reshape(-1, gather.shape[0])
        x = np.maximum(x @ gather + bias_2, 0)
        return (x @ output + bias_3).reshape(*batch, -1)


def _layers(weights: dict[str, np.ndarray], name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    count = sum(key.startswith(f"{name}.") and key.endswith(".weight") for key in weights)
    return [(weights[f"{name}.{i}.weight"], weights[f"{name}.{i}.bias"]) for i in range(count)]


def onnx_network(file: Path) -> Any:
    """The same function of one observation, by ONNX Runtime.

    Raises:
        ModuleNotFoundError: it is not installed.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session: Any = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    inputs = session.get_inputs()
    vectors = [one for one in inputs if one.type == "tensor(float)"]
    ends = np.cumsum([one.shape[1] for one in vectors])[:-1]

    def act(vector: np.ndarray | None, picture: np.ndarray | None = None) -> np.ndarray:
        given = {one.name: picture[None] for one in inputs if one not in vectors and picture is not None}
        if vector is not None:
            parts = np.split(vector.astype(np.float32), ends)
            given.update({one.name: part[None] for one, part in zip(vectors, parts)})
        return session.run(None, given)[0][0]

    return act


# --- watching: Whether measurements can be believed, and whether the controller is called in time.


GRACE = 0.06
"""Time for which the last good measurement is used where none comes that can be [s]; then the arm brakes."""

BEYOND = 0.2
"""How far a joint may be measured past its limits, where it swings for moments, or away from its command [rad or m]."""

FASTER = 3.0
"""How much faster than its limit a joint may be measured to be."""

JUMP = 0.1
"""How far a joint may be from where it was, beside what its speed explains [rad or m]."""

MOVED = 0.005
"""A measurement that stays the same for `GRACE` while the command moves so far is not one [rad or m]."""

DRIFTED = 0.0005
"""Nor is one while its own speeds say that a joint moves so far [rad or m]."""


CALLS, OFF = 15, 0.25
"""Calls whose mean rate is compared with the policy's, and by what share it may differ."""


class Watch:
    """Looks at every measurement before it is used.

    Attributes:
        q, qd: the last measurement that was good.
    """

    def __init__(self, facts: dict[str, Any], widest: dict[str, np.ndarray]) -> None:
        """For the arm of a policy's facts, which can do what its widest limits say."""
        self._names = [joint["name"] for joint in facts["joints"]]
        self._lower, self._upper, self._speed = (widest[name] for name in ("lower", "upper", "speed"))
        self._lag = np.array(facts["arm"]["lag"], float)
        self._period = float(facts["control_period"])
        self._repeats = max(int(GRACE / self._period + 1e-6), 2)
        self.reset(np.array(facts["arm"]["home"], float))

    def reset(self, q: np.ndarray) -> None:
        """Begin anew with an arm that rests at joints `[n]`."""
        self.q, self.qd = q.copy(), np.zeros_like(q)
        self._time: float | None = None
        self._good, self._same, self._command, self._measured = 0.0, 0, q.copy(), False
        self._passed: deque[float] = deque(maxlen=CALLS)

    def look(self, q: Any, qd: Any, time: float | None, command: np.ndarray) -> tuple[str, bool]:
        """What is wrong, empty where nothing is, and whether the arm has to brake for it.

        Args:
            q: measured joints, as `read_numbers` gives them.
            qd: their speeds, likewise.
            time: of this control step [s], as `read_seconds` gives it.
            command: the last joint command `[n]`.
        """
        if time is None:
            return "the time is not a finite number", True
        before, self._time = self._time, time
        if before is None:
            self._good = time
        elif time <= before:
            self._good = time
            self._passed.clear()
            return f"the clock runs back or stands still, at {time:g} s after {before:g} s", True
        wrong = self._wrong(q, qd, command, time - self._good)
        frozen = ""
        if not wrong:
            frozen = self._frozen(q, qd, command)
            self.q, self.qd, self._good, self._measured = q, qd, time, True
        if before is not None and time - before > GRACE:
            self._passed.clear()
            return f"called {time - before:.3f} s after the last time, more than {GRACE:g} s", True
        if frozen:
            return frozen, True
        rate, too_fast = ("", False) if before is None else self._off_rate(time - before)
        return wrong or rate, too_fast or (bool(wrong) and time - self._good >= GRACE - 1e-9)

    def _off_rate(self, passed: float) -> tuple[str, bool]:
        """What is wrong with the rate of calls, and whether they are too many: commands then leave limits of speed."""
        self._passed.append(passed)
        mean = sum(self._passed) / len(self._passed)
        if len(self._passed) < CALLS or abs(self._period / mean - 1.0) <= OFF:
            return "", False
        rates = f"step is called at {1 / mean:.3g} Hz, and the policy's rate is {1 / self._period:.3g} Hz"
        return f"{rates}: call it every {self._period:g} s", mean < self._period

    def _wrong(self, q: Any, qd: Any, command: np.ndarray, since: float) -> str:
        """What is wrong with a measurement that comes so long [s] after the last good one."""
        if q is None or qd is None:
            return "no measurement has come"
        if isinstance(q, str) or isinstance(qd, str):
            return "the measurement is not made of numbers"
        if q.shape != self.q.shape or qd.shape != self.q.shape:
            return f"the measurement has {q.size} joints and {qd.size} speeds, the arm {self.q.size}"
        if not (np.isfinite(q).all() and np.isfinite(qd).all()):
            return "the measurement is not finite"
        jumped = np.abs(q - self.q) > JUMP + FASTER * self._speed * since * self._measured
        if jumped.any() and not self._measured:
            i = int(jumped.argmax())
            return (
                f"joint {self._names[i]!r} is measured at {in_words(q[i])}, and commands begin at"
                f" {in_words(self.q[i])}: call reset with the joints at which the arm is measured to rest"
            )
        for wrong, what in (
            ((q < self._lower - BEYOND) | (q > self._upper + BEYOND), "measured out of its limits"),
            (np.abs(qd) > FASTER * self._speed, "measured faster than it can be"),
            (jumped, "measured to have jumped"),
            (np.abs(q - command) > BEYOND + 2 * self._lag * self._speed, "not where it was sent"),
        ):
            if wrong.any():
                return f"joint {self._names[int(wrong.argmax())]!r} is {what}"
        return ""

    def _frozen(self, q: np.ndarray, qd: np.ndarray, command: np.ndarray) -> str:
        if (q == self.q).all() and (qd == self.qd).all():
            self._same += 1
        else:
            self._same, self._command = 0, command.copy()
        if self._same < self._repeats:
            return ""
        moved = np.abs(command - self._command).max() > MOVED
        drifted = np.abs(qd).max() * self._same * self._period > DRIFTED
        return f"the measurement has not changed for {self._same} steps, and the arm moves" if moved or drifted else ""


# --- motion_limits: Joint commands within limits of position, speed, acceleration and jerk, from which the arm can always stop in time.


Numbers = Any
"""An array, in JAX or NumPy."""

STOP_TIME = 0.18
"""Time in which an arm can come to rest from any motion that is commanded [s]."""

INSIDE = 1.0 - 1e-9
"""Share of the limits that is used: what is left over is for rounding."""


class Motion(NamedTuple):
    """The motion that has been commanded, `[..., n]` each: its position, speed and acceleration after the last command.

    And the way to stop that is known to keep all limits: it begins with a speed and an acceleration, and so many of its
    steps have been taken.
    """

    position: Numbers
    speed: Numbers
    acceleration: Numbers
    stop_speed: Numbers
    stop_acceleration: Numbers
    stop_step: Numbers


class MotionLimits:
    """Limits of an arm's joints, and how commands are kept within them.

    Speed, acceleration and jerk are the differences of commands that are one control period apart. Each next command is
    chosen so that a way to stop from there, in `STOP_TIME` and within all limits, is known too. Where no command like
    that is found, the next step of the way that was known before is taken: limits are never left.

    The way to stop is linear in speed and acceleration: of all sequences of accelerations that end at rest the one with
    the least sum of squares of `acceleration / its limit` and `jerk / its limit`. All limits along it are then
    intervals of the next acceleration, and the commands that are allowed are their intersection.
    """

    def __init__(
        self, lower: Numbers, upper: Numbers, speed: Numbers, acceleration: Numbers, jerk: Numbers, period: float
    ) -> None:
        """Limits `[n]` [rad or m, and per s, s² and s³] of commands that are a `period` [s] apart."""
        lower, upper = np.asarray(lower, float), np.asarray(upper, float)
        self.lower, self.upper = lower, upper
        self.period, self.steps = period, max(int(STOP_TIME / period + 1e-6), 3)
        self.speed, self.jerk = INSIDE * np.asarray(speed, float), INSIDE * np.asarray(jerk, float)
        self.acceleration = INSIDE * np.asarray(acceleration, float)
        self.middle, self.n = (lower + upper) / 2, len(lower)
        ramps = self.acceleration / (self.jerk * period)
        # Of a stop that begins with a speed of 1, and with an acceleration of 1, `[steps + 1, n]`; at its end nothing.
        ways = np.stack([_ways_to_stop(self.steps, period, ramp) for ramp in ramps], axis=-1)
        self.from_speed, self.from_acceleration = ways[:, 0], ways[:, 1]
        self._set_rows(INSIDE * (upper - lower) / 2)

    def _set_rows(self, play: np.ndarray) -> None:
        """Write every limit as an interval of the next acceleration, `[rows, n]`.

        Its middle is `by_speed · speed + by_place · (middle - position)`, and `half` of its width follows.
        """
        period, first = self.period, np.ones((1, self.n))
        # What the next speed and acceleration, in this order, come to in each step from then on.
        speeds, accelerations = [], []
        for start, way in ((1.0, self.from_speed), (0.0, self.from_acceleration)):
            acceleration = np.concatenate([(1.0 - start) * first, way[:-1]])
            accelerations.append(acceleration)
            speeds.append(start + period * (np.cumsum(acceleration, axis=0) - acceleration[:1]))
        jerks = [np.diff(acceleration, axis=0) / period for acceleration in accelerations]
        places = [period * (np.cumsum(speed, axis=0) - speed[:1]) for speed in speeds]
        kinds = ((speeds, self.speed, 0.0), (accelerations, self.acceleration, 0.0), (jerks, self.jerk, 0.0))
        rows = [(*(np.asarray(part) for part in parts), limit, share) for parts, limit, share in kinds]
        rows.append((places[0] + period, places[1], play, 1.0))  # the next speed is one of the period before
        by_speed, by_place, half = [], [], []
        for of_speed, of_acceleration, limit, share in rows:
            slope = of_speed * period + of_acceleration
            slope = np.where(np.abs(slope) < 1e-12, 1e-12, slope)
            by_speed.append(-of_speed / slope)
            by_place.append(np.broadcast_to(share / slope, slope.shape))
            half.append(np.abs(limit / slope))
        self.by_speed, self.by_place, self.half = map(np.concatenate, (by_speed, by_place, half))

    def at_rest(self, q: Numbers, xp: Any = np) -> Motion:
        """The motion of an arm that rests at joints `q [..., n]`."""
        still = xp.zeros_like(q)
        return Motion(q, still, still, still, still, xp.full(q.shape, self.steps))

    def advance(self, motion: Motion, wanted: Numbers, brake: Numbers = False, xp: Any = np) -> Motion:
        """The motion after the next command, which is as near to `wanted [..., n]` as the limits allow.

        Where it is to `brake [...]`, it takes the next step of the way to stop.
        """
        period, speed, before = self.period, motion.speed, motion.acceleration
        place = (self.middle - motion.position)[..., None, :]
        middles = self.by_speed * speed[..., None, :] + self.by_place * place
        reach = self.jerk * period
        least = xp.maximum((middles - self.half).max(axis=-2), before - reach)
        most = xp.minimum((middles + self.half).min(axis=-2), before + reach)
        stop = xp.asarray(self.from_speed), xp.asarray(self.from_acceleration)
        place, joints = motion.stop_step, np.arange(self.n)
        known = stop[0][place, joints] * motion.stop_speed + stop[1][place, joints] * motion.stop_acceleration
        free = (least <= most) & ~xp.asarray(brake)[..., None]
        acceleration = xp.where(free, xp.clip(self._towards(motion, wanted, xp), least, most), known)
        speed = speed + period * acceleration
        return Motion(
            motion.position + period * speed,
            speed,
            acceleration,
            xp.where(free, speed, motion.stop_speed),
            xp.where(free, acceleration, motion.stop_acceleration),
            xp.where(free, 0, xp.minimum(place + 1, self.steps)),
        )

    def _towards(self, motion: Motion, wanted: Numbers, xp: Any) -> Numbers:
        """Acceleration `[..., n]` towards the speed that brings the command to `wanted`.

        It is what the next step takes or, where that is more, what the jerk can still bring back to nothing by then.
        """
        period, ramp = self.period, self.jerk * self.period / 2
        missing = xp.clip((wanted - motion.position) / period, -self.speed, self.speed) - motion.speed
        size = xp.abs(missing)
        bounded = xp.minimum(size / period, xp.sqrt(ramp**2 + 2 * self.jerk * size) - ramp)
        return xp.sign(missing) * bounded


def _ways_to_stop(steps: int, period: float, ramp: float) -> np.ndarray:
    """Accelerations `[steps + 1, 2]` that bring a speed of 1, and an acceleration of 1, to rest in so many steps.

    The limit of acceleration is `ramp` times what the jerk's limit changes it by in a step. The last but one is already
    zero, so that the jerk to it is within what is counted.
    """
    free = steps - 1
    differences = np.eye(steps, free) - np.eye(steps, free, -1)
    system = np.zeros((free + 1, free + 1))
    system[:free, :free] = np.eye(free) + ramp**2 * differences.T @ differences
    system[:free, free] = system[free, :free] = 1.0
    right = np.zeros((free + 1, 2))
    right[free, 0], right[0, 1] = -1.0 / period, ramp**2
    return np.concatenate([np.linalg.solve(system, right)[:free], np.zeros((2, 2))])


# --- controller: A controller that runs an exported policy on an arm, with NumPy and the standard library alone.


ASIDE = 0.01
"""How far past its limits an arm may rest that is taken over; its commands begin at the limit [rad or m]."""

NO_GOAL = "there is no goal, and the arm is held where it is"


class Controller:
    """Runs a policy: takes measurements and a goal, gives joint commands.

    Commands never leave the limits of position, speed, acceleration and jerk, whatever is measured or asked. Where a
    measurement cannot be believed, the last good one is used for 0.06 s; then, and where the controller is called late,
    the clock runs back or the goal is refused, the arm brakes: it is at rest 0.18 s later, and moves again when all is
    well. `problem` says why.

    Attributes:
        joints: names of the joints, in the order of all vectors.
        home: joints `[n]` in which episodes began in training [rad or m].
        period: time from one control step to the next [s].
        limits: of position, speed, acceleration and jerk: `limits` of `policy.json`, where they may be lowered.
        problem: what is wrong, or that there is no goal, in words; empty where neither is so.
        braking: the arm is brought to rest, or rests because it has to.
        asks_orientation: goals are poses.
        goal_box: lower and upper corner `[2, 3]` of the goals that were trained [m].
        home_quaternion: orientation `[4]`, wxyz, of the tool at home.
    """

    def __init__(self, folder: str | Path, *, runtime: str = "numpy") -> None:
        """Controller of the policy in a folder that `reachlab export` wrote.

        Args:
            folder: the folder, with `policy.json` and `policy.safetensors`.
            runtime: what computes the network: `numpy`, or `onnx` for ONNX Runtime and `policy.onnx`.

        Raises:
            ValueError: a file is broken or of another export, a limit is wider than what was exported, or there is no
                such runtime.
            ModuleNotFoundError: ONNX Runtime is asked for and not installed.
        """
        folder = Path(folder)
        facts = read_folder(folder)
        joints = facts["joints"]
        limits, widest = (
            {name: np.array([one[name] for one in rows], float) for name in LIMITS}
            for rows in ([facts["limits"][joint["name"]] for joint in joints], [joint["widest"] for joint in joints])
        )
        self.joints = [joint["name"] for joint in joints]
        self.home, self.period = np.array(facts["arm"]["home"], float), float(facts["control_period"])
        self._pictured = facts["observation"]["pictured"]
        self._arm = Arm(facts["arm"], limits, facts["constants"])
        self._aim = Aim(self._arm, facts["goal"])
        self.asks_orientation, self.goal_box = self._aim.poses, self._aim.box
        self.home_quaternion = quaternion_of(self._arm.frames(self.home).rotation)
        self._decider, self._watch = Decider(self._arm, facts), Watch(facts, widest)
        network = {"numpy": lambda: Network(read_weights(folder / "policy.safetensors"), facts["network"]).act}
        network["onnx"] = lambda: onnx_network(folder / "policy.onnx")
        if runtime not in network:
            raise ValueError(f"runtime must be numpy or onnx, got {runtime!r}.")
        self._act = network[runtime]()
        self.limits = MotionLimits(**limits, period=self.period)
        self._log = Log()
        self._make_anew()

    def reset(self, q: Any) -> None:
        """Begin anew with an arm that rests at joints `[n]`, as they are measured: also after `stop`.

        Raises:
            ValueError: they are not joints of this arm, within its limits.
        """
        q, arm = read_numbers(q), self._arm
        if not isinstance(q, np.ndarray) or q.shape != (arm.n,) or not np.isfinite(q).all():
            raise ValueError(f"reset takes {arm.n} measured joints, got {in_words(q)}.")
        outside = (q < arm.lower - ASIDE) | (q > arm.upper + ASIDE)
        if outside.any():
            i = int(outside.argmax())
            raise ValueError(
                f"joint {self.joints[i]!r} is at {in_words(q[i])}, out of its limits {in_words(arm.lower[i])} to"
                f" {in_words(arm.upper[i])}: move the arm to within them, and reset there."
            )
        self._start(q)
        self._log.add({"reset": q.tolist()})

    def _make_anew(self) -> None:
        """Be as a new controller, which begins at home where nothing else is measured."""
        self._start(self.home)
        self._is_new = True
        self._log.add({"reset": None})

    def _start(self, q: np.ndarray) -> None:
        self.motion = self.limits.at_rest(np.clip(q, self._arm.lower, self._arm.upper))
        self._watch.reset(q)
        self._aim.clear()
        self._action, self.problem = np.zeros(self._decider.size), ""
        self._stopped, self.braking, self._is_new = "", False, False

    def stop(self) -> None:
        """Brake, and stay at rest until `reset`."""
        self._stopped = "stop() was called"
        self._log.add({"stop": True})

    def step(
        self,
        q: Any,
        qd: Any,
        goal: Any,
        time: float,
        *,
        velocity: Any = None,
        obstacles: Any = None,
        picture: np.ndarray | None = None,
        joints: Any = None,
    ) -> np.ndarray:
        """Next joint command `[n]` [rad or m]; call it once in a control period. It raises nothing, see `problem`.

        Args:
            q: measured joints `[n]` [rad or m]; None where no measurement has come.
            qd: their speeds `[n]` [rad/s or m/s].
            goal: position of the tool `[3]` m or, for a policy that was trained on poses, position and quaternion
                wxyz `[7]`, in the frame of the arm's base; None holds the arm.
            time: of this step [s], by any clock that does not run back.
            velocity: of the goal `[3]` [m/s]; by default from its last positions.
            obstacles: for a policy that was trained among them, a list of dicts with `position`, and for boxes and
                capsules `quaternion`, `half` and `radius`, see `Obstacles`.
            picture: the camera's, for a policy that gets one, `[84, 84]` uint8.
            joints: joints at which the tool is at the goal, where they are known; by default they are looked for.
        """
        q, qd, goal, velocity, joints = (read_numbers(one) for one in (q, qd, goal, velocity, joints))
        seconds, around = read_seconds(time), read_obstacles(obstacles)
        self._hold_where_measured(q)
        before = self.motion.position
        problem, brake = self._watch.look(q, qd, seconds, before)
        wanted, refused = before, self._stopped
        at_rest = bool((self.motion.stop_step >= self.limits.steps).all())
        if not refused and seconds is not None:
            try:
                refused = self._aim.take(goal, seconds, velocity, joints, before)
                # An arm that rests because it has to finds out in every step whether it still has to.
                if self._aim.goal is not None and not (refused or brake or (self.braking and not at_rest)):
                    wanted, refused = self._decide(self._aim.goal, around, picture)
            except Exception as error:  # whatever it is, an arm in motion is brought to rest
                refused = f"{type(error).__name__}: {error}"
        was, now = self.braking and not at_rest, bool(refused or brake)
        self.problem = refused or problem or (self.problem if was else "") or (NO_GOAL if goal is None else "")
        self.braking = now or was
        self.motion = self.limits.advance(self.motion, wanted, self.braking)
        command = self.motion.position
        self._log.add((q, qd, goal, seconds, velocity, around, joints, command, self.problem))
        return command.copy()

    def _hold_where_measured(self, q: Any) -> None:
        """In a first step without a reset, stay where the arm is, if that is not home: no command may leap there."""
        was_new, self._is_new, begin = self._is_new, False, self.motion.position
        if not was_new or not isinstance(q, np.ndarray) or q.shape != begin.shape or not np.isfinite(q).all():
            return
        away = np.abs(q - begin)
        if (away > JUMP).any():
            self._start(q)
            i = int(away.argmax())
            self._stopped = (
                f"joint {self.joints[i]!r} is measured at {in_words(q[i])}, and without a reset commands begin at home,"
                f" {in_words(begin[i])}: call reset with the joints at which the arm is measured to rest"
            )

    @property
    def goal_joints(self) -> np.ndarray | None:
        """Joints `[n]` at which the tool is at the goal, where the policy needs them and they are found."""
        return None if self._aim.goal is None else self._aim.goal.joints

    # --- decisions ----------------------------------------------------------------------------------

    def _decide(self, goal: Goal, obstacles: Any, picture: np.ndarray | None) -> tuple[np.ndarray, str]:
        """The command with which the policy goes to a goal `[n]`, and why there is none, if so."""
        rest = self.motion.position
        if self._pictured and (picture is None or np.shape(picture) != tuple(self._pictured)):
            return rest, f"the policy needs a picture of {self._pictured} pixels"
        try:
            around = None if self._decider.scene is None else Obstacles(obstacles or [])
        except ValueError as error:
            return rest, str(error)
        now = Situation(self._arm, self._watch.q, self._watch.qd, goal, rest, self._action, around, self._decider.scene)
        seen = self._decider.observe(now)
        action = np.asarray(self._act(seen, picture if self._pictured else None), float)
        wanted = self._decider.command(now, action)
        if not np.isfinite(wanted).all():
            return rest, "the policy's command is not finite"
        self._action = action
        return wanted, ""

    # --- log ----------------------------------------------------------------------------------------

    def save_log(self, file: str | Path) -> None:
        """Write the last control steps, a line of JSON each; `replay` takes them again.

        Pictures are not kept, so that a policy that gets some cannot be replayed.
        """
        self._log.save(Path(file))

    def replay(self, file: str | Path) -> float:
        """Take the control steps of a log again, and give the largest difference of a command [rad or m].

        The log has to begin with a `reset`, as it does unless it has grown too long.
        """
        worst = 0.0
        for entry in read_log(Path(file)):
            if "reset" in entry:
                self._make_anew() if entry["reset"] is None else self.reset(entry["reset"])
            elif "stop" in entry:
                self.stop()
            else:
                expected, _ = entry.pop("command"), entry.pop("problem")
                worst = max(worst, float(np.abs(self.step(**entry) - expected).max()))
        return worst
