"""What planning has to know of an arm, as plain numbers: a controller reads them from a file."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reachlab.control.motion_limits import MotionLimits
from reachlab.control.planning.following import SHORTEST
from reachlab.robots.kinematics.transforms import moved_links

PLANNED, HALVING, SMOOTHING = 0.9, 0.06, 3.2
"""Of motions within limits of jerk: the share of the fastest speed that they have; how long jerk takes to reach the
limit of acceleration where they have half of it [s]; and over how many times as long commands are averaged. With these,
motions through random joint vectors leave what was planned by 6 mrad at most, on three arms."""


class Arm(NamedTuple):
    """An arm of `n` joints with a tool, on a table, its links contained in `C` capsules.

    Attributes:
        frames: what stands still before each joint, and after the last one `[n + 1, 4, 4]` [m]; see `Chain`.
        slides: which joints slide along the z axis of their frame; others turn about it `[n]`.
        lower, upper: limits of the joints `[n]` [rad or m].
        speed, acceleration: likewise, of motions that its servos follow [rad/s or m/s, and per s].
        smooth: time over which commands are averaged, where their jerk is bounded too; else 0 [s].
        lag: times by which the joints follow commands `[n]` [s].
        home: joints `[n]`.
        approach: axis of the tool's frame along which it points `[3]`.
        table: height of the table's top [m].
        scale: of its workspace.
        period: of its commands [s].
        links: which link carries each capsule `[C]`; 0 is the base, and link `k + 1` is what joint `k` moves.
        starts, ends, radii: where they are in their links' frames `[C, 3]`, `[C, 3]`, `[C]` [m].
        pairs: capsules that may not meet, by their numbers `[P, 2]`.
        floors: whether each of those that move may not meet the table.
    """

    frames: np.ndarray
    slides: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    smooth: float
    lag: np.ndarray
    home: np.ndarray
    approach: np.ndarray
    table: float
    scale: float
    period: float
    links: np.ndarray
    starts: np.ndarray
    ends: np.ndarray
    radii: np.ndarray
    pairs: np.ndarray
    floors: np.ndarray

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.slides)

    @property
    def share(self) -> np.ndarray:
        """Share of its way to a command that each joint takes in a period `[n]`."""
        return 1.0 - np.exp(-self.period / np.maximum(self.lag, SHORTEST))

    @property
    def poses(self) -> bool:
        """Whether it has the six joints that an orientation takes; with fewer the tool's tilt alone is held."""
        return self.n >= 6

    def within(self, limits: MotionLimits) -> Arm:
        """The same arm, whose commands are kept within limits of acceleration and jerk too."""
        ramp = limits.acceleration / limits.jerk
        return self._replace(
            lower=limits.lower,
            upper=limits.upper,
            speed=PLANNED * limits.fastest,
            acceleration=limits.acceleration / (1.0 + ramp / HALVING),
            smooth=max(SMOOTHING * float(ramp.max()), self.period),
        )

    def links_at(self, q: np.ndarray) -> np.ndarray:
        """Transforms `[..., n + 1, 4, 4]` of what the joints move at `q [..., n]`, and of the tool."""
        moved = moved_links(self.frames, self.slides, q)
        return np.stack([*moved, moved[-1] @ self.frames[-1]], axis=-3)
