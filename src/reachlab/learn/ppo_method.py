"""PPO as a method: an iteration is a rollout and its update, compiled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
from jax import Array

from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.random_streams import LEARNER_STREAM, TRAINING_STREAM, episode_keys, stream_key
from reachlab.jax_setup import jit
from reachlab.learn import ppo
from reachlab.learn.learner import Learner, make_initial_policy, make_learner, make_optimiser
from reachlab.learn.method import Finite, Method, Watched, all_finite
from reachlab.learn.rollout import Collect, Rollout, collect, episode_statistics, host_collector
from reachlab.settings.config import RunConfig
from reachlab.traced import kept


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TrainState:
    """All that training changes: enough to continue from."""

    learner: Learner
    env: EnvState
    key: Array


Metrics = dict[str, Array]
Learn = Callable[[Learner, Rollout, Array], tuple[Learner, Metrics]]
Iteration = Callable[[TrainState], tuple[TrainState, Watched]]


def initial_state(env: Env, config: RunConfig, seed: int | Array, given: Any = None) -> TrainState:
    """State before the first iteration."""
    del given

    def begin(key: Array) -> Learner:
        optimiser = make_optimiser(config, ppo.updates_per_iteration(config.ppo))
        return make_learner(optimiser, make_initial_policy(config, env, key))

    key, for_policy = jax.random.split(stream_key(seed, LEARNER_STREAM))
    episodes = episode_keys(seed, TRAINING_STREAM, 0, config.loop.num_envs)
    return TrainState(env.compile_part(begin)(for_policy), env.init(episodes), key)


def compile_iteration(env: Env, config: RunConfig, shape: TrainState, elsewhere: Collect | None = None) -> Iteration:
    """See `Method.compile_iteration`.

    Where everything is traced it is one program; else the environment steps on the host, between compiled parts.
    """

    def learn(learner: Learner, rollout: Rollout, key: Array) -> tuple[Learner, Metrics]:
        new, metrics = ppo.update(learner, rollout, key, config)
        return new, {**episode_statistics(rollout), **metrics}

    def iterate(gather: Collect, learn: Learn, state: TrainState) -> tuple[TrainState, Metrics, Rollout]:
        key, for_rollout, for_update = jax.random.split(state.key, 3)
        after, rollout = gather(env, state.learner.policy, state.env, for_rollout, config.loop)
        learner, metrics = learn(state.learner, rollout, for_update)
        return TrainState(learner, after, key), metrics, rollout

    if env.traced:
        whole = kept(partial(iterate, collect, learn), "iteration of PPO", env.identity)
        compiled = jit(whole).lower(shape).compile()
    else:
        compiled = partial(iterate, elsewhere or host_collector(), jit(learn))

    def judged(state: TrainState) -> tuple[TrainState, Watched]:
        new, metrics, rollout = compiled(state)
        watched = Watched(metrics, _finite(rollout, new, metrics), rollout)
        return new if watched.sound else state, watched

    return judged


def _finite(rollout: Rollout, state: TrainState, metrics: Metrics) -> Finite:
    return Finite(
        observation=all_finite((rollout.observation, rollout.next_observation)),
        action=all_finite((rollout.output, rollout.log_prob)),
        reward=all_finite(rollout.reward),
        environment=all_finite((rollout.distance, state.env)),
        gradient=all_finite(metrics["gradient_norm"]),
        loss=all_finite(metrics),
        parameter=all_finite(state.learner),
    )


PPO = Method(lambda _config, _resume: None, initial_state, compile_iteration, shares=True)
"""Proximal policy optimisation."""
