"""The verbs `train` and `distil`."""

from __future__ import annotations

import json as jsonlib
import sys
import time
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from shlex import quote
from typing import Any

from reachlab.cli.console import note, say
from reachlab.cli.flags import STUDENT, Distil, Train
from reachlab.cli.preparation import prepare
from reachlab.envs.presets import distillation, in_simulator
from reachlab.scale import ENGINES
from reachlab.settings.config import DistilRunConfig, RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError, choose


def train(arguments: Train) -> None:
    """Run `reachlab train`."""
    _learn(arguments, arguments.run, "train")


def distil(arguments: Distil) -> None:
    """Run `reachlab distil`."""
    _learn(arguments, _distillation(arguments), "distil")


def _distillation(arguments: Distil) -> RunConfig:
    """Settings of a distillation: of the run that is resumed, or of the teacher, with the changes of the flags."""
    from reachlab.runs.directory import RunDirectory
    from reachlab.runs.shipped import find_run

    given = {name: vars(arguments)[name] for name in STUDENT}
    changes = {name: value for name, value in given.items() if value is not None} | vars(arguments.settings)
    if arguments.resume:
        config = RunDirectory(arguments.resume).read_config(check_robot=False)
        changes |= {"sim": arguments.sim} if arguments.sim else {}
        changes |= {"teacher": str(arguments.teacher)} if arguments.teacher else {}
        return override(config, **changes) if isinstance(config, DistilRunConfig) else config
    if arguments.teacher is None:
        raise InputError("distil needs a teacher: name the run directory of one, as `reachlab train` makes it.")
    taught = find_run(arguments.teacher).read_config(check_robot=False)
    config = in_simulator(taught, arguments.sim or taught.sim)
    changes["randomise"] = taught.randomise if arguments.randomise is None else arguments.randomise
    return distillation(str(arguments.teacher), config, **changes)


def _learn(arguments: Train | Distil, config: RunConfig, verb: str) -> None:
    """Train or distil, and show the result."""
    if config.verb != verb and not arguments.resume:
        raise InputError("the file holds the settings of a distillation: use `reachlab distil`, with its flags.")
    if config.verb != verb:
        command = f"reachlab {config.verb} --resume {quote(str(arguments.resume))}"
        raise InputError(f"run '{arguments.resume}' is resumed with `{command}`.")
    if arguments.resume and _is_finished(arguments, config, arguments.resume):
        return
    from reachlab.cli.progress import TrainDisplay, print_training

    out = arguments.resume or arguments.out or Path("runs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{config.task}"
    sinks = tuple(name for name, wanted in vars(arguments.sinks).items() if wanted)
    resume = arguments.resume is not None
    with TrainDisplay(config) as display:
        prepare()
        from reachlab.learn.train import train as run_training
        from reachlab.runs.directory import read_config

        base = read_config(arguments.config) if isinstance(arguments, Train) and arguments.config else None
        with _collector(arguments, config) as collect:
            more: dict[str, Any] = {"base": base, "sinks": sinks, "collect": collect, "begun": display.begun}
            result = run_training(config, out, display, watch_report=display.report, resume=resume, **more)
    if not arguments.json:
        print_training(result, config, display, resumed=resume)
    drawn = _draw(out, out / "curve.png")
    if arguments.json:
        print(jsonlib.dumps(result.to_json()))
    else:
        files = ", ".join(("report.json", *drawn, "checkpoints"))
        say(f"Written: {out}: {files}. With the report: {result.total_wall_s:.1f} s.")
    if result.validated is False:
        note(
            f"Warning: no {config.loop.stop_streak} validations in a row reached {100 * config.loop.stop_success:g} %"
            f" success within {config.loop.total_steps:,} steps."
        )
    note(f"Next: reachlab eval {quote(str(out))} --agent trained random zero ik")


def _draw(run: Path, file: Path) -> tuple[str, ...]:
    """Name of the curve's file; none where it cannot be written, which is no reason to lose the result."""
    from reachlab.cli.console import note
    from reachlab.watch.plots import plot

    try:
        plot([run], file)
    except InputError as error:
        note(f"Warning: {error} Once that is mended: reachlab plot {quote(str(run))}")
        return ()
    return (file.name,)


def _collector(arguments: Train | Distil, config: RunConfig) -> AbstractContextManager[Any]:
    """Collector of experience while the context is open; None is this process."""
    if not isinstance(arguments, Train) or not arguments.workers:
        if isinstance(arguments, Train) and arguments.address:
            raise InputError("address is that of a cluster whose workers collect: say how many with --workers.")
        if isinstance(arguments, Train):
            choose("engine", arguments.engine, ENGINES)
        return nullcontext()
    if choose("engine", arguments.engine, ENGINES) != "ray":
        raise InputError(f"engine {arguments.engine!r} carries the trainings of a sweep: use --engine ray here.")
    from reachlab.scale.rollouts import RayRollouts

    return RayRollouts(config, arguments.workers, arguments.address)


def _is_finished(arguments: Train | Distil, config: RunConfig, folder: Path) -> bool:
    """Whether the run that is to be resumed is finished; if it is, this has been printed.

    Raises:
        InputError: it cannot be resumed; this is found before JAX is loaded.
    """
    from reachlab.runs.directory import RunDirectory
    from reachlab.runs.files import read_json

    if arguments.out:
        raise InputError("--resume names the run directory already: leave --out out.")
    run = RunDirectory(folder)
    run.read_unfinished(config)
    if not run.finished:
        return False
    report = read_json(run.report_file)
    if arguments.json:
        print(jsonlib.dumps(report))
    how = f"train its policy further with --initial-policy {quote(str(folder))}, as a new run"
    print(f"Run {folder} is finished: {run.report_file} holds its report; {how}.", file=sys.stderr)
    return True
