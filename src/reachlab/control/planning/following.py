"""Commands along a planned motion, for arms whose joints follow late; and when a policy needs none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

GAIN = 0.5
"""Share of what an arm lags more than its servos do that its command is corrected by in a time of their lag."""

PATIENCE, PROGRESS = 0.2, 0.002
"""A policy is taken over from where the tool has not come so much nearer [m] in so long a time [s]."""

DETOUR, REST = 1.75, 0.3
"""A policy's way is taken where it lasts up to so many times as long as the joints would take straight to the goal at
full speed, as planned ways do in the median, and so long to come to rest there [s]."""


SHORTEST = 1e-6
"""Stands for a lag that is shorter [s]."""


class Trajectory(NamedTuple):
    """Joints `q [T, n]` and the commands `[T, n]` that bring them there, from rest to rest, a period apart."""

    q: np.ndarray
    command: np.ndarray


class Follower:
    """Follows motions, and corrects what an arm lags more than was expected."""

    def __init__(self, lag: Sequence[float] | np.ndarray, speed: Sequence[float] | np.ndarray, period: float) -> None:
        """Of joints that follow by times `[n]` [s] and are as fast [rad/s or m/s], commanded a period [s] apart."""
        self._most, self._gain = np.array(speed) * period, GAIN * period / np.maximum(lag, SHORTEST)

    def command(self, motion: Trajectory, step: int, q: np.ndarray, given: np.ndarray) -> np.ndarray:
        """The command `[n]` after `given [n]` that brings joints `q [n]` to the next step of a motion."""
        now, then = min(step, len(motion.q) - 1), min(step + 1, len(motion.q) - 1)
        moved = motion.command[then] - motion.command[now] + self._gain * (motion.q[now] - q)
        return given + np.clip(moved, -self._most, self._most)


def gap(pose: Sequence[Any], goal: Sequence[Any], turn: float) -> float:
    """Distance of a pose, position [m] and quaternion wxyz, from another, an angle counting as `turn` m/rad."""
    (position, quaternion), (wanted, turned) = pose, goal
    away = float(np.linalg.norm(np.subtract(position, wanted)))
    return away + (turn * 2.0 * math.acos(min(abs(float(np.dot(quaternion, turned))), 1.0)) if turn else 0.0)


def longest_way(start: np.ndarray, goal: np.ndarray, speed: Sequence[float] | np.ndarray) -> np.ndarray:
    """Time that a policy's way from joints `start` to `goal [..., n]` may take where a motion can be planned [s]."""
    return REST + DETOUR * (np.abs(goal - start) / speed).max(axis=-1)
