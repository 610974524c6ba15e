"""Suites `arms` and `arms_precise`: every robot of the catalogue learns both tasks and is judged on fresh targets."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from reachlab.bench.table import Row, row
from reachlab.bench.timing import run_command
from reachlab.evaluation.report import FRESH_SEED
from reachlab.robots.catalogue import ROBOTS

SEEDS, HELD_OUT = range(int(os.environ.get("SEEDS", "5"))), 2000
"""Trainings of each robot, and held-out targets of each: seed s has those of seed `FRESH_SEED` + s."""

FLAGS = ("--gripper", os.environ["GRIPPER"]) if "GRIPPER" in os.environ else ()
"""Flags of all trainings: with a gripper, where one is named."""

TRANSFERS, TRANSFERRED = range(3), 1000
"""Trainings whose policies are tried in the other simulators, and held-out targets of each."""

LIMITS = ("10", "5", "2", "1")
"""Held errors that are counted [mm]."""


def arms() -> Iterator[Row]:
    """The tutorial's task: success in three simulators, and the time of the whole command, robot by robot."""
    with tempfile.TemporaryDirectory() as folder:
        for robot in ROBOTS:
            yield from tutorial(robot, Path(folder) / robot, flags=FLAGS)


def tutorial(robot: str, folder: Path, seeds: Sequence[int] = SEEDS, flags: Sequence[str] = ()) -> Iterator[Row]:
    """Rows of a robot, by its name or its file, that learns the tutorial's task in a folder.

    A first training, which is not counted, fills the compilation cache.
    """
    run_command("train", "--robot", robot, "--total-steps", "8192", *flags, "--out", str(folder / "compiled"))
    name = Path(robot).stem
    for seed in seeds:
        out = folder / str(seed)
        wall, result = run_command("train", "--robot", robot, "--seed", str(seed), *flags, "--out", str(out))
        yield row(f"time of tutorial/{name}", wall, "s", seed=seed, steps=result["steps"])
        yield _success(name, out, "kinematic", seed, HELD_OUT)
        if seed in TRANSFERS:
            for sim in ("mujoco", "pybullet"):
                yield _success(name, out, sim, seed, TRANSFERRED)


def _success(name: str, out: Path, sim: str, seed: int, episodes: int) -> Row:
    asked = ("--sim", sim, "--episodes", str(episodes), "--seed", str(FRESH_SEED + seed))
    _, report = run_command("eval", str(out), *asked)
    return row(f"success, tutorial in {sim}/{name}", report["success_rate"], "rate", seed=seed, held_out=episodes)


def arms_precise() -> Iterator[Row]:
    """The precise task on arms whose dynamics vary, beside inverse kinematics on the same targets."""
    with tempfile.TemporaryDirectory() as folder:
        for robot in ROBOTS:
            yield from precise(robot, Path(folder) / robot, flags=FLAGS)


def precise(robot: str, folder: Path, seeds: Sequence[int] = SEEDS, flags: Sequence[str] = ()) -> Iterator[Row]:
    """Rows of a robot, by its name or its file, that learns the precise task in a folder."""
    name = Path(robot).stem
    for seed in seeds:
        out = folder / f"precise-{seed}"
        learn = ("train", "--task", "precise", "--robot", robot, "--seed", str(seed), *flags)
        wall, result = run_command(*learn, "--out", str(out))
        yield row(f"time of precise/{name}", wall, "s", seed=seed, steps=result["steps"])
        asked = ("--randomise", "dynamics", "--episodes", str(HELD_OUT), "--seed", str(FRESH_SEED + seed))
        _, reports = run_command("eval", str(out), "--agent", "trained", "ik", *asked)
        for report in reports:
            yield from _held(name, report, seed)


def _held(name: str, report: dict[str, Any], seed: int) -> Iterator[Row]:
    agent, shares = report["agent"], report["success_within"]
    for limit in LIMITS:
        yield row(f"held within {limit} mm, {agent}/{name}", shares[limit], "rate", seed=seed, held_out=HELD_OUT)
    for quantile in ("median", "p99"):
        if (error := report["final_error_mm"][quantile]) is not None:
            yield row(f"held error, {quantile}, {agent}/{name}", error, "mm", seed=seed)
