"""The picture of runs: how they learnt, how near they come, and where they fail."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
from matplotlib.figure import Figure

from reachlab.runs.files import check_place, written
from reachlab.settings.validation import InputError
from reachlab.watch.curves import draw_learning
from reachlab.watch.errors import Evaluated, draw_errors, error_lines
from reachlab.watch.maps import MOST_MAPS, draw_maps, maps_of
from reachlab.watch.results import group_runs, read_evaluations, read_settings
from reachlab.watch.style import STYLE

WIDTH, ROW = 10.0, 3.3
"""Width of the figure and height of a row of panels [inches]."""

DOTS_PER_INCH = 150

MOST_COLUMNS, LINE = 4, 0.2
"""Names beside each other in a legend, and the height of a line of it [inches]."""

HANDLE, LETTER = 0.5, 0.062
"""Widths of what stands before a name in a legend, and of a letter of it, at most [inches]."""

ENDINGS = (".png", ".svg")
"""Pictures that can be written."""


def plot(runs: str | Path | Sequence[str | Path], out: str | Path) -> list[str]:
    """Draw runs into one picture: learning curves, and if `reachlab eval` has kept episodes, errors and failures.

    Runs that differ by their seeds alone are one curve, their mean with its 95 % interval. What there is no room for is
    given back, in a sentence each.

    Args:
        runs: a run directory, or several.
        out: picture to write, its ending one of `ENDINGS`.

    Raises:
        InputError: no run, one without metrics, or an ending that cannot be drawn.
    """
    named = [runs] if isinstance(runs, str | Path) else list(runs)
    if not named:
        raise InputError("runs are drawn, and none is named: name at least one.")
    groups, out = group_runs([Path(run) for run in named]), Path(out)
    check_place("the picture", out, ENDINGS)
    found = [(group, read_evaluations(group)) for group in groups]
    limits = {read_settings(group.runs[0]).get("success_distance") for group in groups}
    firsts = [(group.label, evaluations[0]) for group, evaluations in found if evaluations]
    lines, maps = error_lines(found), maps_of(firsts, len(groups))
    with mpl.rc_context(cast("Any", STYLE)):
        columns = _columns([group.label for group in groups])
        heights = [ROW + LINE * ((len(groups) - 1) // columns)]
        heights += [ROW + LINE * (len(lines) // MOST_COLUMNS)] * bool(lines)
        figure = Figure(figsize=(WIDTH, sum(heights)), layout="constrained")
        # Rows of their own, so that maps of equal scale do not narrow the panels above them.
        upper, *lower = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
        draw_learning(upper, groups, columns)
        for row in lower:
            errors, *places = row.subplots(1, 1 + len(maps), squeeze=False)[0]
            draw_errors(errors, lines, limits.pop() if len(limits) == 1 else None)
            row.legend(*errors.get_legend_handles_labels(), loc="outside lower center", ncols=MOST_COLUMNS)
            draw_maps(places, maps)
        with written("the picture", out) as part:
            try:
                figure.savefig(part, dpi=DOTS_PER_INCH)
            except ValueError as error:
                raise InputError(f"the picture cannot be drawn: {error}.") from None
    return _left_out(found, len(maps))


def _columns(labels: Sequence[str]) -> int:
    """How many names of a legend there is room for beside each other."""
    widest = HANDLE + LETTER * max(map(len, labels))
    return max(1, min(MOST_COLUMNS, int(WIDTH / widest)))


def _left_out(found: Sequence[Evaluated], maps: int) -> list[str]:
    """Sentences about what a picture of several groups, with so many maps, has no room for."""
    evaluated = [group.label for group, evaluations in found if evaluations]
    if len(found) == 1 or not evaluated:
        return []
    more = [(group.label, [e.label for e in evaluations[1:]]) for group, evaluations in found if len(evaluations) > 1]
    unmapped = evaluated[MOST_MAPS:] if maps == MOST_MAPS else []
    return [
        *(f"of {label}: {'; '.join(rest)} (plot that run alone)." for label, rest in more),
        *(
            f"errors of {group.label}: `reachlab eval` has kept none."
            for group, evaluations in found
            if not evaluations
        ),
        *(f"the map of {label}: there is room for {MOST_MAPS}." for label in unmapped),
    ]
