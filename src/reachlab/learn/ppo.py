"""Proximal policy optimisation as pure functions (Schulman et al., arXiv:1707.06347)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from jax import Array

from reachlab.agents.policy import Parameters, Policy, distribution, value
from reachlab.settings.config import PPOConfig
from reachlab.tasks.reach import Observed

if TYPE_CHECKING:
    from reachlab.learn.rollout import Rollout

ADAM_EPSILON = 1e-5
"""Adam's epsilon, as PPO's reference implementation sets it."""


Carry = tuple[Parameters, optax.OptState]


class Batch(NamedTuple):
    """Samples of a rollout, `[N]` in front: normalised observations, outputs and what they are worth."""

    observation: Observed
    output: Array
    log_prob: Array
    advantage: Array
    returns: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Learner:
    """What learns: the policy and the optimiser's state."""

    policy: Policy
    optimiser: optax.OptState


def make_optimiser(config: PPOConfig, updates: int = 0) -> optax.GradientTransformation:
    """Adam on gradients clipped by their global norm, the step size falling on a straight line.

    An iteration takes so many `updates`; 0 stands for those of PPO.
    """
    updates = updates or config.epochs * config.minibatches
    iterations = -(-config.anneal_steps // config.iteration_steps)
    schedule = optax.linear_schedule(config.learning_rate, config.final_learning_rate, updates * iterations)
    return optax.chain(
        optax.clip_by_global_norm(config.max_grad_norm),
        optax.adam(schedule, eps=ADAM_EPSILON),
    )


def make_learner(config: PPOConfig, policy: Policy) -> Learner:
    """Learner that has learnt nothing yet."""
    return Learner(policy, make_optimiser(config).init(cast("optax.Params", policy.parameters)))


def gae(
    reward: Array, v_t: Array, v_tp1: Array, terminated: Array, done: Array, gamma: float, gae_lambda: float
) -> Array:
    """Generalised advantage estimates `[T, B]` (Schulman et al., arXiv:1506.02438).

    Args:
        reward: `[T, B]`.
        v_t: value of the state before each step `[T, B]`.
        v_tp1: value of the state after it, before any reset `[T, B]`; used unless terminated, so that a
            truncated episode bootstraps from its own final state.
        terminated: the task ended the episode `[T, B]`.
        done: it ended either way `[T, B]`; no credit flows back across.
        gamma: discount.
        gae_lambda: decay of the estimator.
    """
    delta = reward + gamma * v_tp1 * ~terminated - v_t

    def back(advantage_tp1: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        delta_t, done_t = now
        advantage_t = delta_t + gamma * gae_lambda * advantage_tp1 * ~done_t
        return advantage_t, advantage_t

    return jax.lax.scan(back, jnp.zeros_like(delta[0]), (delta, done), reverse=True)[1]


def loss(parameters: Parameters, batch: Batch, config: PPOConfig) -> tuple[Array, dict[str, Array]]:
    """Clipped surrogate loss `[]` of a batch, and scalars worth watching."""
    head = distribution(parameters, batch.observation)
    log_ratio = head.log_prob(batch.output) - batch.log_prob
    ratio = jnp.exp(log_ratio)
    advantage = (batch.advantage - batch.advantage.mean()) / (batch.advantage.std() + 1e-8)
    clipped = jnp.clip(ratio, 1 - config.clip_ratio, 1 + config.clip_ratio)
    policy_loss = -jnp.minimum(ratio * advantage, clipped * advantage).mean()
    value_loss = 0.5 * jnp.square(value(parameters, batch.observation) - batch.returns).mean()
    entropy = head.entropy()
    total = policy_loss + config.value_weight * value_loss - config.entropy_weight * entropy
    return total, {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        # Schulman's low-variance estimator, joschu.net/blog/kl-approx.html
        "kl": (ratio - 1 - log_ratio).mean(),
        "clip_fraction": (jnp.abs(ratio - 1) > config.clip_ratio).mean(),
    }


def update(learner: Learner, rollout: Rollout, key: Array, config: PPOConfig) -> tuple[Learner, dict[str, Array]]:
    """Learner after `epochs` passes over a rollout, and the means of what `loss` watches.

    The rollout was drawn with the normaliser the learner holds; the new one takes effect afterwards.
    """
    policy, optimiser = learner.policy, make_optimiser(config)
    samples = _samples(policy, rollout, config)
    size = samples.log_prob.shape[0]

    def gradient_step(carry: Carry, batch: Batch) -> tuple[Carry, dict[str, Array]]:
        parameters, state = carry
        gradient, watched = jax.grad(loss, has_aux=True)(parameters, batch, config)
        change, state = optimiser.update(gradient, state)
        watched["gradient_norm"] = optax.tree.norm(gradient)
        return (jax.tree.map(jnp.add, parameters, change), state), watched

    def epoch(carry: Carry, key: Array) -> tuple[Carry, dict[str, Array]]:
        batches = _shuffle(key, *rollout.reward.shape).reshape(config.minibatches, -1)
        return jax.lax.scan(
            lambda carry, rows: gradient_step(carry, jax.tree.map(lambda x: x[rows], samples)), carry, batches
        )

    carry = (policy.parameters, learner.optimiser)
    (parameters, state), watched = jax.lax.scan(epoch, carry, jax.random.split(key, config.epochs))
    flat = jax.tree.map(lambda x: x.reshape(size, *x.shape[2:]), rollout.observation)
    normaliser = policy.normaliser.update(flat)
    steps = config.action_repeat * normaliser.count
    parameters = replace(parameters, log_std=_log_std(parameters.log_std, steps, config))
    watched = {name: x.mean() for name, x in watched.items()} | {"std": jnp.exp(parameters.log_std).mean()}
    return Learner(replace(policy, parameters=parameters, normaliser=normaliser), state), watched


def _log_std(learnt: Array, steps: Array, config: PPOConfig) -> Array:
    """Log standard deviation `[a]` after so many steps: the learnt one, unless it has to follow a schedule."""
    if config.final_std is None:
        return learnt
    begin, end = math.log(config.initial_std), math.log(config.final_std)
    return jnp.full_like(learnt, begin + (end - begin) * jnp.minimum(steps / config.anneal_steps, 1.0))


def _shuffle(key: Array, steps: int, lanes: int) -> Array:
    """Order `[T · B]` of the samples in which every part draws, at each step, its own lanes.

    The lanes are permuted once and shifted at random for every step: a full permutation's sort would take
    as long as the gradients.
    """
    for_lanes, for_shift = jax.random.split(key)
    shift = jax.random.randint(for_shift, (steps, 1), 0, lanes)
    lane = jax.random.permutation(for_lanes, lanes)[(jnp.arange(lanes) + shift) % lanes]
    return (jnp.arange(steps)[:, None] * lanes + lane).T.reshape(-1)


def _values(policy: Policy, normalised: Observed) -> Array:
    """Values `[T, B]`; of pictures step by step, as their squares would take the memory of a whole rollout."""
    if policy.parameters.encoder is None:
        return value(policy.parameters, normalised)
    return jax.lax.map(lambda row: value(policy.parameters, row), normalised)


def _samples(policy: Policy, rollout: Rollout, config: PPOConfig) -> Batch:
    observation = policy.normaliser(rollout.observation)
    v_t = _values(policy, observation)
    v_tp1 = _values(policy, policy.normaliser(rollout.next_observation))
    advantage = gae(rollout.reward, v_t, v_tp1, rollout.terminated, rollout.done, config.gamma, config.gae_lambda)
    samples = Batch(observation, rollout.output, rollout.log_prob, advantage, advantage + v_t)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), samples)
