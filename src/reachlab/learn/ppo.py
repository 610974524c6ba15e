"""Proximal policy optimisation as pure functions (Schulman et al., arXiv:1707.06347)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

from reachlab.agents.policy import Inputs, Parameters, Policy, features, gaussian, remembered, value, worth
from reachlab.learn.learner import Learner, make_optimiser
from reachlab.learn.rollout import Rollout, Target
from reachlab.settings.config import PPOConfig, RunConfig

SMALL = 0.3
"""Number that stands for 1 in what is remembered of places: there the hyperbolic tangent is all but straight."""

CLOSE = 0.04
"""Way to a hidden target that the memory tells as the hyperbolic tangent of 1 [m]: it draws near ones apart."""

PLACE_WEIGHT, WAY_WEIGHT = 300.0, 13.0
"""Weights of the squares by which what is remembered of a hidden target's place and of the way to it is off."""

Carry = tuple[Parameters, optax.OptState]


class Batch(NamedTuple):
    """Samples of a rollout: what the networks are given, their outputs and what these are worth.

    With `[N]` in front or, of a policy that remembers, `[T, B]`.
    """

    inputs: Inputs
    output: Array
    log_prob: Array
    advantage: Array
    returns: Array
    target: Target | None = None


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


def taught(memory: Array, target: Target) -> tuple[Array, Array]:
    """Mean squares `[]` by which what is remembered `[..., M]` of a target's place and of the way to it is off.

    The first three numbers tell the place. The next three tell the way, which one cell can compute of them and of where
    the tool is: layers after it would have to tell millimetres apart in the difference of two places.
    """
    wanted = jnp.concatenate([SMALL * target.place, jnp.tanh(target.way / CLOSE)], axis=-1)
    squares = jnp.square(memory[..., : wanted.shape[-1]] - wanted[..., : memory.shape[-1]])
    return squares[..., :3].sum(axis=-1).mean(), squares[..., 3:].sum(axis=-1).mean()


def loss(parameters: Parameters, batch: Batch, config: PPOConfig) -> tuple[Array, dict[str, Array]]:
    """Clipped surrogate loss `[]` of a batch, and scalars worth watching."""
    known = features(parameters, batch.inputs)
    head = gaussian(parameters, known)
    log_ratio = head.log_prob(batch.output) - batch.log_prob
    ratio = jnp.exp(log_ratio)
    advantage = (batch.advantage - batch.advantage.mean()) / (batch.advantage.std() + 1e-8)
    clipped = jnp.clip(ratio, 1 - config.clip_ratio, 1 + config.clip_ratio)
    policy_loss = -jnp.minimum(ratio * advantage, clipped * advantage).mean()
    value_loss = 0.5 * jnp.square(worth(parameters, known) - batch.returns).mean()
    entropy = head.entropy()
    total = policy_loss + config.value_weight * value_loss - config.entropy_weight * entropy
    watched = {}
    if batch.target is not None and (memory := remembered(parameters, known)) is not None:
        watched = dict(zip(("place_error", "way_error"), taught(memory, batch.target), strict=True))
        total += PLACE_WEIGHT * watched["place_error"] + WAY_WEIGHT * watched["way_error"]
    return total, watched | {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        # Schulman's low-variance estimator, joschu.net/blog/kl-approx.html
        "kl": (ratio - 1 - log_ratio).mean(),
        "clip_fraction": (jnp.abs(ratio - 1) > config.clip_ratio).mean(),
    }


def updates_per_iteration(config: PPOConfig) -> int:
    """Gradient steps of an iteration."""
    return config.epochs * config.minibatches


def update(learner: Learner, rollout: Rollout, key: Array, config: RunConfig) -> tuple[Learner, dict[str, Array]]:
    """Learner after `epochs` passes over a rollout, and the means of what `loss` watches.

    The rollout was collected with the normaliser that the learner holds; the new one takes effect afterwards.
    """
    settings, policy = config.ppo, learner.policy
    optimiser = make_optimiser(config, updates_per_iteration(settings))
    samples, size, whole = _samples(policy, rollout, settings), rollout.reward.size, rollout.memory is not None

    def gradient_step(carry: Carry, batch: Batch) -> tuple[Carry, dict[str, Array]]:
        parameters, state = carry
        gradient, watched = jax.grad(loss, has_aux=True)(parameters, batch, settings)
        change, state = optimiser.update(gradient, state)
        watched["gradient_norm"] = optax.tree.norm(gradient)
        return (jax.tree.map(jnp.add, parameters, change), state), watched

    def epoch(carry: Carry, key: Array) -> tuple[Carry, dict[str, Array]]:
        num_envs = rollout.reward.shape[1]
        order = jax.random.permutation(key, num_envs) if whole else _shuffle(key, *rollout.reward.shape)

        def part(x: Array, rows: Array) -> Array:
            return x[:, rows] if whole else x[rows]  # what is remembered needs all that was before

        return jax.lax.scan(
            lambda carry, rows: gradient_step(carry, jax.tree.map(lambda x: part(x, rows), samples)),
            carry,
            order.reshape(settings.minibatches, -1),
        )

    carry = (policy.parameters, learner.optimiser)
    (parameters, state), watched = jax.lax.scan(epoch, carry, jax.random.split(key, settings.epochs))
    flat = jax.tree.map(lambda x: x.reshape(size, *x.shape[2:]), rollout.observation)
    steps = learner.steps + config.loop.iteration_steps
    parameters = replace(parameters, log_std=_log_std(parameters.log_std, steps, config))
    watched = {name: x.mean() for name, x in watched.items()} | {"std": jnp.exp(parameters.log_std).mean()}
    # The share of what returns differ by that the critic knew before they came: advantages are what it did not know.
    watched["explained_variance"] = 1 - samples.advantage.var() / (samples.returns.var() + 1e-8)
    return Learner(replace(policy.observed(flat), parameters=parameters), state, steps), watched


def _log_std(learnt: Array, steps: Array, config: RunConfig) -> Array:
    """Log standard deviation `[a]` after so many steps: the learnt one, unless it has to follow a schedule."""
    if config.ppo.final_std is None:
        return learnt
    begin, end = math.log(config.learner.initial_std), math.log(config.ppo.final_std)
    return jnp.full_like(learnt, begin + (end - begin) * jnp.minimum(steps / config.learner.anneal_steps, 1.0))


def _shuffle(key: Array, steps: int, num_envs: int) -> Array:
    """Order `[T · B]` of the samples in which every part has, of each step, environments of its own.

    The environments are permuted once and shifted at random for every step: a full permutation's sort would take
    as long as the gradients.
    """
    for_envs, for_shift = jax.random.split(key)
    shift = jax.random.randint(for_shift, (steps, 1), 0, num_envs)
    env = jax.random.permutation(for_envs, num_envs)[(jnp.arange(num_envs) + shift) % num_envs]
    return (jnp.arange(steps)[:, None] * num_envs + env).T.reshape(-1)


def _values(policy: Policy, inputs: Inputs, config: PPOConfig) -> Array:
    """Values `[T, B]`; of pictures step by step, as their patches would take the memory of a whole rollout."""
    if not config.value_weight:
        return jnp.zeros(jax.tree.leaves(inputs)[0].shape[:2])
    if inputs.picture is None:
        return value(policy.parameters, inputs)
    return jax.lax.map(lambda row: value(policy.parameters, row), inputs)


def _samples(policy: Policy, rollout: Rollout, config: PPOConfig) -> Batch:
    parameters, memory = policy.parameters, rollout.memory
    inputs = policy.inputs(rollout.observation, memory)
    v_t = _values(policy, inputs, config)
    after = None if memory is None else remembered(parameters, features(parameters, inputs))
    v_tp1 = _values(policy, policy.inputs(rollout.next_observation, after), config)
    advantage = gae(rollout.reward, v_t, v_tp1, rollout.terminated, rollout.done, config.gamma, config.gae_lambda)
    samples = Batch(inputs, rollout.output, rollout.log_prob, advantage, advantage + v_t, rollout.target)
    if memory is None:
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), samples)
    begins = jnp.concatenate([jnp.zeros_like(rollout.done[:1]), rollout.done[:-1]])
    return samples._replace(inputs=inputs._replace(memory=memory[:1], begins=begins))
