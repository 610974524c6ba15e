"""A training of a sweep, in a process of its own."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from pathlib import Path
from typing import Any

from reachlab.envs.earlier_configs import from_json
from reachlab.jax_setup import use_compilation_cache
from reachlab.learn.checkpointing import UnwritableError
from reachlab.learn.interrupts import Interrupted, end_if_deaf, raise_on_termination
from reachlab.learn.loop import Progress
from reachlab.learn.train import train
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import read_json, write_json
from reachlab.runs.lock import in_turn
from reachlab.scale.goals import GOALS
from reachlab.settings.validation import InputError

VALIDATED = 200
"""Held-out episodes of a validation."""


def failure_file(path: Path) -> Path:
    """File beside a run directory that says why the training cannot be done."""
    return path.with_suffix(".failed")


def read_failure(path: Path) -> dict[str, str] | None:
    """Why the training in a run directory cannot be done, `error`, and what there was no room for, `lost`, if so."""
    return read_json(failure_file(path)) if failure_file(path).exists() else None


def read_validations(path: Path) -> dict[int, float]:
    """Values of a training's validations so far, by their numbers; they are in a file beside its run directory."""
    try:
        return dict(json.loads(path.with_suffix(".json").read_text()))
    except FileNotFoundError:
        return {}


def run_training(path: str, config: dict[str, Any], goal: str, validations: int) -> None:
    """Train in the run directory `path`, from the last checkpoint if there is one.

    What is wrong with the training itself is written to the failure file; anything else ends the process.

    Args:
        path: the run directory.
        config: every setting, in its plain form.
        goal: name of the figure that validations are about.
        validations: how many there are on the way, at equal distances.
    """
    run = RunDirectory(Path(path))
    try:
        settings = from_json(config)
    except InputError as error:  # of an extension that is not here any more
        _write_failure(run.path, error)
        return

    def validations_until(steps: int) -> int:
        return steps * (validations + 1) // settings.loop.total_steps

    def validate(now: Progress) -> None:
        before = validations_until(now.steps - settings.loop.iteration_steps)
        number = validations_until(now.steps)
        if before == number or now.steps >= now.total_steps:
            return
        value = GOALS[goal].of(now.evaluate(VALIDATED).to_json())
        if value is not None:
            values = read_validations(run.path) | {number: value}
            write_json(run.path.with_suffix(".json"), list(values.items()))

    use_compilation_cache()
    try:
        if run.path.exists():
            with in_turn(run.path):  # the process of a sweep that was killed is about to end
                pass
        if not run.finished:
            # A folder without its configuration is not there: it is made in one piece.
            train(settings, run.path, validate, resume=run.path.exists(), base=settings, threads=1)
    except Interrupted:
        return
    except (InputError, FloatingPointError) as error:
        _write_failure(run.path, error)


def _write_failure(path: Path, error: Exception) -> None:
    lost = {"lost": error.lost} if isinstance(error, UnwritableError) else {}
    write_json(failure_file(path), {"error": str(error), **lost})


def main() -> None:
    """Run the training that the command line names, as long as the process that started it is there."""
    raise_on_termination()
    end_if_deaf()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    run_training(*json.loads(sys.argv[1]))


def _end_with_parent() -> None:
    """Wait until the process that holds this one's standard input is gone; then ask for the end."""
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
