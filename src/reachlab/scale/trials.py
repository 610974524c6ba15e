"""The trials of a sweep: which trainings are begun, continued and given up, and what each trial's value is."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.envs.setup import check
from reachlab.evaluation.intervals import student_half_width
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import read_json
from reachlab.scale.engine import Engine, Job
from reachlab.scale.goals import GOALS
from reachlab.scale.study import Study
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override
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
    """

    space: dict[str, Any]
    goal: str = "success_rate"
    seeds: Count = 1
    validations: NonNegativeInt = 7


@dataclass
class Open:
    """A trial under way: its trainings, those that have not ended, the values of the others, and why it is given up."""

    jobs: list[Job]
    left: list[Job]
    values: list[float] = field(default_factory=list)
    pruned: bool = False
    failure: str = ""

    @property
    def given_up(self) -> bool:
        """Whether it will have no value."""
        return self.pruned or bool(self.failure)


class Trials:
    """Trials of a study, whose trainings an engine carries."""

    def __init__(self, settings: SweepConfig, config: RunConfig, folder: Path, study: Study, engine: Engine) -> None:
        """Trials below a folder; those that an earlier process began are queued."""
        self._settings, self._config, self._folder, self._study, self._engine = settings, config, folder, study, engine
        self._goal = GOALS[settings.goal]
        self._open: dict[int, Open] = {}
        self._queue: list[Job] = []
        self._deaths: dict[Path, tuple[int, int]] = {}
        for number, varied in study.begun():
            self._begin(number, varied)

    def fill(self, total: int, workers: int) -> bool:
        """Give the engine what it has room for; whether there is anything left to do."""
        while len(self._engine.running) < workers:
            if self._queue:
                self._engine.submit(self._queue.pop(0))
            elif len(self._study.trials) < total:
                self._begin(*self._study.ask())
            else:
                break
        return bool(self._engine.running)

    def look(self, wait_s: float) -> None:
        """Take note of trainings that end, waiting so long for one, and of validations."""
        ended = self._engine.ended(wait_s)
        self._judge()  # with the last validations of those that ended
        for job in ended:
            self._settle(job)

    def shares(self) -> dict[str, float]:
        """Share of its steps that each training under way has taken, by the name of its run."""
        shares = {}
        for job in self._engine.running:
            run = RunDirectory(job.path)
            rows = run.read_metrics() if run.metrics_file.exists() else []
            shares[job.path.name] = rows[-1]["steps"] / job.config.loop.total_steps if rows else 0.0
        return shares

    def _begin(self, number: int, varied: dict[str, Any]) -> None:
        """Queue what is left of a trial's trainings."""
        try:
            config = override(self._config, **varied)
            check(config, self._config)
        except InputError as error:
            self._open[number] = Open([], [], failure=str(error))
            self._end(number)
            return
        jobs = []
        for index in range(self._settings.seeds):
            path = self._folder / f"{number:04}-{index}"
            seeded = override(config, seed=config.seed + index)
            jobs.append(Job(path, seeded, self._settings.goal, self._settings.validations))
        self._open[number] = Open(jobs, list(jobs))
        for job in jobs:
            if job.ended:
                self._settle(job)
            else:
                self._queue.append(job)

    def _settle(self, job: Job) -> None:
        """Look at what is left of a training whose process has ended."""
        number = _number(job)
        trial, run = self._open[number], RunDirectory(job.path)
        if run.finished:
            trial.values.append(self._value(read_json(run.report_file)))
        elif job.failure_file.exists():
            trial.failure = str(read_json(job.failure_file)["error"])
        elif job.stop_file.exists():
            trial.pruned = True
        elif self._may_continue(job):
            self._queue.insert(0, job)
            return
        else:
            trial.failure = f"its process died {DEATHS} times without a newer checkpoint: see '{job.log_file}'."
        trial.left.remove(job)
        if trial.given_up:
            self._give_up(trial)
        if not trial.left:
            self._end(number)

    def _value(self, result: Mapping[str, Any]) -> float:
        value = self._goal.of(result)
        return self._goal.worst if value is None else value

    def _may_continue(self, job: Job) -> bool:
        newest = RunDirectory(job.path).newest_manifest() if job.path.exists() else None
        steps = newest.counters.steps if newest else -1
        before, deaths = self._deaths.get(job.path, (steps, 0))
        deaths = deaths + 1 if steps == before else 1
        self._deaths[job.path] = steps, deaths
        return deaths < DEATHS

    def _give_up(self, trial: Open) -> None:
        """Let the trainings of a trial end; those that wait are not begun."""
        for job in trial.left:
            job.stop_file.touch()
        trial.left = [job for job in trial.left if job not in self._queue]
        self._queue = [job for job in self._queue if job not in trial.jobs]

    def _judge(self) -> None:
        """Hand on the validations that all trainings of a trial have, and prune the trial if they are poor."""
        for number, trial in list(self._open.items()):
            each = [job.values() for job in trial.jobs]
            shared = set.intersection(*map(set, each)) if not trial.given_up else set()
            for steps in sorted(shared):
                if self._study.report(number, steps, statistics.fmean(values[steps] for values in each)):
                    trial.pruned = True
                    self._give_up(trial)
                    break
            if trial.given_up and not trial.left:
                self._end(number)

    def _end(self, number: int) -> None:
        trial = self._open.pop(number)
        if trial.failure:
            self._study.fail(number, trial.failure)
        elif len(trial.values) == len(trial.jobs):
            self._study.complete(number, self._pessimistic(trial.values))
        else:
            self._study.prune(number)

    def _pessimistic(self, values: list[float]) -> float:
        """The value of one seed; of several the poorer end of the 95 % interval of their mean (Student's t)."""
        if len(values) == 1:
            return values[0]
        mean = statistics.fmean(values)
        if mean in (float("inf"), float("-inf")):
            return mean
        half = float(student_half_width(np.array(values)))
        return mean - half if self._goal.maximise else mean + half


def _number(job: Job) -> int:
    return int(job.path.name.partition("-")[0])
