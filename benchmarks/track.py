"""Suite `track`: policies that follow a goal beside inverse kinematics that know its velocity."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.trained import PERTURBED, motion_rows, reports, train_seeds, training_rows
from reachlab.bench.table import Row, row
from reachlab.envs.presets import configure
from reachlab.evaluation.report import Report
from reachlab.settings.json_form import override
from reachlab.tasks.paths import PATHS

ROBOTS, SPEED = ("iiwa14", "ur5e"), 0.2
"""Arms that are trained, and the speed of the goals on which they are judged [m/s]."""


def track() -> Iterator[Row]:
    """The rows of suite `track`: measurement, path/robot agent, over all seeds."""
    for robot in ROBOTS:
        config = configure("track", robot=robot)
        with tempfile.TemporaryDirectory() as folder:
            results = train_seeds(config, Path(folder))
        yield from training_rows(f"{robot} trained", results)
        agents = {"trained": [one.policy for one in results], "ik": [None] * len(results)}
        for path in PATHS:
            for randomise in ((), ("dynamics",)):
                judged = override(config, goal_paths=(path,), goal_speed=(SPEED, SPEED), randomise=randomise)
                for agent, policies in agents.items():
                    together, _ = reports(judged, agent, policies)
                    yield from _accuracy(path, f"{robot} {agent}{PERTURBED * bool(randomise)}", together)


def _accuracy(path: str, column: str, report: Report) -> Iterator[Row]:
    followed = report.tracking or {}
    for name in ("rms", "median", "p95"):
        yield row(f"{path}: error, {name}/{column}", followed[f"{name}_mm"], "mm", episodes=report.episodes)
    if followed["lag_s"] is not None:
        yield row(f"{path}: lag/{column}", 1000 * followed["lag_s"], "ms")
    for limit, times in followed["again_within"].items():
        for name, seconds in times.items():
            yield row(f"{path}: within {limit} mm again, {name}/{column}", seconds, "s", times=followed["breaks"])
    for one in motion_rows(column, report):
        yield {**one, "name": f"{path}: {one['name']}"}
