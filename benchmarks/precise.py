"""Suite `precise`: trained policies beside inverse kinematics under full dynamics, on nominal and perturbed arms."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.bound import EPISODES, least_time
from benchmarks.trained import PERTURBED, motion_rows, reports, train_seeds, training_rows
from reachlab.bench.table import Row, row
from reachlab.envs.presets import configure
from reachlab.evaluation.report import FRESH_SEED, Report
from reachlab.settings.json_form import override

POLICIES: dict[str, dict[str, Any]] = {"trained": {}, "trained without ik": {"action": "joint_delta"}}
"""Policies that are compared, by the name of their column, and what they change of the preset."""

BASELINES = ("ik", "ik_open")
"""Agents that they are compared with, on the same targets."""


def precise() -> Iterator[Row]:
    """The rows of suite `precise`: measurement/agent, over all seeds, with the lowest or highest seed beside it."""
    configs = {name: configure("precise", **settings) for name, settings in POLICIES.items()}
    with tempfile.TemporaryDirectory() as folder:
        trained = {name: train_seeds(config, Path(folder) / name) for name, config in configs.items()}
    for name, results in trained.items():
        yield from training_rows(name, results)
    for randomise in ((), ("dynamics",)):
        for name, config in configs.items():
            policies = [one.policy for one in trained[name]]
            reported = reports(override(config, randomise=randomise), "trained", policies)
            yield from _accuracy(name + PERTURBED * bool(randomise), reported)
        for agent in BASELINES:
            reported = reports(
                override(configs["trained"], randomise=randomise), agent, [None] * len(trained["trained"])
            )
            yield from _accuracy(agent + PERTURBED * bool(randomise), reported)
    bound = least_time(configs["trained"], FRESH_SEED)
    yield row("time to reach 10 mm for good/no controller below", bound, "s", episodes=EPISODES)


def _accuracy(column: str, reported: tuple[Report, list[Report]]) -> Iterator[Row]:
    together, seeds = reported
    for limit, share in _within(together).items():
        # Baselines have no seeds of their own.
        lowest = {"lowest_seed": min(_within(report)[limit] for report in seeds)} if together.agent == "trained" else {}
        yield row(f"held within {limit} mm/{column}", share, "rate", episodes=together.episodes, **lowest)
    for name, error in together.final_error_mm.items():
        if error is not None:
            yield row(f"held error, {name}/{column}", error, "mm")
    if together.time_to_reach_s is not None:
        yield row(f"time to reach 10 mm for good/{column}", together.time_to_reach_s, "s")
    yield from motion_rows(column, together)


def _within(report: Report) -> Mapping[str, float]:
    return report.success_within or {}
