"""Suite `learners`: steps a second of Stable-Baselines3's PPO on our batch, and on its own vector of environments."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

from reachlab.bench.table import Row, machine, row
from reachlab.settings.validation import InputError, installing

ENVIRONMENT, NUM_ENVS = "reachlab/Reach-v0", 64
SETTINGS: dict[str, Any] = {"observation": "target+tool", "reward": "dense"}

HYPERPARAMETERS: dict[str, Any] = {
    "n_steps": 64,
    "batch_size": 1024,
    "n_epochs": 4,
    "learning_rate": 2e-3,
    "gamma": 0.98,
    "gae_lambda": 0.9,
    "policy_kwargs": {"log_std_init": math.log(0.2)},
}
"""Those of `examples/sb3_ppo.py`."""

STEPS = 4 * NUM_ENVS * HYPERPARAMETERS["n_steps"]
"""Environment steps that are timed: four rollouts, and what is learnt from them."""

ROUNDS = 3
"""Timings of each, taken in turns, of which the best counts, since other work on the machine comes and goes."""


def learners() -> Iterator[Row]:
    """The rows of suite `learners`.

    Raises:
        InputError: Stable-Baselines3 is not installed.
    """
    try:
        from stable_baselines3.common.env_util import make_vec_env

        from reachlab.envs.sb3_vector import ReachVecEnv
    except ModuleNotFoundError:
        raise InputError(f"suite 'learners' needs Stable-Baselines3: {installing('sb3')}.") from None
    theirs = learning_steps(make_vec_env(ENVIRONMENT, NUM_ENVS, env_kwargs=SETTINGS))
    ours = learning_steps(ReachVecEnv(ENVIRONMENT, NUM_ENVS, **SETTINGS))
    rates = [(theirs(), ours()) for _ in range(ROUNDS)]
    slow, fast = (max(column) for column in zip(*rates, strict=True))
    yield row("sb3_ppo_steps_per_second/DummyVecEnv", slow, "1/s", num_envs=NUM_ENVS, machine=machine())
    yield row("sb3_ppo_steps_per_second/ReachVecEnv", fast, "1/s", num_envs=NUM_ENVS, ratio=round(fast / slow, 1))


def learning_steps(env: Any) -> Callable[[], float]:
    """Measures the steps a second of `learn`, rollouts and gradient steps included."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    torch.set_num_threads(1)  # the networks are small
    model = PPO("MlpPolicy", VecNormalize(env, norm_reward=False), **HYPERPARAMETERS, seed=0, device="cpu")
    model.learn(NUM_ENVS)

    def measure() -> float:
        start = time.perf_counter()
        model.learn(STEPS, reset_num_timesteps=False)
        return STEPS / (time.perf_counter() - start)

    return measure
