"""What goes wrong when processes, files, disks and numbers fail, and what saving costs: `make trust` prints it."""

from __future__ import annotations

import logging
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import numpy as np

from faults.c_sources import c_sources
from faults.controllers import controllers
from faults.hostile import hostile_files
from faults.inputs import TRIALS as INPUTS
from faults.recordings import killed_recordings
from faults.saves import Trial, corruptions, cut_saves, failing_saves
from faults.sweeps import killed_sweeps, killed_workers
from faults.trainings import killed_runs, not_finite
from faults.workers import lost_node, shared_weights
from reachlab.bench.table import Row, row
from reachlab.cli.console import print_table
from reachlab.envs.core import Env
from reachlab.envs.presets import configure, in_simulator
from reachlab.jax_setup import use_compilation_cache
from reachlab.learn.ppo_method import initial_state
from reachlab.runs.directory import RunDirectory
from reachlab.settings.config import RunConfig

KILLS, CORRUPTIONS, FAILING_SAVES = 50, 10_000, 20
"""How often each fault is tried."""

MINUTES, INTERVAL, WORKER_TRIALS, WORKER_STEPS = 5, 5.0, 12, 1_000_000
"""Minutes in which a training of a sweep is killed, and the time between two kills [s]; trials, and steps of each."""

SWEEP_KILLS, SWEEP_TRIALS, SWEEP_STEPS = 20, 8, 400_000
"""How often a sweep itself is killed; its trials, and steps of each."""

RECORDING_KILLS = 20
"""How often a recording is killed."""

HOSTILE_STEPS, FAULTS = 1_000_000, 1000
"""Control steps of an exported policy's controller among hostile measurements, and how often each fault is tried."""

DECISIONS = 100_000
"""Steps of an export's C sources that are compared with Python's."""

SAVES = 20
"""Saves that are timed; the median counts."""

TRIALS: dict[str, Callable[[], Trial]] = {
    "killed_runs": lambda: killed_runs(KILLS),
    "cut_saves": cut_saves,
    "corruptions": lambda: corruptions(CORRUPTIONS),
    "failing_saves": lambda: failing_saves(FAILING_SAVES),
    "not_finite": not_finite,
    "hostile_files": hostile_files,
    "killed_workers_local": lambda: killed_workers("local", MINUTES * 60, INTERVAL, WORKER_TRIALS, WORKER_STEPS),
    "killed_workers_ray": lambda: killed_workers("ray", MINUTES * 60, INTERVAL, WORKER_TRIALS, WORKER_STEPS),
    "shared_weights": shared_weights,
    "lost_node": lost_node,
    "killed_sweeps": lambda: killed_sweeps(SWEEP_KILLS, SWEEP_TRIALS, SWEEP_STEPS),
    "killed_recordings": lambda: killed_recordings(RECORDING_KILLS),
    "c_sources_precise": lambda: c_sources("precise", DECISIONS, HOSTILE_STEPS),
    "c_sources_clutter": lambda: c_sources("clutter", DECISIONS // 10, HOSTILE_STEPS),
    **INPUTS,
}


def trust(names: Collection[str]) -> Iterator[Row]:
    """How often each fault went wrong, which is never, and the cost of a save; or only those with these names."""
    for name, try_out in TRIALS.items():
        if names and name not in names:
            continue
        logging.disable(logging.WARNING)  # thousands of damaged checkpoints are warned of
        try:
            trial = try_out()
        finally:
            logging.disable(logging.NOTSET)
        yield _row(name, trial)
    if names:
        return
    for name, trial in controllers(HOSTILE_STEPS, FAULTS).items():
        yield _row(name, trial)
    for sim in ("kinematic", "mujoco"):
        yield from _cost(sim)


def _row(name: str, trial: Trial) -> Row:
    return row(f"trust/{name}_gone_wrong", len(trial.wrong), f"of {trial.tried}", wrong=trial.wrong[:3])


def _cost(sim: str) -> Iterator[Row]:
    """Time of a save, and its share of training at the default interval."""
    config: RunConfig = in_simulator(configure(), sim)
    env = Env(config, config.loop.num_envs)
    state = env.compile_whole(lambda seed: initial_state(env, config, seed))(np.uint32(0))
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        run = RunDirectory(Path(folder) / "run")
        run.create(config)
        times = []
        for step in range(SAVES):
            start = time.perf_counter()
            run.write_checkpoint(step, state)
            times.append(time.perf_counter() - start)
    env.close()
    took, interval = statistics.median(times), config.loop.checkpoint_interval
    yield row(f"trust/save/{sim}", 1000 * took, "ms", num_envs=config.loop.num_envs)
    yield row(f"trust/saving_share/{sim}", took / interval, "of training time", interval=interval, slowest=max(times))


def main() -> None:
    """Print the table."""
    use_compilation_cache()
    cells = [(one["name"], f"{one['value']:.4g}", one["unit"], str(one["config"])) for one in trust(sys.argv[1:])]
    print_table("trust", ("measurement", "value", "unit", "configuration"), cells)


if __name__ == "__main__":
    main()
