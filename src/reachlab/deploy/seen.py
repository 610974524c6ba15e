"""What was seen at a time, and how fast it moved since the time before."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

RECENT = 0.2
"""Time between two poses or joint vectors from which a velocity follows, and age of a wrench, at most [s]."""


class Seen(NamedTuple):
    """A place or joints `[k]`, when they were seen [s], and their velocity by the time before, 0 without one."""

    place: np.ndarray
    time: float
    velocity: np.ndarray


def seen(place: Sequence[float], when: float, before: Seen | None) -> Seen:
    """What is seen at a time [s], after what was seen before."""
    now, velocity = np.array(place), np.zeros(len(place))
    if before and 0.0 < (since := when - before.time) < RECENT:
        velocity = (now - before.place) / since
    return Seen(now, when, velocity)
