"""What pictures show beside an arm: target, bodies, how near is near enough, orientations, and where both were."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from reachlab.control.bodies import Shape

TARGET_RADIUS = 0.022
"""Radius of the drawn target [m], or the success distance where that is smaller. This and all other lengths here are
for the tutorial's arm; beside another they are in proportion to its workspace."""

Colour = tuple[float, float, float]
"""Red, green and blue, each 0 to 1."""

WAITING, REACHED = (0.85, 0.12, 0.15), (0.13, 0.63, 0.33)
"""Colours of the target before and while it is reached."""

PATH, TRAIL = (0.15, 0.39, 0.92), (0.95, 0.55, 0.05)
"""Colours of the tool's path, and of the trail of a target that moves."""

AXES: tuple[Colour, Colour, Colour] = ((0.9, 0.15, 0.15), (0.1, 0.65, 0.2), (0.15, 0.3, 0.9))
"""Colours of the x, y and z axis of an orientation."""

TOOL_AXES, TARGET_AXES = (0.09, 0.005), (0.13, 0.003)
"""Length and radius of the drawn axes of the tool and of the target [m]: where both agree, the target's stand out."""

BALL_OPACITY = 0.16
"""Of the ball around the target in which the tool is near enough."""

PATH_RADIUS, TRAIL_RADIUS, TRAIL_OPACITY = 0.002, 0.006, 0.35
"""Of drawn paths and trails [m]: a tool that stays with its target is seen inside the trail."""

FIXED, OBJECT, TOUCHED = (0.48, 0.61, 0.66), (0.93, 0.58, 0.16), (0.85, 0.12, 0.15)
"""Colours of bodies, of those that are to be moved, and of those that the arm touches."""

GLASS = 0.4
"""Opacity of boxes that are in the way, such as the boards of a shelf: an arm is seen behind them."""

NO_PATH = np.empty((0, 3))
"""Path of what has not moved."""


@dataclass(frozen=True)
class Axes:
    """Axes that show an orientation.

    Attributes:
        position: where they meet `[3]` [m].
        quaternion: the orientation `[4]`, wxyz.
        size: their length and radius, beside the tutorial's arm [m].
    """

    position: np.ndarray
    quaternion: np.ndarray
    size: tuple[float, float]


@dataclass(frozen=True)
class Block:
    """A body.

    Attributes:
        position: its middle `[3]` [m].
        quaternion: its orientation `[4]`, wxyz.
        kind: its shape, a number of MuJoCo's `mjtGeom`.
        size: MuJoCo's sizes of it `[3]` [m].
        present: it is there; a scene has room for more.
        touched: the arm touches it, and must not.
        is_object: it is to be moved.
    """

    position: np.ndarray
    quaternion: np.ndarray
    kind: int
    size: np.ndarray
    present: bool = True
    touched: bool = False
    is_object: bool = False

    @property
    def colour(self) -> Colour:
        """Of the body."""
        return TOUCHED if self.touched else OBJECT if self.is_object else FIXED

    @property
    def opacity(self) -> float:
        """Of the body."""
        return GLASS if self.kind == Shape.BOX and not self.is_object else 1.0


@dataclass(frozen=True)
class Marks:
    """What is drawn beside an arm and its target.

    Attributes:
        success_distance: radius of the ball around the target in which the tool is near enough [m].
        reached: the target is reached now.
        path: points `[k, 3]` [m] through which the tool came.
        trail: points `[k, 3]` [m] at which the target has been, if it moves.
        axes: orientations.
        blocks: bodies.
    """

    success_distance: float = TARGET_RADIUS
    reached: bool = False
    path: np.ndarray = field(default_factory=NO_PATH.copy)
    trail: np.ndarray = field(default_factory=NO_PATH.copy)
    axes: tuple[Axes, ...] = ()
    blocks: tuple[Block, ...] = ()

    @property
    def colour(self) -> Colour:
        """Of the target."""
        return REACHED if self.reached else WAITING
