"""Maps of the workspace: where targets are reached, and where not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import wrap
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh

from reachlab.watch.results import Evaluation
from reachlab.watch.style import PALETTE

CELL_EPISODES, MOST_CELLS = 12, 20
"""Targets in a cell of a map on average, and cells along its longer side at most."""

FLAT = 1e-3
"""Targets that differ by less along an axis of a map are not spread over it [m]."""

ABOVE, FRONT = (1, 0), (1, 2)
"""Views of the workspace: the target's coordinates across and up."""

MOST_MAPS, MAP_TITLE, MAP_FONT = 2, 36, 9
"""Maps beside the errors, characters in a line above one, and their size [points]."""


class Map(NamedTuple):
    """Title, episodes, and which of the target's coordinates are across and up."""

    title: str
    evaluation: Evaluation
    across: int
    up: int


VIEWS = {"Workspace from above": ABOVE, "Workspace from the front": FRONT}
"""Maps of a single group."""


def maps_of(firsts: Sequence[tuple[str, Evaluation]], groups: int) -> list[Map]:
    """Two maps at most: of two groups from above, or of a single group from its two sides.

    Args:
        firsts: the label and the first evaluation of each group that has one.
        groups: how many groups there are, evaluated or not.
    """
    if groups > 1:
        maps = [Map(label, first, *ABOVE) for label, first in firsts[:MOST_MAPS]]
    else:
        maps = [Map(title, first, *view) for _, first in firsts for title, view in VIEWS.items()]
    return [one for one in maps if np.ptp(one.evaluation.goal[:, [one.across, one.up]], axis=0).min() > FLAT]


def draw_maps(places: Sequence[Axes], maps: Sequence[Map]) -> None:
    """Draw maps beside each other, with one bar that explains the colours of their cells."""
    meshes = [_draw_map(axes, one) for axes, one in zip(places, maps, strict=True)]
    for mesh in [mesh for mesh in meshes if mesh][-1:]:
        bar = places[0].figure.colorbar(mesh, ax=places, shrink=0.8, label="success [%]")
        bar.outline.set_visible(False)


def _draw_map(axes: Axes, one: Map) -> QuadMesh | None:
    """Draw the success rate in cells of the workspace, and every failure; gives the cells.

    Without a failure all cells would be alike: the targets are drawn instead, and there are no cells.
    """
    title, evaluation, across, up = one
    points = evaluation.goal[:, [across, up]]
    failed = points[~evaluation.success]
    came = f"{len(failed):,} of {len(points):,} missed" if len(failed) else f"all {len(points):,} reached"
    axes.set(xlabel=f"target's {'xyz'[across]} [m]", ylabel=f"target's {'xyz'[up]} [m]", aspect="equal")
    lines = [*wrap(title, MAP_TITLE), *wrap(f"{evaluation.label}: {came}", MAP_TITLE)]
    axes.set_title("\n".join(lines), fontsize=MAP_FONT)
    axes.grid(visible=False)
    if (across, up) == ABOVE:
        axes.invert_xaxis()  # what is left of an arm has a positive y
    if not len(failed):
        axes.scatter(*points.T, s=4, color=PALETTE[0], alpha=0.4, linewidths=0)
        return None
    edges = _edges(points)
    counts, hits = (np.histogram2d(*some.T, bins=edges)[0] for some in (points, points[evaluation.success]))
    rates = np.divide(100 * hits, counts, out=np.full(counts.shape, np.nan), where=counts > 0)
    mesh = axes.pcolormesh(*edges, rates.T, cmap="Blues", vmin=0, vmax=100, edgecolors="white", linewidth=0.2)
    axes.scatter(*failed.T, s=14, marker="X", color=PALETTE[1], edgecolors="white", linewidths=0.4)
    return mesh


def _edges(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges of square cells that hold `CELL_EPISODES` points `[N, 2]` on average."""
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    # Runs evaluated with one seed share their targets: those count once.
    wanted = max(1, len(np.unique(points, axis=0)) // CELL_EPISODES)
    side = max(math.sqrt(extent.prod() / wanted), extent.max() / MOST_CELLS)
    across, up = (np.linspace(low[i], low[i] + extent[i], max(1, round(extent[i] / side)) + 1) for i in (0, 1))
    return across, up
