"""Pictures of runs: how they learnt, how near they come, and where they fail."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, MaxNLocator, NullLocator, PercentFormatter

from reachlab.checks import InputError
from reachlab.curves import (
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

MOST_COLUMNS = 4
"""Names beside each other in the legend."""

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

VIEWS = {"Workspace from above": ABOVE, "Workspace from the front": FRONT}
"""Maps of a single group."""

STEEP = 20
"""Distances that fall by more than this ratio are drawn on a logarithmic axis."""

WIDE = 300
"""An axis over more than this ratio shows powers of ten alone."""

LEAST_ERROR = 1e-2
"""Errors below are drawn here on the logarithmic axis [mm]."""


def plot(runs: Sequence[Path], out: Path) -> None:
    """Draw runs into one picture: learning curves, and if `reachlab eval` has kept episodes, errors and failures.

    Runs that differ by their seeds alone are one curve, their mean with its 95 % interval.

    Raises:
        InputError: a run without metrics, or an ending that cannot be drawn.
    """
    groups = group_runs(runs)
    found = [(group, read_evaluations(group)) for group in groups]
    evaluated = [(group, evaluations) for group, evaluations in found if evaluations]
    maps = _maps(evaluated)
    with mpl.rc_context(cast("Any", STYLE)):
        rows = 2 if evaluated else 1
        figure = Figure(figsize=(WIDTH, ROW * rows), layout="constrained")
        # Rows of their own, so that maps of equal scale do not narrow the panels above them.
        upper, *lower = figure.subfigures(rows, 1, squeeze=False)[:, 0]
        _draw_learning(upper, groups)
        for row in lower:
            errors, *places = row.subplots(1, 1 + len(maps), squeeze=False)[0]
            _draw_errors(errors, evaluated)
            meshes = [_draw_map(axes, *entry) for axes, entry in zip(places, maps, strict=True)]
            for mesh in meshes[-1:]:
                _draw_bar(mesh, places)
        try:
            figure.savefig(out, dpi=DOTS_PER_INCH)
        except (OSError, ValueError) as error:
            raise InputError(f"the picture cannot be written to '{out}': {error}.") from None


# --- learning -------------------------------------------------------------------------------------


def _draw_learning(row: SubFigure, groups: Sequence[Group]) -> None:
    panels: list[Axes] = list(row.subplots(1, len(LEARNING)))
    for number, group in enumerate(groups):
        rows = [read_rows(run) for run in group.runs]
        curves = [pooled(run) for run in rows]
        colour = PALETTE[number % len(PALETTE)]
        for axes, (_, x, y, scale, most) in zip(panels, LEARNING, strict=True):
            _draw_band(axes, band(curves, x, y, most), scale, colour, group.label)
            if y == "success_rate" and len(rows) == 1:
                held = [row for row in rows[0] if "validation_success" in row]
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
    if any(len(group.runs) == 1 for group in groups):
        panels[0].plot([], [], ".", color="gray", ms=6, label="validation")
    row.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=MOST_COLUMNS)


def _draw_band(axes: Axes, curve: Band, scale: float, colour: str, label: str) -> None:
    axes.plot(curve.x, scale * curve.mean, color=colour, label=label)
    if curve.low is not None and curve.high is not None:
        axes.fill_between(curve.x, scale * curve.low, scale * curve.high, color=colour, alpha=0.2, linewidth=0)


# --- errors ---------------------------------------------------------------------------------------


def _draw_errors(axes: Axes, evaluated: Sequence[tuple[Group, list[Evaluation]]]) -> None:
    """Draw the share of episodes that end within a distance: of each group, or of all that one group was tried on."""
    if len(evaluated) > 1:
        lines = [(group.label, evaluations[0]) for group, evaluations in evaluated]
    else:
        lines = [(f"{e.agent}, {e.sim}", e) for e in evaluated[0][1]]
    for (label, evaluation), colour in zip(lines, PALETTE, strict=False):
        axes.ecdf(np.maximum(evaluation.error, LEAST_ERROR), label=label, color=colour)
    limit = read_settings(evaluated[0][0].runs[0]).get("success_distance")
    if limit:
        axes.axvline(1000 * limit, color="gray", linewidth=0.8, linestyle="--")
        axes.annotate(" success", (1000 * limit, 0.02), color="gray", fontsize=8)
    axes.set(title="Error on held-out targets", xlabel="tool to target at the end [mm]", ylabel="episodes within [%]")
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < WIDE * low else (1.0,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, symbol=""))
    if len(evaluated) == 1:
        axes.legend(loc="best", frameon=True, framealpha=0.8, edgecolor="none", fontsize=8)


# --- maps -----------------------------------------------------------------------------------------


Map = tuple[str, Evaluation, int, int]
"""Title, episodes, and the target's coordinates across and up."""


def _maps(evaluated: Sequence[tuple[Group, list[Evaluation]]]) -> list[Map]:
    """Two maps at most: of two groups from above, or of one group from its two sides."""
    if len(evaluated) > 1:
        maps = [(group.label, evaluations[0], *ABOVE) for group, evaluations in evaluated[:2]]
    else:
        maps = [(title, evaluations[0], *view) for _, evaluations in evaluated for title, view in VIEWS.items()]
    return [entry for entry in maps if np.ptp(entry[1].target[:, entry[2:]], axis=0).min() > FLAT]


def _draw_map(axes: Axes, title: str, evaluation: Evaluation, across: int, up: int) -> QuadMesh:
    """Draw the success rate in cells of the workspace, and every failure; gives the cells."""
    points = evaluation.target[:, [across, up]]
    edges = _edges(points)
    everything = np.ones(len(points), bool)
    counts, hits = (np.histogram2d(*points[some].T, bins=edges)[0] for some in (everything, evaluation.success))
    rates = np.divide(100 * hits, counts, out=np.full(counts.shape, np.nan), where=counts > 0)
    mesh = axes.pcolormesh(*edges, rates.T, cmap="Blues", vmin=0, vmax=100, edgecolors="white", linewidth=0.2)
    failed = points[~evaluation.success]
    axes.scatter(*failed.T, s=14, marker="X", color=FAILURE, edgecolors="white", linewidths=0.4)
    axes.set(xlabel=f"target's {'xyz'[across]} [m]", ylabel=f"target's {'xyz'[up]} [m]", aspect="equal")
    axes.set_title(f"{title}\n{len(failed):,} failures in {len(points):,} episodes")
    axes.grid(visible=False)
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
