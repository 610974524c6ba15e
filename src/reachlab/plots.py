"""Pictures of a run's numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reachlab.config import InputError
from reachlab.metrics import read_metrics

SIZE = (9.0, 3.6)
"""Width and height of the figure [inches]."""

DOTS_PER_INCH = 150

POOL = 50
"""Training episodes that a point of a curve stands for at least."""


def plot_curves(runs: Sequence[Path], out: Path) -> None:
    """Draw the learning curves of runs into one picture: success and return of training against steps and seconds.

    Raises:
        InputError: a run without metrics, or an ending that cannot be drawn.
    """
    figure = Figure(figsize=SIZE, layout="constrained")
    axes: list[Axes] = list(figure.subplots(1, 3))
    for run in runs:
        rows = _rows(run)
        label = run.name
        ended = _pooled(rows, run)
        axes[0].plot([row["steps"] for row in ended], [100 * row["success_rate"] for row in ended], label=label)
        axes[1].plot([row["wall_s"] for row in ended], [100 * row["success_rate"] for row in ended], label=label)
        axes[2].plot([row["steps"] for row in ended], [1000 * row["final_distance"] for row in ended], label=label)
        held = [row for row in rows if "validation_success" in row]
        axes[0].plot([r["steps"] for r in held], [100 * r["validation_success"] for r in held], "k.", ms=5)
        axes[1].plot([r["wall_s"] for r in held], [100 * r["validation_success"] for r in held], "k.", ms=5)
    _dress(axes)
    with mpl.rc_context({"svg.hashsalt": "reachlab"}):
        try:
            figure.savefig(out, dpi=DOTS_PER_INCH)
        except (OSError, ValueError) as error:
            raise InputError(f"the picture cannot be written to '{out}': {error}.") from None


def _dress(axes: Sequence[Axes]) -> None:
    axes[0].set(xlabel="environment steps", ylabel="success [%]", ylim=(-3, 103), title="success while training")
    axes[1].set(xlabel="seconds", ylabel="success [%]", ylim=(-3, 103), title="the same against time")
    axes[2].set(xlabel="environment steps", ylabel="distance [mm]", title="distance at the end", ylim=(0, None))
    axes[0].plot([], [], "k.", ms=5, label="validation")
    axes[0].legend(loc="lower right", frameon=False, fontsize="small")
    for axis in axes:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].ticklabel_format(axis="x", style="sci", scilimits=(0, 4))
    axes[2].ticklabel_format(axis="x", style="sci", scilimits=(0, 4))


def _pooled(rows: Sequence[dict[str, Any]], run: Path) -> list[dict[str, float]]:
    """Rows joined until each stands for at least `POOL` episodes; a rest at the end that is smaller is left out."""
    points, episodes, sums = [], 0.0, {"success_rate": 0.0, "final_distance": 0.0}
    for row in rows:
        if missing := {"steps", "wall_s", "episodes", *sums} - row.keys():
            raise InputError(f"a row of '{run / 'metrics.jsonl'}' lacks {min(missing)!r}: it is not one of a training.")
        episodes += row["episodes"]
        sums = {name: total + row[name] * row["episodes"] for name, total in sums.items()}
        if episodes >= POOL:
            means = {name: total / episodes for name, total in sums.items()}
            points.append({"steps": row["steps"], "wall_s": row["wall_s"], **means})
            episodes, sums = 0.0, dict.fromkeys(sums, 0.0)
    return points


def _rows(run: Path) -> list[dict[str, Any]]:
    file = run / "metrics.jsonl"
    if not file.is_file():
        raise InputError(f"run directory '{run}' holds no metrics.jsonl: train one with `reachlab train --out {run}`.")
    return read_metrics(file)
