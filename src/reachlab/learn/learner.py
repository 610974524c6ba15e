"""What learns, whatever the method: a policy and its optimiser."""

from __future__ import annotations

import contextlib
import itertools
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.agents.policy import Policy, make_policy
from reachlab.envs.core import Env
from reachlab.jax_setup import SINGLE
from reachlab.settings.config import DistilRunConfig, RunConfig
from reachlab.settings.validation import InputError
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import design_of
from reachlab.tasks.task import TaskSetup

if TYPE_CHECKING:
    import optax

ADAM_EPSILON = 1e-5
"""Adam's epsilon, as PPO's reference implementation sets it."""

COPIES = 4
"""Of each parameter: itself, its gradient, and Adam's two moments."""

CONTAINER = Path("/sys/fs/cgroup/memory.max")
"""Where Linux says how much memory a container may use [bytes]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Learner:
    """A policy, its optimiser's state, and the environment steps that it has learnt from `[]`."""

    policy: Policy
    optimiser: optax.OptState
    steps: Array


def make_initial_policy(config: RunConfig, env: Env, key: Array) -> Policy:
    """Untrained policy for an environment."""
    settings, points = config.learner, ACTIONS[config.rules.action].points
    box, more = env.action_bounds, {"points": points, "memory": settings.memory}
    return make_policy(key, env.schema, box, settings.hidden, settings.initial_std, **more)


def make_optimiser(config: RunConfig, updates: int, decay: float = 0.0) -> optax.GradientTransformation:
    """Adam on gradients clipped by their global norm, the step size falling on a straight line.

    An iteration takes so many `updates`. With a `decay` of the weights (Loshchilov and Hutter, "Decoupled weight decay
    regularization", ICLR 2019) an update needs to be given them; biases and the noise of actions are left as they are.
    """
    import optax

    settings = config.learner
    iterations = -(-settings.anneal_steps // config.loop.iteration_steps)
    schedule = optax.linear_schedule(settings.learning_rate, settings.final_learning_rate, updates * iterations)
    return optax.chain(
        optax.clip_by_global_norm(settings.max_grad_norm),
        optax.adamw(schedule, eps=ADAM_EPSILON, weight_decay=decay, mask=_are_weights)
        if decay
        else optax.adam(schedule, eps=ADAM_EPSILON),
    )


def _are_weights(parameters: optax.Params) -> Any:
    return jax.tree.map(lambda x: jnp.ndim(x) > 1, parameters)


def make_learner(optimiser: optax.GradientTransformation, policy: Policy) -> Learner:
    """Learner that has learnt nothing yet."""
    parameters = cast("optax.Params", policy.parameters)
    return Learner(policy, optimiser.init(parameters), jnp.zeros(()))


def check_memory(config: RunConfig, setup: TaskSetup) -> None:
    """Make sure that a rollout, what is made of it and the networks can fit in this machine's memory.

    Raises:
        InputError: they cannot, by what they need at least.
    """
    loop, hidden = config.loop, config.learner.hidden
    low = design_of(config.rules).schema(setup).bounds[0]
    observed = sum(part.nbytes for part in jax.tree.leaves(low))
    kept = config.dagger.capacity if isinstance(config, DistilRunConfig) else 0
    actions = loop.num_envs * loop.rollout_steps
    weights = 2 * sum(wide * high for wide, high in itertools.pairwise(hidden))
    activations = 2 * sum(hidden) * actions // config.ppo.minibatches
    needed = (actions + kept) * observed + SINGLE * (COPIES * weights + activations)
    if needed > (there := _memory()):
        raise InputError(
            f"num_envs {loop.num_envs:,} with rollout_steps {loop.rollout_steps:,} and hidden"
            f" {' '.join(map(str, hidden))} need at least {needed / 2**30:,.0f} GB of memory, and there are"
            f" {there / 2**30:,.0f} GB: choose less of them."
        )


def _memory() -> int:
    """Memory of this machine, or of the container where it has less [bytes]; no bound where it is not known."""
    if not hasattr(os, "sysconf"):
        return sys.maxsize
    machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with contextlib.suppress(OSError, ValueError):
        return min(machine, int(CONTAINER.read_text()))
    return machine
