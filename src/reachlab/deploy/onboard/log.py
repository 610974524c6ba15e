"""A log of control steps, from which they can be taken again."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

NOTED = ("q", "qd", "goal", "time", "velocity", "obstacles", "objects", "joints", "wrench")
NOTED += ("waited", "command", "problem", "planned")
"""What is kept of a control step."""

KEPT = 100_000
"""Entries that a log holds."""


def write_log(entries: Iterable[Any], file: Path) -> None:
    """Write the last entries of a log, a line of JSON each: control steps as `NOTED`, resets and stops as dicts."""
    with file.open("w", encoding="utf-8") as lines:
        for entry in entries:
            named = entry if isinstance(entry, dict) else dict(zip(NOTED, entry))
            lines.write(json.dumps(named, default=np.ndarray.tolist) + "\n")


def read_log(file: Path) -> list[dict[str, Any]]:
    """Entries of a log that was saved, from the first reset in it on.

    Raises:
        ValueError: it has none.
    """
    entries = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    first = next((number for number, entry in enumerate(entries) if "reset" in entry), None)
    if first is None:
        raise ValueError(
            f"'{file}' has no reset, from which on steps could be taken again: a log holds the last {KEPT:,} of them,"
            " so save it sooner after one."
        )
    return entries[first:]
