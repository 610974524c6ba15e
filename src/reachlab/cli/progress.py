"""Progress of trainings and evaluations as they are shown to a person: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import replace
from importlib import import_module
from threading import Thread
from typing import TYPE_CHECKING

from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Column

from reachlab.cli.console import note, notes, print_reports, say, task_and_success
from reachlab.settings.config import LoopConfig, RunConfig

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

ROUNDED = 0.01
"""Share of the steps asked for, up to which nothing is said of the last iteration, which is a whole one."""

WHOLE_SPEED = 1e4
"""Speed from which it is shown in thousands [steps/s]."""

BAR_WIDTH = 16
"""Width of a progress bar [characters]."""

MINUTE, HOUR = 60, 3600
"""Seconds."""


def _duration(seconds: float) -> str:
    if seconds < 2 * MINUTE:
        return f"{seconds:.0f} s"
    return f"{seconds / MINUTE:.1f} min" if seconds < 2 * HOUR else f"{seconds / HOUR:.1f} h"


# --- training -------------------------------------------------------------------------------------


def _in_words(ended: Counter[str], config: RunConfig) -> str:
    """Training episodes: success, how many ended early, mean distance where a point is held, return.

    The return is the mean reward of a step times their mean length: rewards are not known by episode.
    """
    if not (count := ended["episodes"]):
        return ""
    text = f"success {100 * ended['successes'] / count:.1f} % of {count:,.0f} training episodes"
    if ended["early"] / count > FEW_EARLY:
        why = "ended by contact or outside" if config.rules.ends_on_contact else "ended outside the workspace"
        text += f", {100 * ended['early'] / count:.1f} % {why}"
    if config.rules.holds:
        text += f", {1000 * ended['metres'] / count:.1f} mm at their end"
    if ended["iterations"]:
        text += f"  return {ended['rewards'] / ended['iterations'] * ended['steps'] / count:.3g}"
    return text


class Bar(Progress):
    """Progress while the context is open: a bar on a terminal, plain lines of episodes elsewhere."""

    def __init__(self, description: str = "") -> None:
        """Bar whose total is not known yet."""
        super().__init__(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=BAR_WIDTH),
            TimeElapsedColumn(),
            TextColumn("{task.fields[status]}", table_column=Column()),  # wrapped where the terminal is narrow
            console=notes,
            transient=True,
            disable=not notes.is_terminal,
        )
        self._task = self.add_task(description, total=None, status="")
        self._what, self._episodes, self._start, self._next_line = "", 0, 0.0, 0.0

    def expect(self, what: str, episodes: int) -> None:
        """Show that so many episodes of something begin."""
        self._what, self._episodes, self._start = what, episodes, time.perf_counter()
        self._next_line = self._start + EVAL_INTERVAL
        self.reset(self._task, total=None, description=what, status="")

    def count(self, ended: int, *, at_end: bool = True) -> None:
        """Show how many of them have ended; all of them in a plain line too, if it is wanted at the end."""
        now, complete = time.perf_counter(), ended == self._episodes
        status = f"{ended:,} of {self._episodes:,} episodes"
        self.update(self._task, completed=ended, total=self._episodes, status=status)
        # The last batch steps on until all of its environments have ended.
        told = math.inf if complete and not at_end else self._next_line
        if not notes.is_terminal and (now >= told or (complete and told < math.inf)):
            self._next_line = math.inf if complete else now + EVAL_INTERVAL
            note(f"{self._what}: {status}, {_duration(now - self._start)}")


class TrainDisplay(Bar):
    """Shows training: a bar on a terminal, plain lines elsewhere."""

    def __init__(self, config: RunConfig) -> None:
        """Display of a run; it shows nothing before its first progress."""
        # Training may stop early, so the bar has no total.
        super().__init__("loading, and compiling: 5 to 20 s the first time, then 1 to 3 s")
        self._config = config
        # Training episodes that have ended since their success was last shown, and what was shown.
        self._ended, self._success = Counter[str](), ""
        self._validated: dict[str, float] = {}
        self.first: TrainProgress | None = None
        self.last: TrainProgress | None = None
        """Progress after the first and the last iteration of this process."""

    def begun(self) -> None:
        """Show what begins, where nothing is refused any more."""
        note(explained(self._config))
        if first := self._config.learner.initial_policy:
            note(f"Its first policy is that of '{first}'.")

    def report(self, ended: int) -> None:
        """Show how many episodes of the report at the end have ended."""
        if not self._what:
            self.expect("report", self._config.loop.report_episodes)
        self.count(ended, at_end=False)

    def __call__(self, progress: TrainProgress) -> None:
        """Show the progress of training."""
        row, config, now = progress.metrics, self._config, progress.elapsed_s
        if self.first is None:
            self.first = progress
            # Half a second, for the picture at the end, while XLA computes.
            Thread(target=import_module, args=("reachlab.watch.plots",), daemon=True).start()
        self.last = progress
        names = {
            "successes": "success_rate",
            "early": "early_rate",
            "metres": "final_distance",
            "steps": "episode_length",
        }
        sums = {name: row["episodes"] * row.get(mean, 0.0) for name, mean in names.items()}
        returned = {"rewards": row.get("reward", 0.0), "iterations": "reward" in row}
        self._ended.update({"episodes": row["episodes"], **sums, **returned})
        self._validated |= {name: x for name, x in row.items() if name == "validation_success"}
        shown = replace(progress, metrics=row | self._validated)
        if notes.is_terminal:
            if self._ended["episodes"] >= SHOWN_EPISODES:
                self._success, self._ended = _in_words(self._ended, config), Counter()
            total = None if config.loop.stop_early else progress.total_steps
            status = train_line(shown, self.first, config, self._success, timed=False)
            self.update(self._task, description="training", completed=progress.steps, total=total, status=status)
            return
        passed = row.get("validation_success", 0.0) >= config.loop.stop_success
        if now >= self._next_line or passed or progress.steps >= progress.total_steps:
            self._next_line = now + max(LINE_INTERVAL, LINE_GROWTH * now)
            note(train_line(shown, self.first, config, _in_words(self._ended, config)))
            self._ended, self._validated = Counter(), {}


def whole_steps(total: int, loop: LoopConfig) -> int:
    """Steps of a training of so many in all: only whole iterations are made."""
    return -(-total // loop.iteration_steps) * loop.iteration_steps


def explained(config: RunConfig) -> str:
    """Explanation of a training, and of what the numbers in its progress lines mean."""
    stop = config.loop
    most = f"at most {stop.total_steps:,} steps" if stop.stop_early else f"{stop.total_steps:,} steps"
    if (whole := whole_steps(stop.total_steps, stop)) > (1 + ROUNDED) * stop.total_steps:
        most += f" ({whole:,} in whole iterations)"
    early = f", until {stop.stop_streak} validations in a row reach {100 * stop.stop_success:g} % success"
    varied = f" and vary in {' and '.join(config.randomise)}" if config.randomise else ""
    return (
        f"The {config.task} task on {config.robot} in {config.sim}: {most}{early if stop.stop_early else ''}.\n"
        f"Success: {task_and_success(config)[1]}.\n"
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
    total = whole_steps(progress.total_steps, config.loop)
    of = "" if config.loop.stop_early else f" of {total / 1e6:.2f}M"
    parts = [f"{progress.steps / 1e6:.2f}M{of} steps", success]
    if "validation_success" in now:
        parts.append(f"validation {100 * now['validation_success']:.1f} %")
    speed = progress.steps / seconds
    parts.append(f"{speed:,.0f} steps/s" if speed < WHOLE_SPEED else f"{speed / 1e3:.0f}k steps/s")
    if timed:
        parts.append(_duration(seconds))
    if of and first.steps < progress.steps < total:  # the first iteration may have been compiled too
        took = (now["wall_s"] - first.metrics["wall_s"]) / (progress.steps - first.steps)
        parts.append(f"about {_duration(took * (total - progress.steps))} left")
    return "  ".join(part for part in parts if part)


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
    busy_until = [one.steps / one.metrics["steps_per_second"] for one in (first, last)]
    looped, busy = last.metrics["wall_s"] - first.metrics["wall_s"], busy_until[1] - busy_until[0]
    return (
        f"{train_s - looped:.1f} s of compiling and the first {first.steps:,} steps,"
        f" {busy:.1f} s of training ({(last.steps - first.steps) / busy:,.0f} steps/s),"
        f" {looped - busy:.1f} s of validations and saving"
    )
