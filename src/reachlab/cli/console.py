"""What a person reads in the terminal: results on standard output, progress and warnings on standard error."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from reachlab.settings.config import RunConfig

if TYPE_CHECKING:
    from reachlab.tasks.task import TaskSetup

PLAIN_WIDTH = 120
"""Width of tables where there is no terminal [characters]."""


class _Console(Console):
    """Console that ends the command where nobody reads its results any more; progress that nobody reads is dropped."""

    def on_broken_pipe(self) -> None:
        """Called by rich when the reader of the stream has gone."""
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
    """Print a line of a result; it is not wrapped to the width of the terminal."""
    console.print(text, soft_wrap=True)


def note(text: str) -> None:
    """Print a line of progress, or a warning."""
    notes.print(text, soft_wrap=True)


# --- words ----------------------------------------------------------------------------------------


def asked(config: RunConfig) -> str:
    """What a task asks for."""
    setup = _setup(config)
    return setup.task.asks(setup.rules, setup.period)


def succeeded(config: RunConfig) -> str:
    """What an episode has to come to, to count as a success."""
    setup = _setup(config)
    return setup.task.succeeds(setup.rules, setup.period)


def success_mm(config: RunConfig) -> str:
    """Distance of success in words."""
    return f"{1000 * _setup(config).rules.success_distance:.3g} mm"


def _setup(config: RunConfig) -> TaskSetup:
    from reachlab.envs.setup import make_setup

    return make_setup(config)


# --- tables ---------------------------------------------------------------------------------------


def print_reports(reports: Sequence[dict[str, Any]], config: RunConfig) -> None:
    """Print what counts as a success, and a table with a row for each report of a run's agents."""
    first, held = reports[0], config.rules.hold_steps > 0
    varied = f", {' and '.join(first['randomised'])} randomised" if first["randomised"] else ""
    what = f"{first['task']} task, {first['robot']}{varied}"
    say(f"{what}: {first['episodes']:,} held-out targets of seed {first['seed']}.")
    say(f"Success: {succeeded(config)}.")
    table = Table("agent", "simulator")
    # Where touching ends the episode the final error is always about the success distance, so it is left out.
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
    touched = [report for report in reports if report["self_contact"] is not None]
    if touched:
        shares = (f"{report['agent']} in {report['sim']} {100 * report['self_contact']:.2f} %" for report in touched)
        say(f"Episodes in which links of the arm met: {', '.join(shares)}.")


def _precision(report: dict[str, Any]) -> list[str]:
    error, shares = report["final_error_mm"], report["success_within"]
    errors = [_millimetres(error[name]) for name in ("median", "p99")]
    return [*errors, *(f"{100 * shares[limit]:.2f} %" for limit in ("2", "1"))]


def _millimetres(error: float | None) -> str:
    return "not held" if error is None else f"{error:.2g} mm" if error < 1 else f"{error:.1f} mm"


def print_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a plain table."""
    table = Table(title=title, title_justify="left")
    for heading in headings:
        table.add_column(heading, overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table)
