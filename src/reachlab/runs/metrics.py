"""A run's numbers: one line of JSON for each iteration, and the same for every sink that is wanted."""

from __future__ import annotations

import contextlib
import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Self

from reachlab.runs.files import open_plain
from reachlab.runs.sinks import Sink
from reachlab.settings.validation import InputError

LINE_LIMIT = 2**16
"""Longest line that is taken for a row [bytes]."""

log = logging.getLogger(__name__)


class Metrics:
    """Appends rows to `metrics.jsonl`, and hands them to the sinks.

    A row for which the disk has no room is written with the next one. A sink that fails gets no more rows, which a
    warning says; the run goes on.
    """

    def __init__(self, path: Path, sinks: Mapping[str, Sink] | None = None) -> None:
        """Metrics that are appended to a file, and go to sinks, by name, that are opened on its folder.

        Raises:
            InputError: it cannot be written, or a sink cannot be used.
        """
        self._sinks: dict[str, Sink] = {}
        self._waiting = b""
        try:
            self._descriptor = open_plain(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        except (OSError, InputError) as error:
            raise InputError(f"'{path}' cannot be written: {getattr(error, 'strerror', None) or error}.") from None
        try:
            for name, sink in (sinks or {}).items():
                sink.open(path.parent)
                self._sinks[name] = sink
        except BaseException:
            self._close()
            raise

    def write(self, row: Mapping[str, Any]) -> None:
        """Append a row, with environment steps as `steps`.

        The system has it when `write` returns, unless the disk has no room for it.
        """
        self._waiting += (json.dumps(dict(row)) + "\n").encode()
        with contextlib.suppress(OSError):
            self._flush()
        for name, sink in list(self._sinks.items()):
            self._try(name, sink.write, row)

    def finish(self, result: Mapping[str, Any] | None) -> None:
        """Close the sinks, with what training came to; None if it did not end by itself."""
        for name, sink in list(self._sinks.items()):
            self._try(name, sink.close, result)
        self._sinks.clear()

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

    def __exit__(self, *raised: object) -> None:
        """Close the file, and the sinks that are open."""
        self._close()

    def _close(self) -> None:
        os.close(self._descriptor)
        self.finish(None)

    def _try(self, name: str, act: Callable[[Any], None], given: Any) -> None:
        try:
            act(given)
        except Exception as error:
            why = str(error) or type(error).__name__
            log.warning("reachlab: %s gets no more numbers (%s); the run goes on without it.", name, why)
            del self._sinks[name]


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
        raise InputError(f"'{path}' cannot be read: {getattr(error, 'strerror', None) or error}.") from None


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
        raise InputError(f"'{path}' cannot be cut: {getattr(error, 'strerror', None) or error}.") from None


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
