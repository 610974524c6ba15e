"""The verb `sweep`."""

from __future__ import annotations

import json as jsonlib
import time
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from reachlab.cli.console import note, print_table, say
from reachlab.cli.preparation import prepare
from reachlab.cli.progress import Bar
from reachlab.cli.sweep_flags import Sweep
from reachlab.settings.validation import InputError

if TYPE_CHECKING:
    from reachlab.scale.study import Trial
    from reachlab.scale.sweep import SweepProgress, SweepResult
    from reachlab.scale.trials import SweepConfig

SHOWN = 10
"""Trials of the table at the end: the best ones."""


def sweep(arguments: Sweep) -> None:
    """Run `reachlab sweep`."""
    prepare()
    from reachlab.runs.directory import read_config
    from reachlab.scale.sweep import read_sweep
    from reachlab.scale.sweep import sweep as run_sweep

    if arguments.resume and (arguments.out or arguments.space):
        raise InputError("--resume names the sweep's directory, which holds its space: leave --out and the space out.")
    out = arguments.resume or arguments.out or Path("runs") / f"{time.strftime('%Y%m%d-%H%M%S')}-sweep"
    settings = _resumed(arguments, read_sweep(out)) if arguments.resume else _settings(arguments)
    with SweepDisplay(settings.goal) as display:
        result = run_sweep(
            arguments.run,
            settings,
            out,
            display,
            **{name: vars(arguments)[name] for name in ("workers", "engine", "address")},
            resume=arguments.resume is not None,
            base=read_config(arguments.config) if arguments.config else None,
        )
    if arguments.json:
        print(jsonlib.dumps(result.to_json()))
    else:
        _print(result, settings.goal)
        files = ["trials.csv", *["best.json"] * bool(result.config), *(picture.name for picture in result.pictures)]
        say(f"Written: {out}: {', '.join(files)}, and a run for each trial.")
    if result.config:
        note(f"Next: reachlab train --config {quote(str(out / 'best.json'))}")
    elif all(trial.state == "fail" for trial in result.trials):
        raise InputError(f"every trial failed: '{out / 'trials.csv'}' says why.")
    else:
        note(f"Warning: no trial reached a value of {settings.goal}: best.json is not written.")


def _settings(arguments: Sweep) -> SweepConfig:
    from reachlab.scale.space import read_space
    from reachlab.scale.trials import SweepConfig

    if arguments.space is None:
        raise InputError("sweep needs a space: name a TOML file with the settings to vary, see docs/scale.md.")
    space = read_space(arguments.space, arguments.run)
    return SweepConfig(space, **_said(arguments))


def _resumed(arguments: Sweep, begun: SweepConfig) -> SweepConfig:
    """Settings of a sweep that is resumed: its own, but for the number of trials."""
    for name, value in _said(arguments).items():
        if name != "trials" and value != (before := vars(begun)[name]):
            raise InputError(
                f"'{arguments.resume}' was begun with {name} {before} and cannot be resumed with {value}: leave it out,"
                " or begin another sweep."
            )
    return replace(begun, **_said(arguments))


def _said(arguments: Sweep) -> dict[str, Any]:
    """What of a sweep's own settings was said."""
    named = {name: vars(arguments)[name] for name in ("trials", "goal", "seeds", "validations")}
    return {name: value for name, value in named.items() if value is not None}


class SweepDisplay(Bar):
    """Shows a sweep: a bar on a terminal with what runs, and a line for each trial that has ended."""

    def __init__(self, goal: str) -> None:
        """Display of a sweep for a goal; it shows nothing before its first progress."""
        super().__init__("trials")
        self._goal, self._shown = goal, set[int]()

    def __call__(self, progress: SweepProgress) -> None:
        """Show where the sweep stands."""
        ended = [trial for trial in progress.trials if trial.state != "running"]
        for trial in ended:
            if trial.number not in self._shown:
                self._shown.add(trial.number)
                note(self._line(trial, progress))
        running = "  ".join(f"{name} {100 * share:.0f} %" for name, share in progress.running.items())
        self.update(self._task, completed=len(ended), total=progress.total, status=running)

    def _line(self, trial: Trial, progress: SweepProgress) -> str:
        came_to = WORDS[trial.state]
        if trial.state == "complete":
            came_to = f"{self._goal} {'not reached' if trial.value is None else f'{trial.value:.5g}'}"
        best = progress.best
        if trial.why:
            came_to += f" ({trial.why})"
        elif best:
            came_to += "  (the best so far)" if best.number == trial.number else f"  (best: {best.value:.5g})"
        return f"trial {trial.number} of {progress.total}: {_varied(trial)}  {came_to}"


def _print(result: SweepResult, goal: str) -> None:
    """Print the best trials, and how many of each kind there were."""
    rows = [(str(one.number), f"{one.value:.5g}", _varied(one)) for one in result.ranked[:SHOWN]]
    print_table("best trials", ("trial", goal, "settings"), rows)
    states = [trial.state for trial in result.trials]
    say(", ".join(f"{states.count(state)} {words}" for state, words in WORDS.items() if state in states) + ".")


WORDS = {"complete": "complete", "pruned": "pruned", "fail": "failed", "running": "not ended"}
"""States of a trial in words."""


def _varied(trial: Trial) -> str:
    settings = trial.settings.items()
    return "  ".join(f"{name} {f'{value:.3g}' if isinstance(value, float) else value}" for name, value in settings)
