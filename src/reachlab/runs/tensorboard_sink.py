"""The sink that writes TensorBoard's event files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from reachlab.runs.directory import RunDirectory
from reachlab.settings.validation import needing


class TensorBoard:
    """Writes an event file into the run directory."""

    def __init__(self) -> None:
        """Sink that is not yet open.

        Raises:
            InputError: tensorboardX is not installed.
        """
        with needing("--tensorboard needs tensorboardX: {}.", "tensorboard", ImportError):
            from tensorboardX import SummaryWriter
        self._make_writer = SummaryWriter

    def open(self, folder: Path) -> None:
        """Begin an event file; numbers of steps that were lost, and are taken again, are in it no more."""
        run = RunDirectory(folder)
        rows = run.read_metrics() if run.metrics_file.exists() else []
        self._writer = self._make_writer(str(folder), purge_step=rows[-1]["steps"] + 1 if rows else None)

    def write(self, row: Mapping[str, Any]) -> None:
        """Write each number under its name; `steps` are the axis of the charts."""
        for name, value in row.items():
            self._writer.add_scalar(name, value, row["steps"])

    def close(self, result: Mapping[str, Any] | None) -> None:
        """Close the event file."""
        del result
        self._writer.close()
