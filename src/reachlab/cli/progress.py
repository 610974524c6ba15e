"""Progress of trainings and evaluations as they are shown to a person: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Column

from reachlab.cli.console import note, notes, print_reports, say, succeeded
from reachlab.settings.config import RunConfig

if TYPE_CHECKING:
    from reachlab.learn.loop import Progress as TrainProgress
    from reachlab.learn.train import TrainResult

LINE_INTERVAL, LINE_GROWTH = 2.0, 0.2
"""Least time between plain progress lines of a training [s], and the same as a share of its time so far: about twenty
lines tell of the first minute and a half, and thirteen more of each time that is ten times as long."""

FEW_EARLY = 0.005
"""Share of training episodes that end early, up to which nothing is said of them."""

SHOWN_EPISODES = 100
"""Training episodes that a success rate on a terminal is taken over, at least."""

EVAL_INTERVAL = 10.0
"""Time between plain progress lines of an evaluation [s]."""

BAR_WIDTH = 16
"""Width of a progress bar [characters]."""

MINUTE, HOUR = 60, 3600
"""Seconds."""

THOUSAND, MILLION = 1e3, 1e6
"""Steps."""


def _duration(seconds: float) -> str:
    if seconds < 2 * MINUTE:
        return f"{seconds:.0f} s"
    return f"{seconds / MINUTE:.1f} min" if seconds < 2 * HOUR else f"{seconds / HOUR:.1f} h"


# --- training -------------------------------------------------------------------------------------


class _Ended:
    """Training episodes that have ended since their success was last shown."""

    def __init__(self) -> None:
        self.episodes, self.successes, self.early, self.metres, self.steps = 0.0, 0.0, 0.0, 0.0, 0.0
        self._rewards: list[float] = []

    def add(self, row: dict[str, float]) -> None:
        """Count those of an iteration."""
        self.episodes += row["episodes"]
        self.successes += row["episodes"] * row["success_rate"]
        self.early += row["episodes"] * row.get("early_rate", 0.0)
        self.metres += row["episodes"] * row["final_distance"]
        self.steps += row["episodes"] * row.get("episode_length", 0.0)
        self._rewards += [row["reward"]] if "reward" in row else []

    def in_words(self, config: RunConfig) -> str:
        """What became of them in words: success, how many ended early, mean distance where a point is held, return.

        The return is the mean reward of a step times their mean length: rewards are not told by episode.
        """
        if not self.episodes:
            return ""
        text = f"success {100 * self.successes / self.episodes:.1f} % of {self.episodes:,.0f} training episodes"
        if self.early / self.episodes > FEW_EARLY:
            why = "ended by contact or outside" if config.rules.end_on_contact else "ended outside the workspace"
            text += f", {100 * self.early / self.episodes:.1f} % {why}"
        if config.rules.hold_steps:
            text += f", {1000 * self.metres / self.episodes:.1f} mm at their end"
        if self._rewards:
            text += f"  return {sum(self._rewards) / len(self._rewards) * self.steps / self.episodes:.3g}"
        return text


class Bar:
    """A progress bar while the context is open; on a terminal only."""

    def __init__(self, description: str) -> None:
        """Bar whose total is not known yet."""
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=BAR_WIDTH),
            TimeElapsedColumn(),
            TextColumn("{task.fields[status]}", table_column=Column()),  # wrapped where the terminal is narrow
            console=notes,
            transient=True,
            disable=not notes.is_terminal,
        )
        self._task = self._bar.add_task(description, total=None, status="")

    def __enter__(self) -> Self:
        """Begin to show."""
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bar away."""
        self._bar.stop()


class TrainDisplay(Bar):
    """Shows training: a bar on a terminal, plain lines elsewhere."""

    def __init__(self, config: RunConfig) -> None:
        """Display of a run; it shows nothing before its first progress."""
        super().__init__("compiling")  # training may stop early, so the bar has no total
        self._config = config
        self._next_line = 0.0
        self._ended, self._success = _Ended(), ""
        self._validated: dict[str, float] = {}
        self.first: TrainProgress | None = None
        self.last: TrainProgress | None = None
        """Progress after the first and the last iteration of this process."""

    def __call__(self, progress: TrainProgress) -> None:
        """Show the progress of training."""
        if self.first is None:  # from here on it is known that no setting is refused
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
            self._success, self._ended = self._ended.in_words(self._config), _Ended()
        self._validated |= {name: x for name, x in progress.metrics.items() if name == "validation_success"}
        shown = replace(progress, metrics=progress.metrics | self._validated)
        total = None if self._config.loop.stop_early else progress.total_steps
        status = train_line(shown, first, self._config, self._success, timed=False)
        self._bar.update(self._task, description="training", completed=progress.steps, total=total, status=status)

    def _print(self, progress: TrainProgress, first: TrainProgress) -> None:
        now, settings = progress.elapsed_s, self._config.loop
        self._validated |= {name: x for name, x in progress.metrics.items() if name == "validation_success"}
        passed = progress.metrics.get("validation_success", 0.0) >= settings.stop_success
        if now >= self._next_line or passed or progress.steps >= progress.total_steps:
            self._next_line = now + max(LINE_INTERVAL, LINE_GROWTH * now)
            shown = replace(progress, metrics=progress.metrics | self._validated)
            note(train_line(shown, first, self._config, self._ended.in_words(self._config)))
            self._ended, self._validated = _Ended(), {}


def explained(config: RunConfig) -> str:
    """What a training does, and what the numbers in its progress lines mean."""
    stop = config.loop
    most = f"at most {stop.total_steps:,}" if stop.stop_early else f"{stop.total_steps:,}"
    early = f", until {stop.stop_streak} validations in a row reach {100 * stop.stop_success:g} % success"
    varied = f" and vary in {' and '.join(config.randomise)}" if config.randomise else ""
    return (
        f"The {config.task} task on {config.robot} in {config.sim}: {most} steps{early if stop.stop_early else ''}.\n"
        f"Success: {succeeded(config)}.\n"
        f"Training episodes explore with noise{varied}; validations and the report at the end are without noise,"
        f" on other targets{', the report without what varies' if config.randomise else ''}."
    )


def train_line(
    progress: TrainProgress, first: TrainProgress, config: RunConfig, success: str, *, timed: bool = True
) -> str:
    """The progress of training in one line.

    Args:
        progress: steps, time and metrics.
        first: the same after the first iteration of this process.
        config: settings of the run.
        success: success of the training episodes in words.
        timed: whether to give the time; a bar shows it itself.
    """
    now, seconds = progress.metrics, progress.elapsed_s
    # Only whole iterations are made.
    total = -(-progress.total_steps // config.loop.iteration_steps) * config.loop.iteration_steps
    of = "" if config.loop.stop_early else f" of {total / MILLION:.2f}M"
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
    """Print the result of a training: its report, and its time."""
    print_reports([result.report.to_json()], config)
    first, last = display.first, display.last
    if resumed or first is None or last is None or first.steps == last.steps:
        speed = f", {result.steps / result.train_wall_s:,.0f} steps/s with compilation and validations."
    else:
        speed = f": {parts_of_time(first, last, result.train_wall_s)}."
    say(f"{result.steps:,} steps in {result.train_wall_s:.1f} s{speed}")


def parts_of_time(first: TrainProgress, last: TrainProgress, train_s: float) -> str:
    """Where the time of a training of `train_s` seconds went, from its progress after its first and last iteration.

    A simulator outside JAX is compiled during the first iteration, so this iteration is counted apart.
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


class EvalDisplay(Bar):
    """Shows the progress of evaluations: a bar on a terminal, plain lines elsewhere."""

    def __init__(self, episodes: int) -> None:
        """Display of evaluations of so many episodes each; it shows nothing yet."""
        super().__init__("")
        self._episodes = episodes
        self._what, self._start, self._last_line = "", 0.0, 0.0
        self._complete = False

    def begin(self, agent: str, sim: str) -> None:
        """Show that an evaluation begins."""
        self._what, self._start = f"{agent} in {sim}", time.perf_counter()
        self._last_line, self._complete = self._start, False
        self._bar.reset(self._task, total=None, description=self._what, status="")

    def __call__(self, ended: int) -> None:
        """Show how many of its episodes have ended."""
        now = time.perf_counter()
        status = f"{ended:,} of {self._episodes:,} episodes"
        self._bar.update(self._task, completed=ended, total=self._episodes, status=status)
        if self._complete:  # the last batch steps on until all of its environments have ended
            return
        self._complete = ended == self._episodes
        if not notes.is_terminal and (self._complete or now - self._last_line >= EVAL_INTERVAL):
            self._last_line = now
            note(f"{self._what}: {status}, {_duration(now - self._start)}")
