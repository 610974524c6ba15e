"""The sink of a run's numbers: one line of JSON for each iteration, and TensorBoard's events where wanted."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from reachlab.config import InputError

if TYPE_CHECKING:
    from tensorboardX import SummaryWriter


class Metrics:
    """Appends rows to `metrics.jsonl`, and the same numbers to an event file beside it.

    Every row is on disk's way when `write` returns.
    """

    def __init__(self, path: Path, *, tensorboard: bool = False) -> None:
        """Sink that appends to a file, and with `tensorboard` to an event file in its folder.

        Raises:
            InputError: TensorBoard is wanted and tensorboardX is not installed.
        """
        self._events = event_writer()(str(path.parent)) if tensorboard else None
        self._file = path.open("a", encoding="utf-8")

    def write(self, row: Mapping[str, Any]) -> None:
        """Append a row; its `steps` are the axis of TensorBoard's charts."""
        self._file.write(json.dumps(dict(row)) + "\n")
        self._file.flush()
        if self._events is not None:
            for name, value in row.items():
                self._events.add_scalar(name, value, row["steps"])

    def __enter__(self) -> Self:
        """The sink itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the files."""
        self._file.close()
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
    """Rows of a metrics file, without a last line that was cut off."""
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return rows
