"""When a training is saved, and the retry after a save that failed."""

from __future__ import annotations

import logging
import time
from shlex import quote
from typing import Any

from reachlab.runs.checkpoint import Counters
from reachlab.runs.directory import RunDirectory
from reachlab.runs.metrics import Metrics
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError

SAVING_SHARE = 0.02
"""Checkpoints take at most this share of the time, on average."""

log = logging.getLogger(__name__)


class Checkpoints:
    """Saves a training now and then.

    Attributes:
        saved: where the newest checkpoint stands, None without one.
    """

    def __init__(self, run: RunDirectory, config: RunConfig) -> None:
        """Checkpoints of a run, of which nothing is saved yet."""
        self._run, self._config = run, config
        self._save_after = config.loop.checkpoint_interval
        self._clock = time.perf_counter()
        self.saved: Counters | None = None

    @property
    def due(self) -> bool:
        """Whether it is time for the next one."""
        return time.perf_counter() - self._clock >= self._save_after

    def start(self) -> None:
        """Count the time to the next one from now."""
        self._clock = time.perf_counter()

    def save(self, now: Counters, state: Any, metrics: Metrics) -> None:
        """Save the state, unless it is saved.

        Raises:
            OSError, InputError: it cannot be written.
        """
        begun = time.perf_counter()
        if self.saved is None or self.saved.steps != now.steps:
            metrics.sync()
            self._run.write_checkpoint(now.steps, state, now, self._config.loop.keep_checkpoints)
            self.saved = now
        self.start()
        if interval := self._config.loop.checkpoint_interval:
            self._save_after = max(interval, (self._clock - begun) / SAVING_SHARE)

    def try_to_save(self, now: Counters, state: Any, metrics: Metrics) -> None:
        """Save the state; if it cannot be, training continues and tries again after the next interval."""
        try:
            self.save(now, state, metrics)
        except (OSError, InputError) as error:
            self.start()
            log.warning(
                "reachlab: the checkpoint of step %s cannot be written to '%s' (%s).",
                f"{now.steps:,}",
                self._run.checkpoints,
                reason(error),
            )

    def how_to_resume(self) -> str:
        """What is saved, and the command that continues from there."""
        command = f"reachlab {self._config.verb} --resume {quote(str(self._run.path))}"
        if self.saved is None:
            return f"nothing is saved: `{command}` begins again, or remove '{self._run.path}'."
        return f"step {self.saved.steps:,} is saved: `{command}` continues from there."


class UnwritableError(InputError):
    """Something of a run could not be written; it is to be resumed.

    Attributes:
        lost: what it is, and why.
    """

    def __init__(self, lost: str, command: str) -> None:
        """Of what the command continues once there is room."""
        super().__init__(f"{lost}: make room there, and resume with `{command}`.")
        self.lost = lost


def unwritable(what: str, run: RunDirectory, error: Exception, verb: str = "train") -> UnwritableError:
    """An error that says what of a run could not be written, and what to do."""
    lost = f"the {what} cannot be written to '{run.path}' ({reason(error)})"
    return UnwritableError(lost, f"reachlab {verb} --resume {quote(str(run.path))}")


def reason(error: Exception) -> str:
    """Why something could not be written."""
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error).rstrip(".")
