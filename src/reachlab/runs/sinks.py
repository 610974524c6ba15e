"""Where a run's numbers go beside `metrics.jsonl`, and the table of those places."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

from reachlab.settings.tables import Lazy
from reachlab.settings.validation import InputError, choose


class Sink(Protocol):
    """A place that gets the rows of a run. It is made first, which refuses what cannot be used, and then opened."""

    def open(self, folder: Path) -> None:
        """Begin, or after a resume continue; `folder` is the run directory, with `config.json` in it.

        Raises:
            InputError: it cannot be used.
        """

    def write(self, row: Mapping[str, Any]) -> None:
        """Take a row of numbers by name; its `steps` are environment steps."""

    def close(self, result: Mapping[str, Any] | None) -> None:
        """End, with what training came to; None if it did not end by itself."""


SINKS: dict[str, Lazy] = {
    "tensorboard": Lazy(
        "Write TensorBoard's event file into the run directory too; needs the extra `tensorboard`.",
        "reachlab.runs.tensorboard_sink:TensorBoard",
    ),
    "wandb": Lazy(
        "Log to Weights & Biases too, offline with WANDB_MODE=offline; needs the extra `wandb`.",
        "reachlab.runs.wandb_sink:WeightsAndBiases",
    ),
}
"""Sinks by name, which is their flag. Adding one takes its file and its line here."""


def make_sinks(names: Iterable[str]) -> dict[str, Sink]:
    """Sinks that are not yet open, by name.

    Raises:
        InputError: there is none of that name, or it cannot be used.
    """
    if isinstance(names, str):
        raise InputError(f"sinks must be a list of names, as [{names!r}], got {names!r}.")
    return {name: SINKS[choose("sink", name, SINKS)].load()() for name in names}
