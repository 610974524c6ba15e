"""The trials of a sweep: each is trained, continued where its process dies, and ended with its value."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from reachlab.envs.consistency import check
from reachlab.evaluation.intervals import student_half_width
from reachlab.learn.checkpointing import UnwritableError
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import read_json
from reachlab.scale.engines import Engine
from reachlab.scale.goals import GOALS
from reachlab.scale.study import Study
from reachlab.scale.training import failure_file, read_failure, read_validations
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, override, to_json
from reachlab.settings.validation import Checked, Count, InputError, NonNegativeInt

DEATHS = 50
"""Times that a training's process may die without a newer checkpoint until the trial counts as failed."""


@dataclass(frozen=True)
class SweepConfig(Checked):
    """What decides a sweep, beside the settings of its trainings.

    Attributes:
        space: the settings that vary, see `space.read_space`.
        goal: name of the figure that is sought, see `goals.GOALS`.
        seeds: trainings of each setting, whose seeds follow each other.
        validations: how often a training is validated on the way; by these trials are pruned, with 0 none.
        trials: how many settings are tried in all; no more than the space holds.
    """

    space: dict[str, Any]
    goal: str = "success_rate"
    seeds: Count = 1
    validations: NonNegativeInt = 7
    trials: Count = 20


class Pruned(Exception):  # noqa: N818 (no error)
    """A trial is not worth more time."""


class Trials:
    """Trials of a study, whose trainings an engine carries, each in a run directory below a folder.

    Attributes:
        shares: share of its steps that each training under way has taken, by the name of its run.
    """

    def __init__(self, settings: SweepConfig, config: RunConfig, folder: Path, study: Study, engine: Engine) -> None:
        """Trials of which none is under way; those that an earlier process began come first."""
        self._settings, self._config, self._folder, self._study, self._engine = settings, config, folder, study, engine
        self._begun = study.begun()
        self._open: list[Iterator[None]] = []
        self.shares: dict[str, float] = {}

    def advance(self, total: int, workers: int) -> bool:
        """Begin trials while there is room, and look at those under way; whether there are any."""
        while len(self._open) < workers and (self._begun or self._study.wants(total)):
            self._open.append(self._run(self._begun.pop(0) if self._begun else self._study.ask(total)))
        ended = object()
        self._open = [trial for trial in self._open if next(trial, ended) is not ended]
        return bool(self._open or self._begun) or self._study.wants(total)

    def _run(self, trial: Any) -> Iterator[None]:
        """Carry out a trial of the study, one look after the other."""
        goal, values = GOALS[self._settings.goal], list[float]()
        try:
            config = override(self._config, **self._study.settings(trial))
            check(config, self._config)
            for index in range(self._settings.seeds):
                path = self._folder / f"{trial.number:04}-{index}"
                yield from self._train(trial, path, override(config, seed=config.seed + index), index)
                value = goal.of(read_json(RunDirectory(path).report_file))
                values.append(goal.worst if value is None else value)
        except UnwritableError:  # the trial is not ended: it goes on where the sweep is resumed
            raise
        except InputError as error:
            self._study.end(trial, why=str(error))
        except Pruned:
            self._study.end(trial)
        else:
            self._study.end(trial, pessimistic(values, maximise=goal.maximise))

    def _train(self, trial: Any, path: Path, config: RunConfig, index: int) -> Iterator[None]:
        """Train with one of the seeds, from the last checkpoint whenever the process has died.

        Raises:
            InputError: the training cannot be done.
            UnwritableError: nor can any, for there is no room to save it.
            Pruned: its validations are poor.
        """
        run, settings, newest, deaths, poor = RunDirectory(path), self._settings, -1, 0, False
        if run.finished:
            _check_of(run, config, trial.params)
        if (read_failure(path) or {}).get("lost"):  # there may be room now
            failure_file(path).unlink()
        while not run.finished and not failure_file(path).exists():
            if deaths == DEATHS:
                log = path.with_suffix(".log")
                raise InputError(f"its process died {DEATHS} times without a newer checkpoint: see '{log}'.")
            training = self._engine.start(str(path), to_json(config), settings.goal, settings.validations)
            running = True
            while running:
                rows = run.read_metrics() if run.metrics_file.exists() else []
                self.shares[path.name] = rows[-1]["steps"] / config.loop.total_steps if rows else 0.0
                yield
                running = self._engine.running(training)
                # The validations of a seed come after those of the one before.
                first = index * (settings.validations + 1)
                validations = {first + number: value for number, value in read_validations(path).items()}
                if not poor and self._study.is_poor(trial, validations):
                    poor = True
                    self._engine.stop(training)
            del self.shares[path.name]
            if poor:
                raise Pruned
            steps = saved.counters.steps if (saved := run.newest_manifest()) else -1
            newest, deaths = steps, deaths + 1 if steps == newest else 1
        if not run.finished and (failure := read_failure(path)):
            again = f"reachlab sweep --resume {quote(str(self._folder.parent))}"
            raise UnwritableError(failure["lost"], again) if "lost" in failure else InputError(failure["error"])


def _check_of(run: RunDirectory, config: RunConfig, names: Iterable[str]) -> None:
    """Make sure that a finished training had these settings: its folder may be of another study.

    Raises:
        InputError: it had others.
    """
    had, asked = (flatten(to_json(one)) for one in (run.read_config(check_robot=False), config))
    for name in names:
        if had[name] != asked[name]:
            raise InputError(f"'{run.path}' was trained with {name} {had[name]!r}, and not {asked[name]!r}: remove it.")


def pessimistic(values: list[float], *, maximise: bool) -> float:
    """The value of one seed; of several the poorer end of the 95 % interval of their mean (Student's t)."""
    mean = statistics.fmean(values)
    if len(values) == 1 or math.isinf(mean):
        return mean
    half = float(student_half_width(np.array(values)))
    return mean - half if maximise else mean + half
