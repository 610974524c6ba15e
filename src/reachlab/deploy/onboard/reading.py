"""Numbers as callers give them, whatever that is, and as people read them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

TURN = 2 * math.pi
"""Beyond a limit by so much no joint is [rad or m]."""

UNREADABLE = "not made of numbers"
"""What stands for a value that is not made of numbers; a log holds it as it is."""


def read_numbers(value: Any) -> Any:
    """An array of floats that nobody else holds; None of None, and `UNREADABLE` of what is not made of real numbers.

    As are words, truth values and numbers with an imaginary part; and where a mask says that a number is none.
    """
    if value is None:
        return None
    try:
        found = np.asarray(value)
        return UNREADABLE if found.dtype.kind not in "fiu" or np.ma.is_masked(value) else np.array(found, float)
    except Exception:  # a caller's object may raise anything, and an arm that moves has to be stopped in order
        return UNREADABLE


def read_seconds(value: Any) -> float | None:
    """A finite time [s], or None."""
    try:
        value = value.item() if isinstance(value, np.ndarray) and value.shape == () else value
        seconds = float(value) if isinstance(value, (int, float, np.floating, np.integer)) else math.nan
    except Exception:  # as above: an int may be too large for a float
        return None
    return seconds if math.isfinite(seconds) else None


def read_bodies(value: Any) -> Any:
    """A list of dicts of arrays; None of None, and `UNREADABLE` of anything else."""
    if value is None:
        return None
    try:
        return [{str(name): read_numbers(part) for name, part in one.items()} for one in value]
    except Exception:  # as above
        return UNREADABLE


def felt(wrench: Any, inputs: dict[str, list[int]]) -> dict[str, list[float]]:
    """The wrench by its name, of one as `read_numbers` gives it; nothing where it is not among a policy's inputs.

    Raises:
        ValueError: it is among them, and is missing or not made of finite numbers.
    """
    if "wrench" not in inputs:
        return {}
    asked = f"the policy needs the wrench at the wrist, {inputs['wrench'][0]} finite numbers [N, Nm]"
    if wrench is None:
        raise ValueError(f"{asked}, and none is measured")
    if isinstance(wrench, str) or list(wrench.shape) != inputs["wrench"] or not np.isfinite(wrench).all():
        raise ValueError(f"{asked}, got {in_words(wrench)}")
    return {"wrench": wrench.tolist()}


def of_units(q: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> str:
    """A question about the units of joints `[n]`, where one is further out of its limits than any joint can be."""
    return ", or are they not in rad and m?" if (np.abs(q - np.clip(q, lower, upper)) > TURN).any() else ""


def in_words(numbers: Any) -> str:
    """Numbers as text, to four digits; anything else as it is."""
    if not isinstance(numbers, (np.ndarray, np.generic)):
        return str(numbers)
    four = "{:.4g}".format
    return np.array2string(np.asarray(numbers), separator=", ", max_line_width=10_000, formatter={"float_kind": four})
