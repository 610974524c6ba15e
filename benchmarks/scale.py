"""Suite `scale`: rollouts by Ray workers and trials of sweeps, measured here, and what more workers would come to."""

from __future__ import annotations

import itertools
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax

from reachlab.agents.policy import Policy
from reachlab.bench.table import Row, row
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.learn.loop import Progress
from reachlab.learn.rollout import Rollout
from reachlab.learn.train import train
from reachlab.scale.rollouts import RayRollouts
from reachlab.scale.sweep import sweep
from reachlab.scale.trials import SweepConfig

ITERATIONS, WORKERS = 25, (1, 2)
"""Iterations of a training, of which the first is not counted, and numbers of workers that are tried here."""

PREDICTED = (1, 2, 4, 8, 16, 32, 64, 128, 256)
"""Numbers of workers that are calculated, each with as many environments as one of the two has here."""

HOUR = 3600
"""Seconds."""

TRIALS, TRIAL_STEPS = 8, 500_000
"""Trials of a sweep, and environment steps of each."""


def scale() -> Iterator[Row]:
    """The rows of suite `scale`: measurement/way."""
    alone = _training(0)
    yield row("train_steps_per_second/in process", alone.rate, "1/s", iterations=ITERATIONS)
    measured = {workers: _training(workers) for workers in WORKERS}
    for workers, one in measured.items():
        name = _named(workers)
        yield row(f"train_steps_per_second/{name}", one.rate, "1/s", share_of_alone=one.rate / alone.rate)
        yield row(f"share of the time that workers compute/{name}", one.busy_s / one.iteration_s, "rate")
        yield row(f"share of the time that the learner computes/{name}", one.learning_s / one.iteration_s, "rate")
        yield row(f"messages of an iteration, to workers/{name}", one.sent_bytes / 1e6, "MB")
        yield row(f"messages of an iteration, from workers/{name}", one.received_bytes / 1e6, "MB")
        yield row(f"messages of an iteration, time/{name}", 1000 * one.message_s, "ms")
        yield row(f"time to the first iteration/{name}", one.start_s, "s")
    two = measured[2]
    for workers in PREDICTED:
        more = workers / 2
        iteration_s = two.busy_s + more * (two.learning_s + two.message_s)
        yield row(
            f"predicted train_steps_per_second/{_named(workers)}",
            more * two.rate * two.iteration_s / iteration_s,
            "1/s",
        )
    yield from _trials()


def _named(workers: int) -> str:
    return f"{workers} worker{'s'[: workers > 1]}"


class _Calls:
    """Calls of what collects, with their time [s], and the bytes of an iteration that go to workers and come back."""

    def __init__(self, collect: RayRollouts, workers: int) -> None:
        self._collect, self._workers = collect, workers
        self.count, self.wall_s, self.before_s = 0, 0.0, 0.0
        self.sent_bytes, self.received_bytes = 0, 0

    def __call__(self, env: Env, policy: Policy, state: EnvState, *more: Any) -> tuple[EnvState, Rollout]:
        begun = time.perf_counter()
        collected = self._collect(env, policy, state, *more)
        self.wall_s += time.perf_counter() - begun
        self.count += 1
        self.sent_bytes, self.received_bytes = self._workers * _size(policy) + _size(state), _size(collected)
        return collected

    def restart(self) -> None:
        """Count from now on."""
        self.count, self.wall_s, self.before_s = 0, 0.0, self._collect.busy_s

    @property
    def busy_s(self) -> float:
        """Time of the worker that took longest in a call [s]."""
        return (self._collect.busy_s - self.before_s) / self.count


def _size(tree: object) -> int:
    """Bytes of a tree's arrays."""
    return sum(leaf.nbytes for leaf in jax.tree.leaves(tree))


class _Measured:
    """Medians over iterations of a training, times in seconds."""

    def __init__(self, steps: int, start_s: float, times: list[float], calls: _Calls | None) -> None:
        self.start_s, self.iteration_s = start_s, statistics.median(times)
        self.rate = steps / self.iteration_s
        if calls:
            rollouts_s = calls.wall_s / calls.count
            self.busy_s = calls.busy_s
            self.message_s, self.learning_s = rollouts_s - self.busy_s, statistics.fmean(times) - rollouts_s
            self.sent_bytes, self.received_bytes = calls.sent_bytes, calls.received_bytes


def _training(workers: int) -> _Measured:
    """A short training of `precise`; with 0 workers in this process, on all cores."""
    settings = configure("precise").loop
    config = configure("precise", total_steps=ITERATIONS * settings.iteration_steps, report_episodes=settings.num_envs)
    begun, ticks, calls = time.perf_counter(), list[float](), None
    with tempfile.TemporaryDirectory() as folder:
        if not workers:
            train(config, Path(folder) / "run", lambda _: ticks.append(time.perf_counter()))
        else:
            with RayRollouts(config, workers) as collect:
                calls = _Calls(collect, workers)

                def watch(_: Progress) -> None:
                    ticks.append(time.perf_counter())
                    if len(ticks) == 1:
                        calls.restart()

                train(config, Path(folder) / "run", watch, collect=calls)
    times = [after - before for before, after in itertools.pairwise(ticks)]
    return _Measured(settings.iteration_steps, ticks[0] - begun, times, calls)


def _trials() -> Iterator[Row]:
    """How many trials of a sweep are done in an hour, by one process and by two, of one thread each."""
    space = {"learning_rate": {"low": 3e-4, "high": 3e-3, "log": True}}
    config = configure(total_steps=TRIAL_STEPS, stop_early=False)
    rates = {}
    for workers, trials in ((1, 1), *((workers, TRIALS) for workers in WORKERS)):  # once for what is compiled
        with tempfile.TemporaryDirectory() as folder:
            begun = time.perf_counter()
            sweep(config, SweepConfig(space, validations=0, trials=trials), Path(folder) / "sweep", workers=workers)
            rates[workers] = HOUR * trials / (time.perf_counter() - begun)
    for workers, rate in rates.items():
        yield row(
            f"trials of a sweep an hour/{_named(workers)}", rate, "1/h", of_one=rate / rates[1], steps=TRIAL_STEPS
        )
