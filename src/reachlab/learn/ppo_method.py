"""PPO as a method: an iteration is a rollout and its update, compiled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
from jax import Array

from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.random_streams import LEARNER_STREAM, TRAINING_STREAM, episode_keys, stream_key
from reachlab.jax_setup import beside, jit
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


class Played(NamedTuple):
    """A rollout, the environments' `state` after it, the next iteration's `key`, and that of the update."""

    state: EnvState
    rollout: Rollout
    key: Array
    for_update: Array


Metrics = dict[str, Array]
Play = Callable[[Policy, EnvState, Array], Played]
Learn = Callable[[Learner, Rollout, Array], tuple[Learner, Metrics]]
Iteration = Callable[[TrainState], tuple[TrainState, Watched]]


def initial_state(env: Env, config: RunConfig, seed: int | Array, _given: Any = None) -> TrainState:
    """State before the first iteration."""

    def begin(key: Array) -> Learner:
        optimiser = make_optimiser(config, ppo.updates_per_iteration(config.ppo))
        return make_learner(optimiser, make_initial_policy(config, env, key))

    key, for_policy = jax.random.split(stream_key(seed, LEARNER_STREAM))
    episodes = episode_keys(seed, TRAINING_STREAM, 0, config.loop.num_envs)
    return TrainState(env.compile_part(begin)(for_policy), env.init(episodes), key)


def compile_iteration(env: Env, config: RunConfig, shape: TrainState, elsewhere: Collect | None = None) -> Iteration:
    """See `Method.compile_iteration`.

    Where everything is traced the rollout is one program and its update another, compiled at the same time; else the
    environment steps on the host, between compiled parts.
    """
    gather = collect if env.traced else elsewhere or host_collector()

    def play(policy: Policy, state: EnvState, key: Array) -> Played:
        key, for_rollout, for_update = jax.random.split(key, 3)
        return Played(*gather(env, policy, state, for_rollout, config.loop), key, for_update)

    def learn(learner: Learner, rollout: Rollout, key: Array) -> tuple[Learner, Metrics]:
        new, metrics = ppo.update(learner, rollout, key, config)
        return new, {**episode_statistics(rollout), **metrics}

    playing, learning = _compiled(env, play, learn, shape) if env.traced else (play, jit(learn))

    def iterate(state: TrainState) -> tuple[TrainState, Watched]:
        played = playing(state.learner.policy, state.env, state.key)
        learner, metrics = learning(state.learner, played.rollout, played.for_update)
        new = TrainState(learner, played.state, played.key)
        watched = Watched(metrics, _finite(played.rollout, new, metrics), played.rollout)
        return new if watched.sound else state, watched

    return iterate


def _compiled(env: Env, play: Play, learn: Learn, shape: TrainState) -> tuple[Play, Learn]:
    playing = jit(kept(play, "rollout", env.identity)).lower(shape.learner.policy, shape.env, shape.key)
    compiled, played = beside(playing.compile), playing.out_info
    learning = jit(kept(learn, "update of PPO", env.identity)).lower(shape.learner, played.rollout, played.for_update)
    return compiled, beside(learning.compile)


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
