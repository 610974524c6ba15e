"""How near the tool comes to held-out targets: the distribution of errors, a curve for each evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from reachlab.agents import AGENTS
from reachlab.watch.results import Evaluation, Group
from reachlab.watch.style import COARSE, FINE, LINES, PALETTE, group_style, show_plain_numbers

WIDTHS = (1.6, 0.8)
"""Widths of a line, and of one whose arms or views varied."""

WIDE = 300
"""An axis over more than this ratio shows powers of ten alone."""

LEAST_ERROR = 1e-2
"""Errors below are drawn here on the logarithmic axis [mm]."""

Evaluated = tuple[Group, list[Evaluation]]
"""A group and its evaluations."""


class Line(NamedTuple):
    """A curve of errors and how it is drawn."""

    label: str
    evaluation: Evaluation
    colour: str
    style: str
    width: float


def error_lines(found: Sequence[Evaluated]) -> list[Line]:
    """Curves of the first evaluation of each group, or of all evaluations of a single group."""
    if len(found) == 1:
        return _agents_lines(found[0][1])
    return [
        Line(f"{group.label}: {evaluation.label}", evaluation, *group_style(number), WIDTHS[0])
        for number, (group, evaluations) in enumerate(found)
        for evaluation in evaluations[:1]
    ]


def _agents_lines(evaluations: Sequence[Evaluation]) -> list[Line]:
    """Curves of agents, told apart by colour, in simulators, told apart by the kind of line."""
    agents = list(dict.fromkeys([*AGENTS, *(e.agent for e in evaluations)]))
    sims = list(dict.fromkeys(e.sim for e in evaluations))
    return [
        Line(
            e.label,
            e,
            PALETTE[agents.index(e.agent) % len(PALETTE)],
            LINES[sims.index(e.sim) % len(LINES)],
            WIDTHS[bool(e.condition)],
        )
        for e in evaluations
    ]


def draw_errors(axes: Axes, lines: Sequence[Line], limit: float | None) -> None:
    """Draw the share of episodes that end within a distance, and the distance of success [m]."""
    for label, evaluation, colour, style, width in lines:
        error = np.maximum(evaluation.error, LEAST_ERROR)
        axes.ecdf(error, label=label, color=colour, linestyle=style, linewidth=width)
    if limit:
        label = f"success: {1000 * limit:g} mm"
        axes.axvline(1000 * limit, color="gray", linewidth=0.8, linestyle="--", label=label)
    axes.set(
        title="Error on held-out targets", xlabel="distance to the goal at the end [mm]", ylabel="episodes within [%]"
    )
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    show_plain_numbers(axes.xaxis, FINE if high < WIDE * low else COARSE)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))
