"""Suite `clutter`: policies among obstacles beside inverse kinematics with dampers, and beside a sampling planner."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import jax

from benchmarks.trained import PERTURBED, motion_rows, reports, train_seeds, training_rows
from reachlab.agents.acting import trained
from reachlab.agents.policy import Policy
from reachlab.bench.table import Row, row
from reachlab.bench.timing import shortest_time
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.evaluation.report import FRESH_SEED, Report
from reachlab.jax_setup import jit
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override

ROBOTS = ("iiwa14", "ur5e")
"""Arms that are trained."""


def clutter() -> Iterator[Row]:
    """The rows of suite `clutter`: measurement/robot agent, over all seeds, with the lowest seed of policies."""
    for robot in ROBOTS:
        config = configure("clutter", robot=robot)
        with tempfile.TemporaryDirectory() as folder:
            results = train_seeds(config, Path(folder))
        policies = [one.policy for one in results]
        yield from training_rows(f"{robot} trained", results)
        yield from decision_rows(f"{robot} trained", config, policies[0])
        for randomise in ((), ("dynamics",)):
            varied, ending = override(config, randomise=randomise), PERTURBED * bool(randomise)
            yield from _accuracy(f"{robot} trained{ending}", varied, "trained", policies)
            for agent in ("ik", "planner"):
                yield from _accuracy(f"{robot} {agent}{ending}", varied, agent, [None] * len(policies))
        empty = configure("clutter", robot=robot, obstacles=(0, 0))
        yield from _accuracy(f"{robot} trained, no obstacles", empty, "trained", policies)
        for name, other in (("ik, no obstacles", empty), ("ik of precise", configure("precise", robot=robot))):
            yield from _accuracy(f"{robot} {name}", other, "ik", [None] * len(policies))


def decision_rows(name: str, config: RunConfig, policy: Policy) -> Iterator[Row]:
    """How long a policy takes for one action of one arm, its observation included."""
    env = Env(config, 1)
    state, key = env.init(_keys(1)), jax.random.key(0)
    decide = jit(partial(trained, env))
    yield row(f"time of one decision/{name}", 1000 * shortest_time(lambda: decide(policy, state, key, None)), "ms")
    env.close()


def _keys(count: int) -> jax.Array:
    return episode_keys(FRESH_SEED, REPORT_STREAM, 0, count)


def _accuracy(column: str, config: RunConfig, agent: str, policies: Sequence[Policy | None]) -> Iterator[Row]:
    together, seeds = reports(config, agent, policies)
    lowest = {"lowest_seed": min(map(_held, seeds))} if agent == "trained" else {}
    yield row(f"held within 10 mm/{column}", _held(together), "rate", episodes=together.episodes, **lowest)
    if together.time_to_reach_s is not None:
        yield row(f"time to reach 10 mm for good/{column}", together.time_to_reach_s, "s")
    for quantile, seconds in (together.planning_s or {}).items():
        yield row(f"planning time, {quantile}/{column}", 1000 * (seconds or 0.0), "ms", episodes=together.episodes)
    yield from motion_rows(column, together)


def _held(report: Report) -> float:
    return (report.success_within or {})["10"]
