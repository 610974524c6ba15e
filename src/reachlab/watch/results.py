"""The numbers behind the plots: runs grouped by configuration, their learning curves and their evaluations."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.envs import presets
from reachlab.envs.presets import preset
from reachlab.evaluation.intervals import student_half_width
from reachlab.runs.directory import RunDirectory
from reachlab.runs.shipped import refuse_sweep
from reachlab.settings.extensions import import_remembered
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError

POOL = 100
"""Training episodes that a point of a curve stands for at least."""

MOST_DIFFERENCES = 3
"""Settings that a label names at most; groups that differ in more are called by their first run."""

CHOICES = ("task", *presets.CHOICES)
"""Settings that bring others with them, see `presets.preset`."""

POOLED = ("success_rate", "final_distance")
"""Metrics that are means over the episodes of an iteration."""


@dataclass(frozen=True)
class Group:
    """Runs that differ by their seeds alone, and what tells them from other groups."""

    label: str
    runs: tuple[Path, ...]


@dataclass(frozen=True)
class Band:
    """A mean over runs `[N]` against `x [N]`, and its 95 % interval; a single run has none."""

    x: np.ndarray
    mean: np.ndarray
    low: np.ndarray | None
    high: np.ndarray | None


FIELDS = ("goal", "distance", "success")
"""Arrays that an evaluation keeps of its episodes."""


@dataclass(frozen=True)
class Evaluation:
    """Held-out episodes of a group's runs, by one agent in one simulator.

    Attributes:
        sim, agent: names.
        condition: what varied from episode to episode; empty where nothing did.
        goal: `[N, 3]` [m].
        error: tool to target at the end `[N]` [mm], infinite where it had to be held and was not.
        success: `[N]`.
    """

    sim: str
    agent: str
    condition: str
    goal: np.ndarray
    error: np.ndarray
    success: np.ndarray

    @property
    def label(self) -> str:
        """What tells it from a group's other evaluations."""
        return f"{self.agent}{self.condition}, {self.sim}"


def group_runs(runs: Sequence[Path]) -> list[Group]:
    """Runs in groups of one configuration, in the order given; the label says in which settings groups differ."""
    settings = {run: read_settings(run) for run in runs}
    members: dict[str, list[Path]] = {}
    for run, flat in settings.items():
        members.setdefault(json.dumps(flat) if flat else str(run), []).append(run)
    heads = [settings[group[0]] for group in members.values()]
    differ = {name for head in heads for name in head if any(head.get(name) != other.get(name) for other in heads)}
    usual = [_usual(head) for head in heads]
    followed = {
        name
        for name in differ - {*CHOICES}
        if all(head.get(name, ...) == own.get(name) for own, head in zip(heads, usual, strict=True))
    }
    names = sorted(differ - followed)
    return [
        Group(_label(group, head, names), tuple(group)) for group, head in zip(members.values(), heads, strict=True)
    ]


def _label(runs: Sequence[Path], settings: Mapping[str, Any], names: Sequence[str]) -> str:
    """What a group is called that differs from the others in the settings `names`."""
    label = runs[0].name
    if settings and 0 < len(names) <= MOST_DIFFERENCES:
        label = ", ".join(f"{name.replace('_', ' ')} {settings.get(name)}" for name in names)
    elif settings and len(runs) > 1 and not names:
        label = f"{settings.get('task')} task"
    return f"{label}, {len(runs)} seeds" if len(runs) > 1 else label


def _usual(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that those of `CHOICES` bring with them; none where one of these is missing."""
    if not settings.keys() >= {*CHOICES}:
        return {}
    import_remembered(tuple(settings.get("imports", ())))
    usual = to_json(preset(**{choice: settings[choice] for choice in CHOICES}))
    return flatten(json.loads(json.dumps(usual)))  # with lists, as in a file


def read_settings(run: Path) -> dict[str, Any]:
    """Every setting of a run but its seed, by name; empty without a configuration.

    Raises:
        InputError: there is no such folder, it is that of a sweep, or its configuration cannot be read.
    """
    directory = RunDirectory(run)
    directory.check_there()
    refuse_sweep(directory)
    flat = flatten(directory.read_settings())
    flat.pop("seed", None)
    return flat


# --- learning -------------------------------------------------------------------------------------


def read_rows(run: Path) -> list[dict[str, Any]]:
    """Rows of a run's metrics, one an iteration.

    Raises:
        InputError: there are none, or they are not those of a training.
    """
    directory = RunDirectory(run)
    rows = directory.read_metrics()
    for row in rows:
        for name in ("steps", "wall_s", "episodes", *POOLED):
            if not isinstance(row.get(name), int | float):
                raise InputError(
                    f"a row of '{directory.metrics_file}' has no number {name!r}: it is not one of a training."
                )
    return rows


def pooled(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, float]]:
    """Rows joined until each stands for at least `POOL` episodes; a rest at the end that is smaller is left out."""
    points, episodes, sums = [], 0.0, dict.fromkeys(POOLED, 0.0)
    for row in rows:
        episodes += row["episodes"]
        sums = {name: total + row[name] * row["episodes"] for name, total in sums.items()}
        if episodes >= POOL:
            means = {name: total / episodes for name, total in sums.items()}
            points.append({"steps": row["steps"], "wall_s": row["wall_s"], **means})
            episodes, sums = 0.0, dict.fromkeys(POOLED, 0.0)
    return points


def band(curves: Sequence[Sequence[Mapping[str, float]]], x: str, y: str, most: float = math.inf) -> Band:
    """Mean of curves and its 95 % interval by Student's distribution, within 0 and `most`.

    Curves are joined by straight lines and begin where all have begun; one that stopped early keeps its last value.
    """
    points = [(np.array([p[x] for p in curve]), np.array([p[y] for p in curve])) for curve in curves if curve]
    if not points:
        return Band(np.zeros(0), np.zeros(0), None, None)
    grid = np.unique(np.concatenate([at for at, _ in points]))
    grid = grid[grid >= max(at[0] for at, _ in points)]
    values = np.stack([np.interp(grid, at, value) for at, value in points])
    mean, count = values.mean(axis=0), len(values)
    if count == 1:
        return Band(grid, mean, None, None)
    half = student_half_width(values)
    return Band(grid, mean, np.maximum(mean - half, 0), np.minimum(mean + half, most))


# --- evaluations ----------------------------------------------------------------------------------


def read_evaluations(group: Group) -> list[Evaluation]:
    """Evaluations of a group's runs whose episodes were kept; the trained agent in the runs' own simulator first.

    Raises:
        InputError: a report is damaged.
    """
    own = read_settings(group.runs[0]).get("sim")
    parts: dict[tuple[str, str, str], list[dict[str, np.ndarray]]] = {}
    for run in group.runs:
        for report, episodes in RunDirectory(run).read_reports():
            if not ({"sim", "agent"} <= report.keys() and {*FIELDS} <= episodes.keys()):
                raise InputError(
                    f"a report in '{RunDirectory(run).reports}' is damaged: evaluate again with `reachlab eval`."
                )
            varied = report.get("randomised") or []
            condition = f" ({' and '.join(varied)} randomised)" if varied else ""
            parts.setdefault((report["sim"], report["agent"], condition), []).append(episodes)
    order = sorted(parts, key=lambda names: (names[1] != "trained", names[2], names[0] != own, names))
    return [_join(*names, parts[names]) for names in order]


def _join(sim: str, agent: str, condition: str, parts: Sequence[dict[str, np.ndarray]]) -> Evaluation:
    goal, distance, success = (np.concatenate([part[name] for part in parts]) for name in FIELDS)
    return Evaluation(sim, agent, condition, goal, 1000 * distance, success)
