"""Text in the terminal: results on standard output, progress and warnings on standard error."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from reachlab.agents import AGENTS
from reachlab.settings.config import RunConfig

PLAIN_WIDTH = 120
"""Width of tables where there is no terminal [characters]."""


class _Console(Console):
    """Console that ends the command where nobody reads its results any more; progress that nobody reads is dropped."""

    def on_broken_pipe(self) -> None:
        """Called by rich when the reader of the stream has gone."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())
        if not self.stderr:
            raise BrokenPipeError

    def _check_buffer(self) -> None:
        """Called by rich to write; on a terminal that was closed nothing is, for its signal ends the command."""
        try:
            super()._check_buffer()
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())


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


def task_and_success(config: RunConfig) -> tuple[str, str]:
    """A task, and what an episode of it has to come to, to count as a success."""
    from reachlab.envs.setup import make_setup

    setup = make_setup(config)
    return setup.task.asks(setup.rules, setup.period), setup.task.succeeds(setup.rules, setup.period)


# --- tables ---------------------------------------------------------------------------------------


def print_reports(reports: Sequence[dict[str, Any]], config: RunConfig) -> None:
    """Print what counts as a success, and a table with a row for each report of a run's agents."""
    first = reports[0]
    varied = f", {' and '.join(first['randomised'])} randomised" if first["randomised"] else ""
    what = f"{first['task']} task, {first['robot']}{varied}"
    say(f"{what}: {first['episodes']:,} held-out targets of seed {first['seed']}.")
    say(f"Success: {task_and_success(config)[1]}.")
    runs = ["run"] if any("run" in report for report in reports) else []
    table = Table(*runs, "agent", "simulator")
    figures = [_figures(report, held=config.rules.holds) for report in reports]
    for heading in ("success", "95 % interval", *figures[0]):
        table.add_column(heading, justify="right")
    for report, row in zip(reports, figures, strict=True):
        low, high = report["success_interval"]
        interval = f"{100 * low:.1f} to {100 * high:.1f}" if low < high else "–"
        success = _percent(report["success_rate"]), interval
        table.add_row(*(report.get(name, "") for name in runs), report["agent"], report["sim"], *success, *row.values())
    console.print(table)
    _say_blind(reports, config)
    _say_steps(reports)
    _say_ends(reports)
    met = "links of the arm met, by the shapes in its file"
    for kind, what in (("contact", "the arm touched anything"), ("self_contact", met)):
        if shares := [f"{_who(one)} {_percent(one[kind])}" for one in reports if one[kind] is not None]:
            say(f"Episodes in which {what}: {', '.join(shares)}.")
    for report in reports:
        if times := report.get("planning_s"):
            median, p99 = 1000 * times["median"], 1000 * times["p99"]
            say(f"{_who(report)} planned for {median:.0f} ms, in 99 % of the episodes for at most {p99:.0f} ms.")
        if left := [f"{what} in {_percent(share)}" for what, share in (report.get("object") or {}).items() if share]:
            say(f"The object was {' and '.join(left)} of the episodes, {_who(report)}.")
        if force := report.get("largest_force_n"):
            median, p95 = (f"{force[name]:.3g} N" for name in ("median", "p95"))
            say(f"{_who(report)} felt at most {median} at the wrist in the median episode, {p95} in 95 % of them.")
    if (straight := first.get("straight")) is not None:
        free = "the straight way of the joints is free, if by little"
        say(f"{_percent(straight)} of the episodes need no avoiding: {free}.")


def _say_blind(reports: Sequence[dict[str, Any]], config: RunConfig) -> None:
    """Print that agents that look at nothing are no baselines where their actions correct a controller's."""
    from reachlab.tasks.actions import ACTIONS

    blind = dict.fromkeys(name for report in reports if (name := report["agent"]) in AGENTS and AGENTS[name].blind)
    if blind and ACTIONS[config.rules.action].whole:
        say(f"Actions of {' and '.join(blind)} are added to a controller's here: what they come to is its doing.")


def _say_steps(reports: Sequence[dict[str, Any]]) -> None:
    """Print how long a step is, where simulators differ in it: their numbers of steps cannot be compared."""
    periods = {report["sim"]: report.get("control_period") for report in reports}
    if len({*periods.values()} - {None}) > 1:
        steps = (f"{1000 * period:.3g} ms in {sim}" for sim, period in periods.items() if period)
        say(f"A step is {', '.join(steps)}: equally many steps are different times.")


WAYS = {"outside": "left the workspace", "contact": "touched something", "time": "ran out of time"}
"""Ways in which episodes fail, see `Report.ends`."""

MANY = 0.05
"""Share of the episodes of a trained policy that end outside from which a likely cause is named."""


def _say_ends(reports: Sequence[dict[str, Any]]) -> None:
    """Print how the episodes that did not succeed ended; reports of earlier versions do not say."""
    for report in reports:
        ends = report.get("ends") or {}
        if failed := [f"{_percent(ends[way])} {words}" for way, words in WAYS.items() if ends.get(way)]:
            say(f"Not a success, {_who(report)}: {', '.join(failed)}.")
        if report["agent"] == "trained" and ends.get("outside", 0.0) > MANY:
            say(
                "Leaving the workspace ends an episode: where each step costs more than leaving does, a policy learns"
                " to leave. Train for more steps, or choose another --reward, as dense; docs/reward.md says more."
            )


def _who(report: dict[str, Any]) -> str:
    """Whose report it is, where a table has several."""
    run = report.get("run")
    return f"{report['agent']}{f' ({run})' if run else ''} in {report['sim']}"


def _figures(report: dict[str, Any], *, held: bool) -> dict[str, str]:
    """Figures of a report beside its success, by heading; which of them depends on the task."""
    time_s, error, angle = report["time_to_reach_s"], report["final_error_mm"], report["final_angle_rad"]
    reached = {"time to reach": "" if time_s is None else f"{time_s:.2f} s"}
    if tracking := report["tracking"]:
        lag = tracking["lag_s"]
        errors = {f"{name} error": _millimetres(tracking[f"{name.lower()}_mm"]) for name in ("RMS", "p95")}
        return {**errors, "lag": "" if lag is None else f"{1000 * lag:.1f} ms"}
    if pairs := report["success_within_pairs"]:
        median = "not held" if angle["median"] is None else f"{angle['median']:.2g} rad"
        shares = {f"≤ {pair}": _percent(share) for pair, share in list(pairs.items())[1:]}
        return {"median error": _millimetres(error["median"]), "median angle": median, **shares, **reached}
    if held:
        within = report["success_within"] or {}
        shares = {f"≤ {limit} mm": _percent(within[limit]) for limit in ("2", "1") if within}
        return {f"{name} error": _millimetres(error[name]) for name in ("median", "p99")} | shares | reached
    # Where touching ends the episode the final error is always about the success distance, so it is left out.
    return {"mean steps": f"{report['steps_mean']:.0f}", **reached}


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %"


def _millimetres(error: float | None) -> str:
    return "not held" if error is None else f"{error:.2g} mm" if error < 1 else f"{error:.1f} mm"


def print_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a plain table."""
    table = Table(*(Column(heading, overflow="fold") for heading in headings), title=title, title_justify="left")
    for row in rows:
        table.add_row(*row)
    console.print(table)
