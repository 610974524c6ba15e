"""A training of a sweep, and what carries it."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from reachlab.learn.interrupts import Interrupted
from reachlab.learn.loop import Progress
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import write_json
from reachlab.runs.lock import refuse_if_held
from reachlab.scale.goals import GOALS
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import from_json, to_json
from reachlab.settings.validation import InputError

VALIDATED = 200
"""Held-out episodes of a validation."""

PATIENCE = 60.0
"""Time that a run which another process still holds is waited for [s]: one whose sweep was killed is about to end."""


@dataclass(frozen=True)
class Job:
    """A training: a run directory, the files beside it, and what it is trained for.

    Attributes:
        path: the run directory.
        config: every setting.
        goal: name of the figure that validations are about.
        validations: how many there are on the way, at equal distances.
    """

    path: Path
    config: RunConfig
    goal: str
    validations: int

    @property
    def values_file(self) -> Path:
        """Values of the validations, a line of JSON each."""
        return self.path.with_suffix(".jsonl")

    @property
    def stop_file(self) -> Path:
        """Where this is, the training ends soon."""
        return self.path.with_suffix(".stop")

    @property
    def failure_file(self) -> Path:
        """Why the training cannot be done."""
        return self.path.with_suffix(".failed")

    @property
    def log_file(self) -> Path:
        """What the process said."""
        return self.path.with_suffix(".log")

    @property
    def ended(self) -> bool:
        """Whether nothing is left to do."""
        return RunDirectory(self.path).finished or self.stop_file.exists() or self.failure_file.exists()

    def values(self) -> dict[int, float]:
        """Values of the validations so far, by steps."""
        try:
            lines = self.values_file.read_text().splitlines()
        except FileNotFoundError:
            return {}
        rows = []
        for line in lines:
            try:
                rows.append(json.loads(line))
            except json.JSONDecodeError:  # cut off by the end of its process; it is written again
                continue
        return {row["steps"]: row["value"] for row in rows}

    def to_json(self) -> dict[str, Any]:
        """Plain form."""
        return vars(self) | {"path": str(self.path), "config": to_json(self.config)}

    @staticmethod
    def from_json(plain: Mapping[str, Any]) -> Job:
        """Job of its plain form."""
        return Job(**{**plain, "path": Path(plain["path"]), "config": from_json(plain["config"])})


class Engine(Protocol):
    """Carries trainings, each in a process of one thread.

    Attributes:
        running: those under way.
    """

    running: list[Job]

    def submit(self, job: Job) -> None:
        """Begin a training, or continue it from its last checkpoint."""
        ...

    def ended(self, timeout: float) -> list[Job]:
        """Those whose process has ended since this was last asked, however it did; waits so long for one [s]."""
        ...

    def close(self) -> None:
        """End what runs, with everything saved if it can be."""
        ...


def run_job(plain: Mapping[str, Any]) -> None:
    """Train, from the last checkpoint if there is one, until the end or until the stop file is there.

    What is wrong with the training itself is written to the failure file; anything else ends the process.
    """
    from reachlab.jax_setup import use_compilation_cache
    from reachlab.learn.train import train

    job = Job.from_json(plain)
    if job.ended:
        return
    use_compilation_cache()
    try:
        _wait_until_free(job.path)
        # A folder without its configuration is not there: it is made in one piece.
        train(job.config, job.path, _Validations(job), resume=job.path.exists(), base=job.config, threads=1)
    except Interrupted:
        return
    except (InputError, FloatingPointError) as error:
        write_json(job.failure_file, {"error": str(error)})


def _wait_until_free(path: Path) -> None:
    until = time.monotonic() + PATIENCE
    while True:
        try:
            refuse_if_held(path)
            return
        except InputError:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)


class _Validations:
    """Watches a training: validates it now and then, and ends it when that is asked for."""

    def __init__(self, job: Job) -> None:
        self._job, self._goal, self._done = job, GOALS[job.goal], 0

    def __call__(self, now: Progress) -> None:
        if self._job.stop_file.exists():
            signal.raise_signal(signal.SIGTERM)
            return
        due = now.steps * (self._job.validations + 1) // now.total_steps
        if due <= self._done or now.steps >= now.total_steps:
            return
        self._done = due
        value = self._goal.of(now.evaluate(VALIDATED).to_json())
        if value is not None:
            with self._job.values_file.open("a") as file:
                file.write("\n" * _cut(self._job.values_file) + json.dumps({"steps": now.steps, "value": value}) + "\n")


def _cut(path: Path) -> bool:
    """Whether a file's last line is without its end: its writer was killed."""
    return not path.read_bytes().endswith(b"\n") if path.stat().st_size else False


def end_with_parent() -> None:
    """Wait until what started this process is gone, which holds its standard input; then ask for its end."""
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
