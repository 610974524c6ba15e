"""Quantiles, and intervals of 95 %: of a rate over episodes, and of a mean over trainings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

NORMAL_95 = 1.959963984540054
"""97.5 % quantile of the standard normal distribution."""

QUANTILE = 0.975
"""Of Student's distribution, for intervals of 95 %."""


def quantiles(values: Any, shares: Mapping[str, float]) -> dict[str, float | None]:
    """Quantiles by name, None for one that is infinite, which JSON has no word for."""
    found = {name: float(np.quantile(values, share, method="inverted_cdf")) for name, share in shares.items()}
    return {name: value if math.isfinite(value) else None for name, value in found.items()}


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a rate (Wilson, "Probable inference", J. Am. Stat. Assoc. 22, 1927).

    That of `scipy.stats.binomtest`, whose import takes half a second: a tenth of a whole training.
    """
    z, rate = NORMAL_95, successes / trials
    centre = rate + z**2 / (2 * trials)
    half = z * math.sqrt(rate * (1 - rate) / trials + z**2 / (4 * trials**2))
    scale = 1 + z**2 / trials
    # Exact where rounding would leave the ends a hair away from 0 and 1.
    low, high = (0.0 if successes == 0 else (centre - half) / scale), (centre + half) / scale
    return low, 1.0 if successes == trials else high


def student_half_width(values: np.ndarray) -> np.ndarray:
    """Half the 95 % interval of the mean of two or more values `[N, ...]`, by Student's distribution `[...]`."""
    from scipy.special import stdtrit

    count = len(values)
    return stdtrit(count - 1, QUANTILE) * np.std(values, axis=0, ddof=1) / math.sqrt(count)


def mean_report(reports: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """A report, in its plain form, whose numbers are means over those of several trainings.

    `success_interval` is Student's, within 0 and 1. A number that one of them lacks, as the time to reach, is None.
    """
    rates = np.array([report["success_rate"] for report in reports])
    half = float(student_half_width(rates))
    mean = _mean(reports)
    mean |= {"checkpoint": None} if "checkpoint" in mean else {}
    return mean | {"success_interval": (max(rates.mean() - half, 0.0), min(rates.mean() + half, 1.0))}


def _mean(values: Sequence[Any]) -> Any:
    """Mean of numbers, of each entry of mappings and lists of numbers, and of anything else the first."""
    first = next((value for value in values if value is not None), None)
    if isinstance(first, Mapping):
        return None if None in values else {name: _mean([value.get(name) for value in values]) for name in first}
    if isinstance(first, list) and any(isinstance(one, float) for one in first):
        return None if None in values else [_mean(each) for each in zip(*values, strict=True)]
    if any(isinstance(value, float) for value in values):
        return None if None in values else float(np.mean(values))
    return first
