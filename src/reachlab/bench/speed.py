"""Suite `speed`: environment and training steps a second."""

from __future__ import annotations

import time
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.bench.table import Row, machine, row
from reachlab.bench.timing import shortest_time
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.jax_setup import jit
from reachlab.learn.ppo_method import compile_iteration, initial_state

ENV_BATCHES = (256, 1024, 4096, 16384)
"""Batch sizes among which the best is looked for."""

ENV_STEPS = 64
"""Steps of every environment in one timed call."""

TRAIN_ITERATIONS = 40
"""Iterations of training that are timed; the median counts."""


def speed() -> Iterator[Row]:
    """Environment and training steps a second."""
    rows = [(_env_steps_per_second(num_envs), num_envs) for num_envs in ENV_BATCHES]
    best, num_envs = max(rows)
    yield row("env_steps_per_second/kinematic", best, "1/s", num_envs=num_envs, machine=machine())
    config = configure()
    env = Env(config, config.loop.num_envs)
    state = jit(lambda seed: initial_state(env, config, seed))(config.seed)
    step = compile_iteration(env, config, state)
    times = []
    for _ in range(TRAIN_ITERATIONS):
        start = time.perf_counter()
        state, watched = step(state)
        jax.block_until_ready(watched)
        times.append(time.perf_counter() - start)
    steps_per_second = config.loop.iteration_steps / float(np.median(times))
    yield row("train_steps_per_second/kinematic", steps_per_second, "1/s", num_envs=config.loop.num_envs)


def _env_steps_per_second(num_envs: int) -> float:
    """Random actions in the tutorial's task with resets; sums of every output come back, so none is skipped."""
    env = Env(configure(), num_envs)
    low, high = env.action_bounds

    def step(state: EnvState, key: Array) -> tuple[EnvState, Array]:
        action = jax.random.uniform(key, (num_envs, len(low)), minval=low, maxval=high)
        state, transition = env.step(state, action)
        begun = env.reset(state, transition.done)
        return begun, jnp.stack([jnp.sum(x) for x in jax.tree.leaves((transition, env.observe(begun)))])

    run = jit(lambda state, key: jax.lax.scan(step, state, jax.random.split(key, ENV_STEPS)))
    state = jit(env.init)(env_keys(0, num_envs))
    return num_envs * ENV_STEPS / shortest_time(lambda: run(state, jax.random.key(0)))
