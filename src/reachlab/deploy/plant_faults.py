"""What happens to measurements on their way to a controller, in a check."""

from __future__ import annotations

from dataclasses import dataclass

from reachlab.settings.validation import Checked, Fraction, NonNegative


@dataclass(frozen=True)
class Faults(Checked):
    """What happens to measurements on their way."""

    delay: NonNegative = 0.0
    """Time by which every measurement comes late [s]."""
    jitter: NonNegative = 0.0
    """Up to so much more, at random [s]."""
    drop: Fraction = 0.0
    """Share of the measurements that are lost."""
    nan: Fraction = 0.0
    """Share of those in which a joint is not a number."""
    dead_after: NonNegative | None = None
    """Time in an episode after which no measurement comes any more [s]."""
