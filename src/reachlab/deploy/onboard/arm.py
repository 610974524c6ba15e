"""Kinematics of one arm, in NumPy: the tool's pose, its Jacobian, and inverse kinematics.

The same formulas as in training, where `reachlab.robots` has them for JAX, with their sources.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np

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
