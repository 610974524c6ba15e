"""What a person sees in the terminal: progress and tables, on standard error."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

if TYPE_CHECKING:
    from reachlab.loop import Progress as TrainProgress

LINES = 20
"""Plain progress lines printed of a run that uses all its steps."""

PLAIN_WIDTH = 100
"""Width of tables and lines where there is no terminal [characters]."""

console = Console(stderr=True, highlight=False)
if not console.is_terminal:
    console = Console(stderr=True, highlight=False, width=PLAIN_WIDTH)


class TrainDisplay:
    """Shows training: a bar on a terminal, plain lines elsewhere."""

    def __init__(self) -> None:
        """Display that shows nothing yet."""
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[status]}"),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("compiling", total=None, status="")
        self._printed = -1

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
        now = progress.metrics
        left = max(progress.total_steps - progress.steps, 0) / max(now["steps_per_second"], 1.0)
        ended = f"success {100 * now['success_rate']:5.1f} %  {1000 * now['final_distance']:.1f} mm off"
        status = (
            f"{progress.steps / 1e6:.2f}M steps  {ended if now['episodes'] else 'no episode to count'}"
            f"  {now['steps_per_second'] / 1e3:.0f}k steps/s  at most {left:.0f} s left"
        )
        if "validation_success" in now:
            status += f"  validation {100 * now['validation_success']:.1f} %"
        self._bar.update(
            self._task, description="training", completed=progress.steps, total=progress.total_steps, status=status
        )
        due = LINES * progress.steps // progress.total_steps
        if not console.is_terminal and (due > self._printed or "validation_success" in now):
            self._printed = due
            console.print(status)


def print_reports(reports: Sequence[dict[str, Any]]) -> None:
    """One table with a row for each report."""
    first = reports[0]
    perturbed = ", perturbed" * first["perturb"] + ", random views" * first["perturb_view"]
    what = f"{first['task']} task, {first['robot']}{perturbed}"
    title = f"{what}: {first['episodes']:,} held-out targets of seed {first['seed']}"
    held = first["success_within"] is not None
    table = Table(title=title, title_justify="left")
    for heading in ("agent", "simulator"):
        table.add_column(heading)
    last = ("≤ 2 mm", "≤ 1 mm", "time") if held else ("steps",)
    for heading in ("success", "95 % interval", "median", "p99", *last):
        table.add_column(heading, justify="right")
    for report in reports:
        low, high = report["success_interval"]
        error = report["final_error_mm"]
        table.add_row(
            report["agent"],
            report["sim"],
            f"{100 * report['success_rate']:.2f} %",
            f"{100 * low:.1f} to {100 * high:.1f}",
            _millimetres(error["median"]),
            _millimetres(error["p99"]),
            *(_precision(report) if held else [f"{report['steps_mean']:.0f}"]),
        )
    console.print(table)


def _precision(report: dict[str, Any]) -> list[str]:
    shares, time = report["success_within"], report["time_to_reach_s"]
    return [*(f"{100 * shares[limit]:.2f} %" for limit in ("2", "1")), "" if time is None else f"{time:.2f} s"]


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
