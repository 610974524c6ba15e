"""One iteration of training, compiled: a rollout and its update, or nothing if a number in it is not finite."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.agents.policy import Policy, make_policy
from reachlab.envs.core import Env, EnvState
from reachlab.envs.streams import LEARNER_STREAM, TRAINING_STREAM, episode_keys, stream_key
from reachlab.jax_setup import jit
from reachlab.learn import ppo
from reachlab.learn.rollout import Collect, Rollout, collect, episode_statistics, host_collector
from reachlab.settings.config import RunConfig


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TrainState:
    """All that training changes: enough to go on from."""

    learner: ppo.Learner
    env: EnvState
    key: Array


class Finite(NamedTuple):
    """For each kind of number whether all of them are finite `[]`, causes before what they lead to."""

    observation: Array
    action: Array
    reward: Array
    environment: Array
    gradient: Array
    loss: Array
    parameter: Array

    def missing(self) -> list[str]:
        """Kinds of which one number or more is not finite."""
        return [kind for kind, finite in self._asdict().items() if not finite]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Watched:
    """What an iteration is judged by.

    Attributes:
        metrics: scalars of the rollout and of its update.
        finite: whether all numbers are finite.
        rollout: the experience as a pytree, to be looked into where they are not.
    """

    metrics: dict[str, Array]
    finite: Finite
    rollout: object

    @property
    def sound(self) -> Array:
        """Whether every number is finite."""
        return jnp.stack(self.finite).all()


Tree = TypeVar("Tree")
Learn = Callable[[ppo.Learner, Rollout, EnvState, Array], tuple[ppo.Learner, Watched]]
Keep = Callable[[Array, TrainState, TrainState], TrainState]
Iteration = Callable[[TrainState], tuple[TrainState, Watched]]


class Method(NamedTuple):
    """A way of learning: its first state, of environment, configuration and seed, and its iteration."""

    initial_state: Callable[[Env, RunConfig, Any], Any]
    compile_iteration: Callable[[Env, RunConfig, Any], Callable[[Any], tuple[Any, Watched]]]


def make_initial_policy(config: RunConfig, env: Env, key: Array) -> Policy:
    """Untrained policy for an environment."""
    return make_policy(key, env.observation_bounds, env.action_bounds, config.ppo.hidden, config.ppo.initial_std)


def initial_state(env: Env, config: RunConfig, seed: int | Array) -> TrainState:
    """State before the first iteration."""
    key, for_policy = jax.random.split(stream_key(seed, LEARNER_STREAM))
    lanes = episode_keys(seed, TRAINING_STREAM, 0, config.ppo.num_envs)
    learner = env.traced(lambda key: ppo.make_learner(config.ppo, make_initial_policy(config, env, key)))(for_policy)
    return TrainState(learner, env.init(lanes), key)


def compile_iteration(env: Env, config: RunConfig, shape: TrainState) -> Iteration:
    """Function that gives the state after one rollout and its update, and what it is judged by.

    If a number is not finite the state is the one before. With a pure simulator it is one program; else the
    environment steps on the host, between compiled parts. It may use up the state it is given.
    """

    def learn(learner: ppo.Learner, rollout: Rollout, lanes: EnvState, key: Array) -> tuple[ppo.Learner, Watched]:
        new, metrics = ppo.update(learner, rollout, key, config.ppo)
        watched = Watched({**episode_statistics(rollout), **metrics}, _finite(rollout, lanes, metrics, new), rollout)
        return _select(watched.sound, new, learner), watched

    def iterate(gather: Collect, learn: Learn, keep: Keep, state: TrainState) -> tuple[TrainState, Watched]:
        key, for_rollout, for_update = jax.random.split(state.key, 3)
        lanes, rollout = gather(env, state.learner.policy, state.env, for_rollout, config.ppo)
        learner, watched = learn(state.learner, rollout, lanes, for_update)
        return keep(watched.sound, TrainState(learner, lanes, key), TrainState(learner, state.env, state.key)), watched

    if env.pure:
        return jit(partial(iterate, collect, learn, _select), donate=(0,)).lower(shape).compile()
    return partial(iterate, host_collector(), jit(learn, donate=(0,)), lambda sound, new, old: new if sound else old)


def _finite(rollout: Rollout, lanes: EnvState, metrics: dict[str, Array], learner: ppo.Learner) -> Finite:
    return Finite(
        observation=all_finite((rollout.observation, rollout.next_observation)),
        action=all_finite((rollout.output, rollout.log_prob)),
        reward=all_finite(rollout.reward),
        environment=all_finite((rollout.distance, replace(lanes, recent=None))),  # infinite where the arm moved
        gradient=all_finite(metrics["gradient_norm"]),
        loss=all_finite(metrics),
        parameter=all_finite(learner),
    )


def all_finite(tree: object) -> Array:
    """Whether every number in a pytree is finite `[]`."""
    floats = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return jnp.array([jnp.isfinite(leaf).all() for leaf in floats], bool).all()


def _select(sound: Array, new: Tree, old: Tree) -> Tree:
    return jax.tree.map(lambda a, b: jnp.where(sound, a, b), new, old)


PPO = Method(initial_state, compile_iteration)
"""Proximal policy optimisation."""
