"""Learning curves of groups of runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from matplotlib.patches import Patch
from matplotlib.ticker import EngFormatter, MaxNLocator

from reachlab.watch.results import POOL, Band, Group, band, pooled, read_rows
from reachlab.watch.style import FINE, group_style, show_plain_numbers


class Panel(NamedTuple):
    """Title, metric on either axis, what the second is multiplied by, and how large it can be."""

    title: str
    x: str
    y: str
    scale: float
    most: float


PANELS = (
    Panel("Success in training, with noise", "steps", "success_rate", 100.0, 1.0),
    Panel("The same against time", "wall_s", "success_rate", 100.0, 1.0),
    Panel("Distance at the end, with noise", "steps", "final_distance", 1000.0, math.inf),
)

LABELS = {
    "steps": "environment steps",
    "wall_s": "time of training [s]",
    "success_rate": "success [%]",
    "final_distance": "distance to the goal [mm]",
}
"""Labels of axes by metric."""

HEADROOM = 1.03
"""What an axis shows beyond the largest value that there can be."""

TICKS = 5
"""Numbers along an axis of steps."""

STEEP = 20
"""Distances that fall by more than this ratio are drawn on a logarithmic axis."""


def draw_learning(row: SubFigure, groups: Sequence[Group], columns: int) -> None:
    """Draw the curves of groups into a row of panels, with a legend of so many columns."""
    places: list[Axes] = list(row.subplots(1, len(PANELS)))
    validated = [_draw_group(places, group, *group_style(number)) for number, group in enumerate(groups)]
    for axes, panel in zip(places, PANELS, strict=True):
        _set_axes(axes, panel)
    if any(validated):
        places[0].plot([], [], ".", color="gray", ms=6, label="validation")
    handles, labels = places[0].get_legend_handles_labels()
    if any(len(group.runs) > 1 for group in groups):
        handles.append(Patch(color="gray", alpha=0.2, linewidth=0))
        labels.append("95 % interval of the mean over seeds")
    row.legend(handles, labels, loc="outside upper center", ncols=columns)


def _draw_group(places: Sequence[Axes], group: Group, colour: str, style: str) -> bool:
    """Draw a group into every panel; gives whether validations of its single run are marked."""
    rows = [read_rows(run) for run in group.runs]
    curves = [pooled(run) for run in rows]
    held = [row for row in rows[0] if "validation_success" in row] if len(rows) == 1 else []
    for axes, (_, x, y, scale, most) in zip(places, PANELS, strict=True):
        _draw_band(axes, band(curves, x, y, most), scale, colour, style, group.label)
        if y == "success_rate" and held:
            dots = [row[x] for row in held], [scale * row["validation_success"] for row in held]
            axes.plot(*dots, ".", color=colour, ms=6, mec="white", mew=0.5)
    return bool(held)


def _draw_band(axes: Axes, curve: Band, scale: float, colour: str, style: str, label: str) -> None:
    alone = "." if len(curve.x) == 1 else None  # no line joins it to another
    axes.plot(curve.x, scale * curve.mean, style, color=colour, label=label, marker=alone)
    if curve.low is not None and curve.high is not None:
        axes.fill_between(curve.x, scale * curve.low, scale * curve.high, color=colour, alpha=0.2, linewidth=0)


def _set_axes(axes: Axes, panel: Panel) -> None:
    axes.set(title=panel.title, xlabel=LABELS[panel.x], ylabel=LABELS[panel.y])
    drawn = np.concatenate([np.asarray(line.get_ydata(), float) for line in axes.lines])
    if not drawn.size:
        axes.set(xticks=[], yticks=[])
        axes.text(
            0.5, 0.5, f"fewer than {POOL} episodes\nhave ended in training", transform=axes.transAxes, ha="center"
        )
        return
    if math.isinf(panel.most) and drawn.max(initial=0.0) > STEEP * drawn.min(initial=math.inf):
        axes.set_yscale("log")
        show_plain_numbers(axes.yaxis, FINE)
    else:
        axes.set_ylim(0, None if math.isinf(panel.most) else HEADROOM * panel.most * panel.scale)
    if panel.x == "steps":
        axes.xaxis.set_major_locator(MaxNLocator(TICKS, steps=[1, 2, 5, 10]))
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
