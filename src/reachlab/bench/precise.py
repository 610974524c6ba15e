"""Suite `precise`: trained policies beside inverse kinematics under full dynamics, on nominal and perturbed arms."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from reachlab.agents.policy import Policy
from reachlab.bench.bound import EPISODES, least_time
from reachlab.bench.table import Row, row
from reachlab.envs.core import Env
from reachlab.evaluation.episodes import BATCH, Episodes, make_runner
from reachlab.evaluation.report import FRESH_SEED, Report, examine, summarise
from reachlab.learn.train import TrainResult, train
from reachlab.robots.loading import load_robot
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.presets import configure

SEEDS, HELD_OUT = range(5), 2000
"""Trainings, and held-out targets of each: seed s has those of seed `FRESH_SEED` + s."""

POLICIES: dict[str, dict[str, Any]] = {"trained": {}, "trained without ik": {"action": "joint_delta"}}
"""Policies that are compared, by the name of their column, and what they change of the preset."""

BASELINES = ("ik", "ik_open")
"""Agents that they are compared with, on the same targets."""

PERTURBED = ", perturbed"
"""What the name of a column ends in where every episode has an arm of its own."""


def precise() -> Iterator[Row]:
    """The rows of suite `precise`: measurement/agent, over all seeds, with the lowest or highest seed beside it."""
    configs = {name: configure("precise", **settings) for name, settings in POLICIES.items()}
    with tempfile.TemporaryDirectory() as folder:
        trained = {
            name: [train(override(config, seed=seed), Path(folder) / name / str(seed)) for seed in SEEDS]
            for name, config in configs.items()
        }
    for name, results in trained.items():
        yield from _training(name, results)
    for randomise in ((), ("dynamics",)):
        for name, config in configs.items():
            reports = _reports(override(config, randomise=randomise), "trained", [one.policy for one in trained[name]])
            yield from _accuracy(name + PERTURBED * bool(randomise), reports)
        for agent in BASELINES:
            reports = _reports(override(configs["trained"], randomise=randomise), agent, [None for _ in SEEDS])
            yield from _accuracy(agent + PERTURBED * bool(randomise), reports)
    bound = least_time(configs["trained"], FRESH_SEED)
    yield row("time to reach 10 mm for good/no controller below", bound, "s", episodes=EPISODES)


def _training(name: str, trained: list[TrainResult]) -> Iterator[Row]:
    walls, speeds = [one.train_wall_s for one in trained], [one.steps_per_second for one in trained]
    yield row(f"training time, longest of the seeds/{name}", max(walls), "s", by_seed=walls, steps=trained[0].steps)
    yield row(f"training speed, slowest of the seeds/{name}", min(speeds), "1/s", by_seed=speeds)


def _reports(config: RunConfig, agent: str, policies: Sequence[Policy | None]) -> tuple[Report, list[Report]]:
    """Report of an agent on the targets of all seeds together, and the reports of the seeds."""
    env = Env(config, BATCH)
    runner = make_runner(env, agent)
    results = [
        examine(env, agent, policy, seed=FRESH_SEED + seed, episodes=HELD_OUT, runner=runner)
        for seed, policy in zip(SEEDS, policies, strict=True)
    ]
    env.close()
    together: Episodes = jax.tree.map(lambda *x: np.concatenate(x), *(episodes for _, episodes in results))
    wall = sum(report.wall_s for report, _ in results)
    return summarise(env, agent, together, FRESH_SEED, wall), [report for report, _ in results]


def _accuracy(column: str, reports: tuple[Report, list[Report]]) -> Iterator[Row]:
    together, seeds = reports
    limits = np.array(load_robot(together.robot).speed)
    for limit, share in _within(together).items():
        # Baselines have no seeds of their own.
        lowest = {"lowest_seed": min(_within(report)[limit] for report in seeds)} if together.agent == "trained" else {}
        yield row(f"held within {limit} mm/{column}", share, "rate", episodes=together.episodes, **lowest)
    for name, error in together.final_error_mm.items():
        if error is not None:
            yield row(f"held error, {name}/{column}", error, "mm")
    if together.time_to_reach_s is not None:
        yield row(f"time to reach 10 mm for good/{column}", together.time_to_reach_s, "s")
    share = float((np.array(together.max_joint_speed) / limits).max())
    yield row(f"peak joint speed, share of its limit/{column}", share, "rate", joints=together.max_joint_speed)
    yield row(f"mean squared joint jerk/{column}", together.jerk, "rad²/s⁶")


def _within(report: Report) -> Mapping[str, float]:
    return report.success_within or {}
