"""What a person sees in the terminal: results on standard output, progress and warnings on standard error."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Column, Table

from reachlab.config import RunConfig, TaskConfig

if TYPE_CHECKING:
    from reachlab.loop import Progress as TrainProgress
    from reachlab.training import TrainResult

LINES = 20
"""Plain progress lines printed of a run that uses all its steps."""

SHOWN_EPISODES = 100
"""Training episodes that a success rate on a terminal stands for, at least."""

EVAL_INTERVAL = 10.0
"""Time between plain progress lines of an evaluation [s]."""

PLAIN_WIDTH = 100
"""Width of tables where there is no terminal [characters]."""

BAR_WIDTH = 16
"""Width of a progress bar [characters]."""

MINUTE, HOUR = 60, 3600
"""Seconds."""

THOUSAND, MILLION = 1e3, 1e6
"""Steps."""


class _Console(Console):
    """A stream of the terminal. Results that nobody reads any more end the command; progress does not."""

    def on_broken_pipe(self) -> None:
        """See `Console`; called when a reader of the stream has gone."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())
        if not self.stderr:
            raise BrokenPipeError


def _make_console(*, stderr: bool) -> Console:
    made = _Console(stderr=stderr, highlight=False, markup=False)
    if not made.is_terminal:
        made.width = PLAIN_WIDTH
    return made


console = _make_console(stderr=False)
"""Results."""

notes = _make_console(stderr=True)
"""Progress and warnings."""


def say(text: str) -> None:
    """Print a line of a result, which no width of a terminal breaks."""
    console.print(text, soft_wrap=True)


def note(text: str) -> None:
    """Print a line of progress, or a warning."""
    notes.print(text, soft_wrap=True)


# --- words ----------------------------------------------------------------------------------------


def asked(config: RunConfig) -> str:
    """What a task asks for."""
    rules, period = config.rules, config.physics.control_period
    steps = f"{rules.max_steps:,} steps ({rules.max_steps * period:.2g} s)"
    low, high = rules.target_low, rules.target_high
    where = f"in the box from {low} to {high} m" if rules.targets == "box" else f"on the {rules.targets}"
    if not rules.hold_steps:
        return f"touch a point {where}: the tool comes within {_success_mm(rules)} of it, in at most {steps}"
    return f"hold a point {where}: {_held(rules, period)}; an episode has {steps}"


def succeeded(config: RunConfig) -> str:
    """What an episode has to come to, to count as a success."""
    if config.rules.hold_steps:
        return f"at the end {_held(config.rules, config.physics.control_period)}"
    return f"the tool comes within {_success_mm(config.rules)} of the target, which ends the episode"


def _held(rules: TaskConfig, period: float) -> str:
    return (
        f"the tool has been within {_success_mm(rules)} for {rules.hold_steps} steps"
        f" ({rules.hold_steps * period:.2g} s), no joint faster than {rules.hold_speed:g} rad/s"
    )


def _success_mm(rules: TaskConfig) -> str:
    return f"{1000 * rules.success_distance:g} mm"


def _duration(seconds: float) -> str:
    if seconds < 2 * MINUTE:
        return f"{seconds:.0f} s"
    return f"{seconds / MINUTE:.1f} min" if seconds < 2 * HOUR else f"{seconds / HOUR:.1f} h"


# --- training -------------------------------------------------------------------------------------


class _Ended:
    """Training episodes that have ended since something was last said of them."""

    def __init__(self) -> None:
        self.episodes, self.successes, self.metres = 0.0, 0.0, 0.0

    def add(self, row: dict[str, float]) -> None:
        """Count those of an iteration."""
        self.episodes += row["episodes"]
        self.successes += row["episodes"] * row["success_rate"]
        self.metres += row["episodes"] * row["final_distance"]

    def said(self, rules: TaskConfig) -> str:
        """Their success rate, and where touching is not enough how far the tool is in the end."""
        if not self.episodes:
            return ""
        held = "held " if rules.hold_steps else ""
        rate = f"success ({held}within {_success_mm(rules)}) {100 * self.successes / self.episodes:.1f} %"
        text = f"{rate} of {self.episodes:,.0f} training episodes"
        return text + (f", {1000 * self.metres / self.episodes:.1f} mm at their end" if held else "")


class TrainDisplay:
    """Shows training: a bar on a terminal, plain lines elsewhere."""

    def __init__(self, config: RunConfig) -> None:
        """Display of a run that shows nothing yet."""
        self._config = config
        self._bar = _bar()
        # Where training may stop early there is no end to draw a bar towards.
        self._task = self._bar.add_task("compiling", total=None, status="")
        self._printed = -1
        self._ended, self._success = _Ended(), ""
        self._validated: dict[str, float] = {}
        self.first: TrainProgress | None = None
        self.last: TrainProgress | None = None
        """Where training stood after this session's first and last iteration."""

    def __enter__(self) -> Self:
        """Begin to show."""
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        self._bar.stop()

    def __call__(self, progress: TrainProgress) -> None:
        """Show where training stands."""
        if self.first is None:  # only now is it known that nothing is refused
            note(explained(self._config))
            self.first = progress
        self.last = progress
        self._ended.add(progress.metrics)
        if notes.is_terminal:
            self._draw(progress, self.first)
        else:
            self._print(progress, self.first)

    def _draw(self, progress: TrainProgress, first: TrainProgress) -> None:
        if self._ended.episodes >= SHOWN_EPISODES:
            self._success, self._ended = self._ended.said(self._config.rules), _Ended()
        self._validated |= {name: x for name, x in progress.metrics.items() if name == "validation_success"}
        shown = replace(progress, metrics=progress.metrics | self._validated)
        total = None if self._config.ppo.stop_early else progress.total_steps
        status = train_line(shown, first, self._config, self._success, timed=False)
        self._bar.update(self._task, description="training", completed=progress.steps, total=total, status=status)

    def _print(self, progress: TrainProgress, first: TrainProgress) -> None:
        due = LINES * progress.steps // progress.total_steps
        if due > self._printed or "validation_success" in progress.metrics:
            self._printed = due
            note(train_line(progress, first, self._config, self._ended.said(self._config.rules)))
            self._ended = _Ended()


def explained(config: RunConfig) -> str:
    """What the lines of a training's progress speak of."""
    stop = config.ppo
    most = f"at most {stop.total_steps:,}" if stop.stop_early else f"{stop.total_steps:,}"
    early = f", until {stop.stop_streak} validations in a row reach {100 * stop.stop_success:g} % success"
    arms = " and on perturbed arms" if stop.randomise else ""
    return (
        f"The {config.task} task on {config.robot} in {config.sim}: {most} steps{early if stop.stop_early else ''}.\n"
        f"Success: {succeeded(config)}.\n"
        f"Training episodes explore with noise{arms}; validations and the report at the end are without noise,"
        f" on other targets{', the report on arms as they are' if stop.randomise else ''}."
    )


def train_line(
    progress: TrainProgress, first: TrainProgress, config: RunConfig, success: str, *, timed: bool = True
) -> str:
    """Where training stands.

    Args:
        progress: steps, time and metrics.
        first: the same after the first iteration of this session.
        config: settings of the run.
        success: what the training episodes came to.
        timed: whether to say the time, which a bar shows itself.
    """
    now, seconds = progress.metrics, progress.elapsed_s
    # Only whole iterations are made.
    total = -(-progress.total_steps // config.ppo.iteration_steps) * config.ppo.iteration_steps
    of = "" if config.ppo.stop_early else f" of {total / MILLION:.2f}M"
    parts = [f"{progress.steps / MILLION:.2f}M{of} steps", success]
    if "validation_success" in now:
        parts.append(f"validation {100 * now['validation_success']:.1f} %")
    parts.append(f"{_speed(progress.steps / seconds)} steps/s")
    if timed:
        parts.append(_duration(seconds))
    if of and first.steps < progress.steps < total:  # the first iteration may have been compiled too
        took = (now["wall_s"] - first.metrics["wall_s"]) / (progress.steps - first.steps)
        parts.append(f"about {_duration(took * (total - progress.steps))} left")
    return "  ".join(part for part in parts if part)


def _speed(steps_per_second: float) -> str:
    if steps_per_second < 10 * THOUSAND:
        return f"{steps_per_second:,.0f}"
    return f"{steps_per_second / THOUSAND:.0f}k"


def print_training(result: TrainResult, config: RunConfig, display: TrainDisplay, *, resumed: bool) -> None:
    """The result of a training: its report, and its time."""
    print_reports([result.report.to_json()], config)
    first, last = display.first, display.last
    if resumed or first is None or last is None or first.steps == last.steps:
        speed = f", {result.steps / result.train_wall_s:,.0f} steps/s with compilation and validations."
    else:
        speed = f": {parts_of_time(first, last, result.train_wall_s)}."
    say(f"{result.steps:,} steps in {result.train_wall_s:.1f} s{speed}")


def parts_of_time(first: TrainProgress, last: TrainProgress, train_s: float) -> str:
    """What a training of `train_s` seconds took its time for, from its progress after its first and last iteration.

    Where the simulator steps outside JAX the first iteration is compiled while it is made, so it stands apart.
    """
    looped = last.metrics["wall_s"] - first.metrics["wall_s"]
    busy = _busy_s(last) - _busy_s(first)
    return (
        f"{train_s - looped:.1f} s of compiling and the first {first.steps:,} steps,"
        f" {busy:.1f} s of training ({(last.steps - first.steps) / busy:,.0f} steps/s),"
        f" {looped - busy:.1f} s of validations and saving"
    )


def _busy_s(progress: TrainProgress) -> float:
    """Time of collecting and updating [s]."""
    return progress.steps / progress.metrics["steps_per_second"]


# --- evaluation -----------------------------------------------------------------------------------


class EvalDisplay:
    """Shows how far evaluations are: a bar on a terminal, plain lines elsewhere."""

    def __init__(self, episodes: int) -> None:
        """Display of evaluations of so many episodes, which shows nothing yet."""
        self._episodes = episodes
        self._bar = _bar()
        self._task = self._bar.add_task("", total=None, status="")
        self._what, self._start, self._told = "", 0.0, 0.0

    def __enter__(self) -> Self:
        """Begin to show."""
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        self._bar.stop()

    def begin(self, agent: str, sim: str) -> None:
        """Show that an evaluation begins."""
        self._what, self._start = f"{agent} in {sim}", time.perf_counter()
        self._told = self._start
        self._bar.reset(self._task, total=None, description=self._what, status="")

    def __call__(self, ended: int) -> None:
        """Show how many of its episodes have ended."""
        now = time.perf_counter()
        status = f"{ended:,} of {self._episodes:,} episodes"
        self._bar.update(self._task, completed=ended, total=self._episodes, status=status)
        if not notes.is_terminal and (ended == self._episodes or now - self._told >= EVAL_INTERVAL):
            self._told = now
            note(f"{self._what}: {status}, {_duration(now - self._start)}")


def _bar() -> Progress:
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=BAR_WIDTH),
        TimeElapsedColumn(),
        TextColumn("{task.fields[status]}", table_column=Column()),  # wrapped where the terminal is narrow
        console=notes,
        transient=True,
        disable=not notes.is_terminal,
    )


# --- tables ---------------------------------------------------------------------------------------


def print_reports(reports: Sequence[dict[str, Any]], config: RunConfig) -> None:
    """One table with a row for each report of a run's agents, and above it what counts as a success."""
    first, held = reports[0], config.rules.hold_steps > 0
    perturbed = ", perturbed" * first["perturb"] + ", random views" * first["perturb_view"]
    what = f"{first['task']} task, {first['robot']}{perturbed}"
    say(f"{what}: {first['episodes']:,} held-out targets of seed {first['seed']}.")
    say(f"Success: {succeeded(config)}.")
    table = Table("agent", "simulator")
    # Where touching ends the episode, how far the tool is then is the success distance, and says nothing.
    last = (
        ("median error", "p99 error", "≤ 2 mm", "≤ 1 mm", "time to reach") if held else ("mean steps", "time to reach")
    )
    for heading in ("success", "95 % interval", *last):
        table.add_column(heading, justify="right")
    for report in reports:
        low, high = report["success_interval"]
        time_s = report["time_to_reach_s"]
        table.add_row(
            report["agent"],
            report["sim"],
            f"{100 * report['success_rate']:.2f} %",
            f"{100 * low:.1f} to {100 * high:.1f}",
            *(_precision(report) if held else [f"{report['steps_mean']:.0f}"]),
            "" if time_s is None else f"{time_s:.2f} s",
        )
    console.print(table)


def _precision(report: dict[str, Any]) -> list[str]:
    error, shares = report["final_error_mm"], report["success_within"]
    errors = [_millimetres(error[name]) for name in ("median", "p99")]
    return [*errors, *(f"{100 * shares[limit]:.2f} %" for limit in ("2", "1"))]


def _millimetres(error: float | None) -> str:
    return "not held" if error is None else f"{error:.2f} mm" if error < 1 else f"{error:.1f} mm"


def print_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A plain table."""
    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading)
    for row in rows:
        table.add_row(*row)
    console.print(table)
