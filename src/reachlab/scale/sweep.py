"""A sweep: trials of settings that Optuna suggests, each an ordinary run, carried by an engine."""

from __future__ import annotations

import contextlib
import csv
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from reachlab.envs.consistency import check
from reachlab.learn.interrupts import Interrupted, Interrupts
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import read_json, write_json
from reachlab.runs.lock import locked
from reachlab.scale import ENGINES
from reachlab.scale.engines import Engine
from reachlab.scale.goals import check_goal
from reachlab.scale.space import dimensions, label, size
from reachlab.scale.study import Study, Trial, load_optuna
from reachlab.scale.trials import SweepConfig, Trials
from reachlab.settings.arguments import typed
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override, to_json
from reachlab.settings.validation import InputError, choose, whole_number

LOOK = 0.25
"""Time between two looks at the trainings [s]."""

MOST_AT_A_TIME = 1024
"""Trainings at a time, at most."""


@dataclass(frozen=True)
class SweepProgress:
    """Where a sweep stands: its trials, how many there will be, and the share done of each training under way."""

    trials: list[Trial]
    total: int
    running: dict[str, float]
    best: Trial | None


@dataclass(frozen=True)
class SweepResult:
    """What a sweep came to.

    Attributes:
        ranked: the complete trials, the best one first.
        config: the settings of the best one, as `train` takes them; None if none is complete.
        trials: all of them.
        pictures: files that were drawn.
    """

    ranked: list[Trial]
    config: RunConfig | None
    trials: list[Trial]
    pictures: list[Path]

    def to_json(self) -> dict[str, Any]:
        """Plain form, for `json.dump`."""
        return {
            "best": self.ranked[0]._asdict() if self.ranked else None,
            "trials": [trial._asdict() for trial in self.trials],
            "pictures": [str(picture) for picture in self.pictures],
        }


def read_sweep(path: Path) -> SweepConfig:
    """What decides the sweep in a directory.

    Raises:
        InputError: there is none here.
    """
    file = RunDirectory(path).sweep_file
    if not file.is_file():
        raise InputError(f"'{path}' is no sweep: begin one with `reachlab sweep SPACE --out {path}`.")
    try:
        return SweepConfig(**read_json(file))
    except TypeError:
        raise InputError(f"'{file}' is not usable: it is of another version.") from None


@typed
def sweep(
    config: RunConfig,
    settings: SweepConfig,
    out: str | Path,
    watch: Callable[[SweepProgress], None] = lambda _: None,
    *,
    workers: int = 1,
    engine: str = "local",
    address: str | None = None,
    resume: bool = False,
    base: RunConfig | None = None,
) -> SweepResult:
    """Result of a sweep, whose files are in the directory `out`.

    SIGINT, SIGTERM and SIGHUP end it, with every training under way saved; nothing of it is lost if it is killed.

    Args:
        config: the settings of the trainings, but for those that vary.
        settings: what varies, and what is sought.
        out: directory, made here; with `resume` one that is there.
        watch: called now and then.
        workers: trainings at a time, of one thread each.
        engine: name of `ENGINES`.
        address: of a Ray cluster that runs.
        resume: continue the sweep in `out`.
        base: settings from which `config` was changed, see `train`.

    Raises:
        InputError: a setting, space, goal or engine that cannot be used, or a directory that is there.
        Interrupted: a signal asked for it.
    """
    load_optuna()
    whole_number("workers", workers, 1, MOST_AT_A_TIME)
    check(config, config if resume else base)
    space, goal = dimensions(settings.space, config), check_goal(settings.goal, config)
    kind = ENGINES[choose("engine", engine, ENGINES)]
    if address and engine != "ray":
        raise InputError(f"address is that of a Ray cluster: leave it out with engine {engine!r}, or use --engine ray.")
    run = _directory(Path(out), config, resume=resume)
    carrier: Engine = kind.load()(workers, address)
    with Interrupts() as interrupts, contextlib.closing(carrier):
        if not resume:
            run.create(config)
        folder = run.path / "trials"
        folder.mkdir(exist_ok=True)
        with locked(run.path):
            write_json(run.sweep_file, vars(settings))
            study = Study(run.path / "study.journal", space, goal, config)
            under_way = Trials(settings, config, folder, study, carrier)
            left, expected = True, int(min(settings.trials, size(space)))
            while left:
                left = under_way.advance(settings.trials, workers)
                begun, best = study.trials, next(iter(study.ranked), None)
                watch(SweepProgress(begun, max(expected, len(begun)), under_way.shares, best))
                if interrupts.received is not None:
                    how = f"`reachlab sweep --resume {quote(str(run.path))}` continues from there"
                    raise Interrupted(interrupts.received, f"interrupted; every trial is saved: {how}.")
                time.sleep(LOOK)
            return _result(config, run.path, study, settings)


def _directory(path: Path, config: RunConfig, *, resume: bool) -> RunDirectory:
    """The directory of a sweep, which is there if it is to be resumed, and not otherwise."""
    run = RunDirectory(path)
    if resume:
        read_sweep(run.path)
        run.read_unfinished(config)
        run.check_robot(config)
    else:
        run.refuse_existing()
    return run


def _written(value: Any) -> Any:
    """A value as a table has it: several numbers as the space's file does."""
    return label(value) if isinstance(value, tuple) else value


def _result(config: RunConfig, folder: Path, study: Study, settings: SweepConfig) -> SweepResult:
    """What a sweep came to, also written to its folder."""
    ranked, trials, varied = study.ranked, study.trials, list(settings.space)
    chosen = override(config, **ranked[0].settings) if ranked else None
    if chosen:
        write_json(folder / "best.json", to_json(chosen))
    with (folder / "trials.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["trial", "state", settings.goal, *varied, "why"])
        for one in trials:
            settled = [_written(one.settings.get(name)) for name in varied]
            table.writerow([one.number, one.state, one.value, *settled, one.why])
    return SweepResult(ranked, chosen, trials, study.draw(folder, settings.goal))
