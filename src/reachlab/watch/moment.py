"""What a page or a video shows of an arm at one moment."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

PATH_POINTS, PATH_STEP, TRAIL_STEP = 300, 0.004, 0.01
"""Points of a path at most, and their least distance [m]; and that of the points of a target's trail."""


@dataclass(frozen=True)
class Moment:
    """What there is to see.

    Attributes:
        q: joints `[n]` [rad or m].
        tool: where it is `[3]` [m].
        target, target_orientation: `[3]` [m] and `[4]` wxyz, `[0]` where any will do.
        distance, angle: from tool to target [m] and [rad], without numbers, `[0]`, where any orientation will do.
        error: root mean square of the distance so far [m]; None where it does not count, or not yet.
        reached: the tool is near enough now and, where the task asks for it, was held.
        path: points `[k, 3]` [m] through which the tool came.
        trail: points `[k, 3]` [m] at which a target that moves by itself has been.
    """

    q: np.ndarray
    tool: np.ndarray
    target: np.ndarray
    target_orientation: np.ndarray
    distance: float
    angle: np.ndarray
    error: float | None
    reached: bool
    path: np.ndarray
    trail: np.ndarray


@dataclass
class Trace:
    """Where something has been: its newest `PATH_POINTS` points `[k, 3]` [m], `step` [m] or more apart."""

    step: float
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))

    def add(self, point: np.ndarray) -> np.ndarray:
        """The points, this one `[3]` among them if it is far enough from the last; the same array where it is not."""
        if not len(self.points) or np.linalg.norm(self.points[-1] - point) >= self.step:
            self.points = np.concatenate([self.points[1 - PATH_POINTS :], point[None]])
        return self.points
