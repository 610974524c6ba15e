"""Trainings of several seeds, and the reports of their policies on fresh targets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import numpy as np

from reachlab.agents.policy import Policy
from reachlab.bench.table import Row, row
from reachlab.envs.core import Env
from reachlab.evaluation.episodes import BATCH, Episodes, make_runner
from reachlab.evaluation.report import FRESH_SEED, Report, examine, summarise
from reachlab.learn.train import TrainResult, train
from reachlab.robots.loading import load_robot
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override

SEEDS, HELD_OUT = range(5), 2000
"""Trainings, and held-out targets of each: seed s has those of seed `FRESH_SEED` + s."""

PERTURBED = ", perturbed"
"""What the name of a column ends in where every episode has an arm of its own."""


def train_seeds(config: RunConfig, folder: Path) -> list[TrainResult]:
    """Trainings of a configuration, one a seed."""
    return [train(override(config, seed=seed), folder / str(seed)) for seed in SEEDS]


def training_rows(name: str, trained: list[TrainResult]) -> Iterator[Row]:
    """How long trainings took."""
    walls, speeds = [one.train_wall_s for one in trained], [one.steps_per_second for one in trained]
    yield row(f"training time, longest of the seeds/{name}", max(walls), "s", by_seed=walls, steps=trained[0].steps)
    yield row(f"training speed, slowest of the seeds/{name}", min(speeds), "1/s", by_seed=speeds)


def reports(config: RunConfig, agent: str, policies: Sequence[Policy | None]) -> tuple[Report, list[Report]]:
    """Report of an agent on the targets of all seeds together, and the reports of the seeds."""
    env = Env(config, BATCH)
    runner = make_runner(env, agent)
    results = [
        examine(env, agent, policy, seed=FRESH_SEED + seed, episodes=HELD_OUT, runner=runner)
        for seed, policy in enumerate(policies)
    ]
    env.close()
    together: Episodes = jax.tree.map(lambda *x: np.concatenate(x), *(episodes for _, episodes in results))
    wall = sum(report.wall_s for report, _ in results)
    return summarise(env, agent, together, FRESH_SEED, wall), [report for report, _ in results]


def motion_rows(column: str, report: Report) -> Iterator[Row]:
    """How fast the joints were, how they jerked, and whether links met or anything was touched."""
    share = float((np.array(report.max_joint_speed) / np.array(load_robot(report.robot).speed)).max())
    yield row(f"peak joint speed, share of its limit/{column}", share, "rate", joints=report.max_joint_speed)
    yield row(f"mean squared joint jerk/{column}", report.jerk, "rad²/s⁶")
    if report.self_contact is not None:
        yield row(f"episodes in which links met/{column}", report.self_contact, "rate", episodes=report.episodes)
    if report.contact is not None:
        yield row(f"episodes that ended by contact/{column}", report.contact, "rate", episodes=report.episodes)
