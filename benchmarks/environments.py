"""Suite `environments`: steps a second through Gymnasium's environments, random actions and resets included."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv

from benchmarks.simulators import ACTIONS, ENVIRONMENT, Author, bare_engine, sampled_actions, single_steps
from reachlab.bench.table import Row, machine, row
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.robots.loading import load_robot

BATCHES = (16, 256, 4096)
"""Environments of a batch."""

EPISODE = 1000
"""Steps after which an episode ends at the latest, and that are timed: as many episodes end as begin."""

ROUNDS = 3
"""Timings, of which the best counts, since other work on the machine comes and goes."""

DYNAMIC_ENVS, DYNAMIC_STEPS = 256, 101
"""Environments under full dynamics, and steps of an episode with the one that begins it."""


def environments() -> Iterator[Row]:
    """The rows of suite `environments`."""
    author, ours = author_steps(), single_steps(EPISODE)
    rates = [(author(), ours()) for _ in range(ROUNDS)]
    slow, fast = (max(column) for column in zip(*rates, strict=True))
    yield row("gym_steps_per_second/author's", slow, "1/s", simulator="PyBullet")
    yield row("gym_steps_per_second/1", fast, "1/s", machine=machine(), ratio=round(fast / slow, 1))
    for num_envs in BATCHES:
        measure = batch_steps(gymnasium.make_vec(ENVIRONMENT, num_envs=num_envs), EPISODE)
        yield row(f"gym_steps_per_second/{num_envs}", max(measure() for _ in range(ROUNDS)), "1/s")
    precise = single_steps(EPISODE, task="precise")
    yield row("gym_steps_per_second/precise 1", max(precise() for _ in range(ROUNDS)), "1/s")
    yield dynamics_steps("precise")
    yield from (dynamics_steps(task, robot="panda") for task in ("push", "lift"))


def batch_steps(env: VectorEnv[Any, Any, Any], steps: int) -> Callable[[], float]:
    """Measures the steps a second of a batch, over so many steps of each environment."""
    actions = sampled_actions(env.action_space)
    env.reset(seed=0)

    def measure() -> float:
        start = time.perf_counter()
        for number in range(steps):
            env.step(actions[number % ACTIONS])
        return env.num_envs * steps / (time.perf_counter() - start)

    measure()
    return measure


def dynamics_steps(task: str, **settings: Any) -> Row:
    """Steps a second of a task under full dynamics, and their share of the engine's alone, given the same commands.

    Both are timed in turns, since other work on the machine comes and goes; the best of each counts.
    """
    batch = gymnasium.make_vec(ENVIRONMENT, num_envs=DYNAMIC_ENVS, task=task, **settings)
    actions = sampled_actions(batch.action_space)
    env = Env(configure(task, randomise=(), **settings), DYNAMIC_ENVS)
    bare = bare_engine(env, [actions[number % ACTIONS] for number in range(DYNAMIC_STEPS)])
    measure = batch_steps(batch, DYNAMIC_STEPS)
    rates = [(bare(), measure()) for _ in range(ROUNDS * ROUNDS)]
    engine, through = (max(column) for column in zip(*rates, strict=True))
    share = round(through / engine, 3)
    return row(f"gym_steps_per_second/{task} {DYNAMIC_ENVS}", through, "1/s", share_of_bare=share)


def author_steps() -> Callable[[], float]:
    """Measures the steps a second of the tutorial's environment, which rebuilds its world at every reset."""
    author, actions = Author(load_robot("iiwa14")), np.random.default_rng(0).uniform(-0.4, 0.3, (EPISODE, 3))

    def measure() -> float:
        start = time.perf_counter()
        author.rebuild()
        for action in actions:
            author.step(action)
        return EPISODE / (time.perf_counter() - start)

    return measure
