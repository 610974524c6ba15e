"""The sink of a run's numbers: one line of JSON for each iteration, and TensorBoard's events where wanted."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self

from reachlab.runs.files import open_plain
from reachlab.settings.validation import InputError

if TYPE_CHECKING:
    from tensorboardX import SummaryWriter

LINE_LIMIT = 2**16
"""Longest line that is taken for a row [bytes]."""


class Metrics:
    """Appends rows to `metrics.jsonl`, and the same numbers to an event file beside it.

    A row for which the disk has no room is written with the next one.
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
            raise InputError(f"'{path}' cannot be written: {_reason(error)}.") from None

    def write(self, row: Mapping[str, Any]) -> None:
        """Append a row; its `steps` are the axis of TensorBoard's charts.

        The system has it when `write` returns, unless the disk has no room for it.
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
    """Rows of a metrics file, without a last line that was cut off.

    Raises:
        InputError: there is no such file, it is not a plain one, or it cannot be read.
    """
    try:
        with os.fdopen(open_plain(path, os.O_RDONLY), "rb") as file:
            return list(_rows(file))
    except FileNotFoundError:
        why = f"holds no {path.name}: train one with `reachlab train --out {path.parent}`"
        raise InputError(f"run directory '{path.parent}' {why}.") from None
    except (OSError, InputError) as error:
        raise InputError(f"'{path}' cannot be read: {_reason(error)}.") from None


def cut_metrics(path: Path, steps: int) -> None:
    """Keep the rows of a metrics file up to a number of steps: training resumes there and writes the rest anew.

    Raises:
        InputError: it is not a plain file, or cannot be written.
    """
    try:
        with os.fdopen(open_plain(path, os.O_RDWR), "r+b") as file:
            kept = 0
            for row in _rows(file):
                at = row.get("steps")
                if not isinstance(at, int | float) or not at <= steps:
                    break
                kept = file.tell()
            file.truncate(kept)
    except FileNotFoundError:
        return
    except (OSError, InputError) as error:
        raise InputError(f"'{path}' cannot be cut: {_reason(error)}.") from None


def _rows(file: BinaryIO) -> Iterator[dict[str, Any]]:
    """Rows up to the first line that is not a whole one."""
    while (line := file.readline(LINE_LIMIT)).endswith(b"\n"):
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            return
        if not isinstance(row, dict):
            return
        yield row


def _reason(error: Exception) -> str:
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
