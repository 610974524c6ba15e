"""Pictures of runs: how they learnt, how near they come, and where they fail."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, MaxNLocator, NullLocator, PercentFormatter

from reachlab.agents import AGENTS
from reachlab.settings.validation import InputError
from reachlab.watch.results import (
    Band,
    Evaluation,
    Group,
    band,
    group_runs,
    pooled,
    read_evaluations,
    read_rows,
    read_settings,
)

WIDTH, ROW = 10.0, 3.3
"""Width of the figure and height of a row of panels [inches]."""

DOTS_PER_INCH = 150

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours told apart without colour vision too (Okabe and Ito, "Color universal design", 2008)."""

FAILURE = PALETTE[1]

STYLE: dict[str, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.6,
    "svg.hashsalt": "reachlab",
}

LEARNING = (
    ("Success in training, with noise", "steps", "success_rate", 100.0, 1.0),
    ("The same against time", "wall_s", "success_rate", 100.0, 1.0),
    ("Distance at the end, with noise", "steps", "final_distance", 1000.0, math.inf),
)
"""Panels of learning: title, metric on either axis, what the second is multiplied by, and how large it can be."""

HEADROOM = 1.03
"""What an axis shows beyond the largest value that there can be."""

TICKS = 5
"""Numbers along an axis of steps."""

MOST_COLUMNS, LINE = 4, 0.2
"""Names beside each other in a legend, and the height of a line of it [inches]."""

STYLES = ("-", "--", ":", "-.")
"""Lines that tell simulators apart, and more groups than there are colours."""

WIDTHS = (1.6, 0.8)
"""Widths of a line, and of one whose arms or views varied."""

ENDINGS = (".png", ".svg")
"""Pictures that can be written."""

AXES_LABELS = {
    "steps": "environment steps",
    "wall_s": "time of training [s]",
    "success_rate": "success [%]",
    "final_distance": "tool to target [mm]",
}

CELL_EPISODES, MOST_CELLS = 12, 20
"""Targets in a cell of a map on average, and cells along its longer side at most."""

FLAT = 1e-3
"""Targets that differ by less along an axis of a map are not spread over it [m]."""

ABOVE, FRONT = (1, 0), (1, 2)
"""Views of the workspace: the target's coordinates across and up."""

MOST_MAPS, MAP_TITLE, MAP_FONT = 2, 38, 9
"""Maps beside the errors, characters in a line above one, and their size [points]."""

Evaluated = tuple[Group, list[Evaluation]]
"""A group and what it was tried on."""

Map = tuple[str, Evaluation, int, int]
"""Title, episodes, and the target's coordinates across and up."""

VIEWS = {"Workspace from above": ABOVE, "Workspace from the front": FRONT}
"""Maps of a single group."""

STEEP = 20
"""Distances that fall by more than this ratio are drawn on a logarithmic axis."""

WIDE = 300
"""An axis over more than this ratio shows powers of ten alone."""

LEAST_ERROR = 1e-2
"""Errors below are drawn here on the logarithmic axis [mm]."""


def plot(runs: Sequence[Path], out: Path) -> list[str]:
    """Draw runs into one picture: learning curves, and if `reachlab eval` has kept episodes, errors and failures.

    Runs that differ by their seeds alone are one curve, their mean with its 95 % interval. What there is no room for is
    given back, in a sentence each.

    Raises:
        InputError: a run without metrics, or an ending that cannot be drawn.
    """
    if out.suffix not in ENDINGS:
        endings = " or ".join(ENDINGS)
        raise InputError(f"the picture cannot be written to '{out}': name a file that ends in {endings}.")
    groups = group_runs(runs)
    found = [(group, read_evaluations(group)) for group in groups]
    limits = {read_settings(group.runs[0]).get("success_distance") for group in groups}
    lines, maps = _lines(found), _maps(found)
    with mpl.rc_context(cast("Any", STYLE)):
        heights = [ROW] + [ROW + LINE * (len(lines) // MOST_COLUMNS)] * bool(lines)
        figure = Figure(figsize=(WIDTH, sum(heights)), layout="constrained")
        # Rows of their own, so that maps of equal scale do not narrow the panels above them.
        upper, *lower = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
        _draw_learning(upper, groups)
        for row in lower:
            errors, *places = row.subplots(1, 1 + len(maps), squeeze=False)[0]
            _draw_errors(errors, lines, limits.pop() if len(limits) == 1 else None)
            row.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncols=MOST_COLUMNS)
            meshes = [_draw_map(axes, *entry) for axes, entry in zip(places, maps, strict=True)]
            for mesh in [mesh for mesh in meshes if mesh][-1:]:
                _draw_bar(mesh, places)
        try:
            figure.savefig(out, dpi=DOTS_PER_INCH)
        except (OSError, ValueError) as error:
            raise InputError(f"the picture cannot be written to '{out}': {error}.") from None
    return _left_out(found, maps)


def _left_out(found: Sequence[Evaluated], maps: Sequence[Map]) -> list[str]:
    """Sentences about what a picture of several groups has no room for."""
    evaluated = [group.label for group, evaluations in found if evaluations]
    if len(found) == 1 or not evaluated:
        return []
    more = [(group.label, [e.label for e in evaluations[1:]]) for group, evaluations in found if len(evaluations) > 1]
    unmapped = evaluated[MOST_MAPS:] if len(maps) == MOST_MAPS else []
    return [
        *(f"of {label}: {'; '.join(rest)} (plot that run alone)." for label, rest in more),
        *(
            f"errors of {group.label}: `reachlab eval` has kept none."
            for group, evaluations in found
            if not evaluations
        ),
        *(f"the map of {label}: there is room for {MOST_MAPS}." for label in unmapped),
    ]


# --- learning -------------------------------------------------------------------------------------


def _draw_learning(row: SubFigure, groups: Sequence[Group]) -> None:
    panels: list[Axes] = list(row.subplots(1, len(LEARNING)))
    validated = False
    for number, group in enumerate(groups):
        rows = [read_rows(run) for run in group.runs]
        curves = [pooled(run) for run in rows]
        colour, style = _group_look(number)
        for axes, (_, x, y, scale, most) in zip(panels, LEARNING, strict=True):
            _draw_band(axes, band(curves, x, y, most), scale, colour, style, group.label)
            if y == "success_rate" and len(rows) == 1:
                held = [row for row in rows[0] if "validation_success" in row]
                validated |= bool(held)
                dots = [row[x] for row in held], [scale * row["validation_success"] for row in held]
                axes.plot(*dots, ".", color=colour, ms=6, mec="white", mew=0.5)
    for axes, (title, x, y, scale, most) in zip(panels, LEARNING, strict=True):
        axes.set(title=title, xlabel=AXES_LABELS[x], ylabel=AXES_LABELS[y])
        drawn = np.concatenate([np.asarray(line.get_ydata(), float) for line in axes.lines])
        if math.isinf(most) and drawn.max(initial=0.0) > STEEP * drawn.min(initial=math.inf):
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axes.yaxis.set_minor_locator(NullLocator())
        else:
            axes.set_ylim(0, None if math.isinf(most) else HEADROOM * most * scale)
        if x == "steps":
            axes.xaxis.set_major_locator(MaxNLocator(TICKS, steps=[1, 2, 5, 10]))
            axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    if validated:
        panels[0].plot([], [], ".", color="gray", ms=6, label="validation")
    row.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=MOST_COLUMNS)


def _group_look(number: int) -> tuple[str, str]:
    """Colour and line of a group, by its place among those that were given."""
    return PALETTE[number % len(PALETTE)], STYLES[number // len(PALETTE) % len(STYLES)]


def _draw_band(axes: Axes, curve: Band, scale: float, colour: str, style: str, label: str) -> None:
    axes.plot(curve.x, scale * curve.mean, style, color=colour, label=label)
    if curve.low is not None and curve.high is not None:
        axes.fill_between(curve.x, scale * curve.low, scale * curve.high, color=colour, alpha=0.2, linewidth=0)


# --- errors ---------------------------------------------------------------------------------------


class Line(NamedTuple):
    """A curve of errors and how it is drawn."""

    label: str
    evaluation: Evaluation
    colour: str
    style: str
    width: float


def _lines(found: Sequence[Evaluated]) -> list[Line]:
    """Curves of the first evaluation of each group, or of all that a single group was tried on."""
    if len(found) == 1:
        return _agents_lines(found[0][1])
    return [
        Line(f"{group.label}: {evaluation.label}", evaluation, *_group_look(number), WIDTHS[0])
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
            STYLES[sims.index(e.sim) % len(STYLES)],
            WIDTHS[bool(e.condition)],
        )
        for e in evaluations
    ]


def _draw_errors(axes: Axes, lines: Sequence[Line], limit: float | None) -> None:
    """Draw the share of episodes that end within a distance, and the distance of success [m]."""
    for label, evaluation, colour, style, width in lines:
        error = np.maximum(evaluation.error, LEAST_ERROR)
        axes.ecdf(error, label=label, color=colour, linestyle=style, linewidth=width)
    if limit:
        label = f"success: {1000 * limit:g} mm"
        axes.axvline(1000 * limit, color="gray", linewidth=0.8, linestyle="--", label=label)
    axes.set(title="Error on held-out targets", xlabel="tool to target at the end [mm]", ylabel="episodes within [%]")
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < WIDE * low else (1.0,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))


# --- maps -----------------------------------------------------------------------------------------


def _maps(found: Sequence[Evaluated]) -> list[Map]:
    """Two maps at most: of two groups from above, or of one group from its two sides."""
    firsts = [(group.label, evaluations[0]) for group, evaluations in found if evaluations]
    if len(found) > 1:
        maps = [(label, first, *ABOVE) for label, first in firsts[:MOST_MAPS]]
    else:
        maps = [(title, first, *view) for _, first in firsts for title, view in VIEWS.items()]
    return [entry for entry in maps if np.ptp(entry[1].goal[:, entry[2:]], axis=0).min() > FLAT]


def _draw_map(axes: Axes, title: str, evaluation: Evaluation, across: int, up: int) -> QuadMesh | None:
    """Draw the success rate in cells of the workspace, and every failure; gives the cells.

    Without a failure all cells would be alike: the targets are drawn instead, and there are no cells.
    """
    points = evaluation.goal[:, [across, up]]
    failed = points[~evaluation.success]
    came = f"{len(failed):,} of {len(points):,} missed" if len(failed) else f"all {len(points):,} reached"
    axes.set(xlabel=f"target's {'xyz'[across]} [m]", ylabel=f"target's {'xyz'[up]} [m]", aspect="equal")
    lines = [*wrap(title, MAP_TITLE), *wrap(f"{evaluation.label}: {came}", MAP_TITLE)]
    axes.set_title("\n".join(lines), fontsize=MAP_FONT)
    axes.grid(visible=False)
    if not len(failed):
        axes.scatter(*points.T, s=4, color=PALETTE[0], alpha=0.4, linewidths=0)
        return None
    edges = _edges(points)
    everything = np.ones(len(points), bool)
    counts, hits = (np.histogram2d(*points[some].T, bins=edges)[0] for some in (everything, evaluation.success))
    rates = np.divide(100 * hits, counts, out=np.full(counts.shape, np.nan), where=counts > 0)
    mesh = axes.pcolormesh(*edges, rates.T, cmap="Blues", vmin=0, vmax=100, edgecolors="white", linewidth=0.2)
    axes.scatter(*failed.T, s=14, marker="X", color=FAILURE, edgecolors="white", linewidths=0.4)
    return mesh


def _draw_bar(mesh: QuadMesh, places: Sequence[Axes]) -> None:
    bar = places[0].figure.colorbar(mesh, ax=places, shrink=0.8, label="success [%]")
    bar.outline.set_visible(False)


def _edges(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges of square cells that hold `CELL_EPISODES` points `[N, 2]` on average."""
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    # Runs evaluated with one seed share their targets: those count once.
    wanted = max(1, len(np.unique(points, axis=0)) // CELL_EPISODES)
    side = max(math.sqrt(extent.prod() / wanted), extent.max() / MOST_CELLS)
    across, up = (np.linspace(low[i], low[i] + extent[i], max(1, round(extent[i] / side)) + 1) for i in (0, 1))
    return across, up
