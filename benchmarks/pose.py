"""Suite `pose`: policies that hold poses beside inverse kinematics, on nominal and perturbed arms."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.trained import PERTURBED, motion_rows, reports, train_seeds, training_rows
from reachlab.bench.table import Row, row
from reachlab.envs.presets import configure
from reachlab.evaluation.report import Report
from reachlab.robots.loading import load_robot
from reachlab.settings.json_form import override

ROBOTS = ("iiwa14", "ur5e")
"""Arms that are trained."""

HALF = np.array([0.25, 0.125, 0.1])
"""Half sides of the box of Isaac Lab's reach task for the UR10e, about the middle of the arm's own [m]. The turns are
that task's in the preset already."""


def pose() -> Iterator[Row]:
    """The rows of suite `pose`: measurement/robot goals agent, over all seeds, the lowest seed beside it."""
    for robot in ROBOTS:
        low, high = np.array(load_robot(robot, kind="flange").goal_box)
        middle = (low + high) / 2
        box = {"target_low": tuple((middle - HALF).tolist()), "target_high": tuple((middle + HALF).tolist())}
        for goals, settings in (("box", box), ("any", {"targets": "any"})):
            yield from _trained(robot, f"{robot} {goals}", settings)


def _trained(robot: str, name: str, settings: dict[str, Any]) -> Iterator[Row]:
    config = configure("pose", robot=robot, **settings)
    with tempfile.TemporaryDirectory() as folder:
        results = train_seeds(config, Path(folder))
    yield from training_rows(f"{name} trained", results)
    agents = {"trained": [one.policy for one in results], "ik": [None] * len(results)}
    for randomise in ((), ("dynamics",)):
        for agent, policies in agents.items():
            reported = reports(override(config, randomise=randomise), agent, policies)
            yield from _accuracy(f"{name} {agent}{PERTURBED * bool(randomise)}", *reported)


def _accuracy(column: str, together: Report, seeds: list[Report]) -> Iterator[Row]:
    for limits, share in (together.success_within_pairs or {}).items():
        lowest = min((report.success_within_pairs or {})[limits] for report in seeds)
        yield row(f"held within {limits}/{column}", share, "rate", episodes=together.episodes, lowest_seed=lowest)
    for name, error in together.final_error_mm.items():
        if error is not None:
            yield row(f"held error, {name}/{column}", error, "mm")
    for name, angle in (together.final_angle_rad or {}).items():
        if angle is not None:
            yield row(f"held angle, {name}/{column}", 1000 * angle, "mrad")
    if together.time_to_reach_s is not None:
        yield row(f"time to reach 10 mm and 0.05 rad for good/{column}", together.time_to_reach_s, "s")
    yield from motion_rows(column, together)
