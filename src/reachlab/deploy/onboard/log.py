"""A log of control steps, from which they can be taken again."""

from __future__ import annotations

import json
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

NOTED = ("q", "qd", "goal", "time", "velocity", "obstacles", "joints", "command", "problem")
"""What is kept of a control step."""

KEPT = 100_000
"""Entries that a log holds."""


class Log:
    """The last entries: control steps as `NOTED`, resets and stops as dicts."""

    def __init__(self) -> None:
        """An empty one."""
        self._entries: deque[Any] = deque(maxlen=KEPT)

    def add(self, entry: Any) -> None:
        """Add an entry; arrays are copied, for callers may use theirs again."""
        if isinstance(entry, tuple):
            entry = tuple(one.copy() if isinstance(one, np.ndarray) else one for one in entry)
        self._entries.append(entry)

    def save(self, file: Path) -> None:
        """Write all of it, a line of JSON each."""
        with file.open("w", encoding="utf-8") as lines:
            for entry in self._entries:
                named = entry
                if not isinstance(entry, dict):
                    named = {name: _plain(value) for name, value in zip(NOTED, entry)}
                lines.write(json.dumps(named) + "\n")


def read_log(file: Path) -> list[dict[str, Any]]:
    """Entries of a log that was saved."""
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def _plain(value: Any) -> Any:
    """What JSON can hold of a value; of what it cannot, nothing, which is as little a measurement."""
    if isinstance(value, dict):
        return {str(name): _plain(one) for name, one in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        return value.item()
    return value if value is None or isinstance(value, (bool, int, float, str)) else None
