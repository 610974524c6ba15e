"""What learns, whatever the method: a policy and its optimiser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import jax
import jax.numpy as jnp
import optax
from jax import Array

from reachlab.agents.policy import Policy, make_policy
from reachlab.envs.core import Env
from reachlab.settings.config import RunConfig

ADAM_EPSILON = 1e-5
"""Adam's epsilon, as PPO's reference implementation sets it."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Learner:
    """A policy, its optimiser's state, and the environment steps that it has learnt from `[]`."""

    policy: Policy
    optimiser: optax.OptState
    steps: Array


def make_initial_policy(config: RunConfig, env: Env, key: Array) -> Policy:
    """Untrained policy for an environment."""
    settings = config.learner
    return make_policy(key, env.schema, env.action_bounds, settings.hidden, settings.initial_std)


def make_optimiser(config: RunConfig, updates: int) -> optax.GradientTransformation:
    """Adam on gradients clipped by their global norm, the step size falling on a straight line.

    An iteration takes so many `updates`.
    """
    settings = config.learner
    iterations = -(-settings.anneal_steps // config.loop.iteration_steps)
    schedule = optax.linear_schedule(settings.learning_rate, settings.final_learning_rate, updates * iterations)
    return optax.chain(
        optax.clip_by_global_norm(settings.max_grad_norm),
        optax.adam(schedule, eps=ADAM_EPSILON),
    )


def make_learner(optimiser: optax.GradientTransformation, policy: Policy) -> Learner:
    """Learner that has learnt nothing yet."""
    parameters = cast("optax.Params", policy.parameters)
    return Learner(policy, optimiser.init(parameters), jnp.zeros(()))
