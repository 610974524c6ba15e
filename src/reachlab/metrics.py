"""The sink of a run's numbers: one line of JSON for each iteration."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from reachlab.config import InputError
from reachlab.storage import open_plain

LINE_LIMIT = 2**16
"""Longest line that is taken for a row [bytes]."""


class Metrics:
    """Appends rows to `metrics.jsonl`; a row that finds no room waits for the next one."""

    def __init__(self, path: Path) -> None:
        """Sink that appends to a file.

        Raises:
            InputError: it cannot be written.
        """
        self._waiting = b""
        try:
            self._descriptor = open_plain(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        except (OSError, InputError) as error:
            raise InputError(f"'{path}' cannot be written: {getattr(error, 'strerror', None) or error}.") from None

    def write(self, row: Mapping[str, Any]) -> None:
        """Append a row; it is on disk's way when `write` returns, unless the disk has no room for it."""
        self._waiting += (json.dumps(dict(row)) + "\n").encode()
        with contextlib.suppress(OSError):
            self._flush()

    def sync(self) -> None:
        """Wait until all rows are on the disk.

        Raises:
            OSError: there is no room for them.
        """
        self._flush()
        os.fsync(self._descriptor)

    def _flush(self) -> None:
        while self._waiting:
            self._waiting = self._waiting[os.write(self._descriptor, self._waiting) :]

    def __enter__(self) -> Self:
        """The sink itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        os.close(self._descriptor)


def cut_metrics(path: Path, steps: int) -> None:
    """Keep the rows of a metrics file up to a number of steps: training goes on from there and writes the rest anew.

    Raises:
        InputError: it is no plain file, or cannot be written.
    """
    try:
        with os.fdopen(open_plain(path, os.O_RDWR), "r+b") as file:
            kept = 0
            while _is_row_up_to(steps, file.readline(LINE_LIMIT)):
                kept = file.tell()
            file.truncate(kept)
    except FileNotFoundError:
        return
    except (OSError, InputError) as error:
        raise InputError(f"'{path}' cannot be cut: {getattr(error, 'strerror', None) or error}.") from None


def _is_row_up_to(steps: int, line: bytes) -> bool:
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        return False
    return line.endswith(b"\n") and isinstance(row, dict) and _number(row.get("steps")) <= steps


def _number(value: object) -> float:
    return value if isinstance(value, int | float) else float("inf")


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """Rows of a metrics file, without a last line that was cut off."""
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return rows
