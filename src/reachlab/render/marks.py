"""What pictures show beside an arm: its target, how near is near enough, and the tool's path."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

TARGET_RADIUS = 0.022
"""Radius of the drawn target [m], or the success distance where that is smaller. This and all other lengths here are
for the tutorial's arm; beside another they are in proportion to its workspace."""

Colour = tuple[float, float, float]
"""Red, green and blue, each 0 to 1."""

WAITING, REACHED, PATH = (0.85, 0.12, 0.15), (0.13, 0.63, 0.33), (0.15, 0.39, 0.92)
"""Colours of the target before and while it is reached, and of the tool's path."""

BALL_OPACITY = 0.16
"""Of the ball around the target in which the tool is near enough."""

PATH_RADIUS = 0.002
"""Of the tool's drawn path [m]."""

NO_PATH = np.empty((0, 3))
"""Path of a tool that has not moved."""


@dataclass(frozen=True)
class Marks:
    """What is drawn beside an arm and its target.

    Attributes:
        success_distance: radius of the ball around the target in which the tool is near enough [m].
        reached: the target is reached now.
        path: points `[k, 3]` [m] through which the tool came.
    """

    success_distance: float = TARGET_RADIUS
    reached: bool = False
    path: np.ndarray = field(default_factory=NO_PATH.copy)

    @property
    def colour(self) -> Colour:
        """Of the target."""
        return REACHED if self.reached else WAITING
