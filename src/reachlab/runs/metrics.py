"""The sink of a run's numbers: one line of JSON for each iteration, and TensorBoard's events where wanted."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from reachlab.runs.files import open_plain
from reachlab.settings.validation import InputError

if TYPE_CHECKING:
    from tensorboardX import SummaryWriter

LINE_LIMIT = 2**16
"""Longest line that is taken for a row [bytes]."""


class Metrics:
    """Appends rows to `metrics.jsonl`, and the same numbers to an event file beside it.

    A row that finds no room waits for the next one.
    """

    def __init__(self, path: Path, *, tensorboard: bool = False) -> None:
        """Sink that appends to a file, and with `tensorboard` to an event file in its folder.

        Raises:
            InputError: it cannot be written, or TensorBoard is wanted and tensorboardX is not installed.
        """
        self._events = event_writer()(str(path.parent)) if tensorboard else None
        self._waiting = b""
        try:
            self._descriptor = open_plain(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        except (OSError, InputError) as error:
            raise InputError(f"'{path}' cannot be written: {getattr(error, 'strerror', None) or error}.") from None

    def write(self, row: Mapping[str, Any]) -> None:
        """Append a row; its `steps` are the axis of TensorBoard's charts.

        It is on disk's way when `write` returns, unless the disk has no room for it.
        """
        self._waiting += (json.dumps(dict(row)) + "\n").encode()
        with contextlib.suppress(OSError):
            self._flush()
        if self._events is not None:
            for name, value in row.items():
                self._events.add_scalar(name, value, row["steps"])

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
        """Close the files."""
        os.close(self._descriptor)
        if self._events is not None:
            self._events.close()


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


def event_writer() -> type[SummaryWriter]:
    """The class that writes TensorBoard's event files.

    Raises:
        InputError: tensorboardX is not installed.
    """
    try:
        from tensorboardX import SummaryWriter
    except ImportError:
        raise InputError("--tensorboard needs tensorboardX: pip install 'reachlab[tensorboard]'.") from None
    return SummaryWriter


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """Rows of a metrics file, without a last line that was cut off."""
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return rows
