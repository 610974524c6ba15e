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


def write_log(entries: Iterable[Any], file: Path, policy: str) -> None:
    """Write the entries of a policy's log, a line of JSON each: control steps as `NOTED`, resets and stops as dicts."""
    with file.open("w", encoding="utf-8") as lines:
        for entry in ({"policy": policy}, *entries):
            named = entry if isinstance(entry, dict) else dict(zip(NOTED, entry))
            lines.write(json.dumps(named, default=np.ndarray.tolist) + "\n")


def read_log(file: Path, policy: str) -> list[dict[str, Any]]:
    """Entries of a policy's log that was saved, from the first reset in it on.

    Raises:
        ValueError: it has none, a line is no JSON, or it is another policy's.
    """
    entries = []
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        try:
            entries.append(json.loads(line))
        except ValueError:
            raise ValueError(f"'{file}', line {number}, is no entry of a log: was the file cut?") from None
    if entries and entries[0].get("policy", policy) != policy:
        raise ValueError(f"'{file}' is the log of another policy: its steps can be taken again by that alone.")
    first = next((number for number, entry in enumerate(entries) if "reset" in entry), None)
    if first is None:
        raise ValueError(
            f"'{file}' has no reset, from which on steps could be taken again: a log holds the last {KEPT:,} of them,"
            " so save it sooner after one."
        )
    return entries[first:]
