"""Rollouts: a policy's experience in the environment, `[T, B]`, with resets in between."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.env import Env, EnvState, Transition
from reachlab.policy import Policy, distribution


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Rollout:
    """`T` steps of `B` lanes.

    Attributes:
        observation: what the policy saw `[T, B, k]`.
        output: what its network drew `[T, B, a]`, in halves of the action box.
        log_prob: log density of that draw `[T, B]`.
        next_observation: what came of it `[T, B, k]`, the final observation where an episode ended.
        reward: `[T, B]`.
        terminated, truncated: ends of episodes `[T, B]`.
        success: `[T, B]`.
        distance: tool to target after the step `[T, B]` [m].
        clock: number of the step in its episode `[T, B]`.
    """

    observation: Array
    output: Array
    log_prob: Array
    next_observation: Array
    reward: Array
    terminated: Array
    truncated: Array
    success: Array
    distance: Array
    clock: Array

    @property
    def done(self) -> Array:
        """Ends of episodes, either way `[T, B]`."""
        return self.terminated | self.truncated


def collect(env: Env, policy: Policy, state: EnvState, key: Array, steps: int) -> tuple[EnvState, Rollout]:
    """State after `steps` steps of every lane, and the experience; lanes that end begin anew."""

    def step(state: EnvState, key: Array) -> tuple[EnvState, Rollout]:
        observation = env.observe(state)
        head = distribution(policy.parameters, policy.normaliser(observation))
        output = head.sample(key)
        state, transition = env.step(state, policy.action(output))
        row = _row(observation, output, head.log_prob(output), state, transition)
        return env.reset(state, transition.done), row

    return jax.lax.scan(step, state, jax.random.split(key, steps))


def _row(observation: Array, output: Array, log_prob: Array, state: EnvState, transition: Transition) -> Rollout:
    return Rollout(
        observation=observation,
        output=output,
        log_prob=log_prob,
        next_observation=transition.observation,
        reward=transition.reward,
        terminated=transition.terminated,
        truncated=transition.truncated,
        success=transition.terms["success"],
        distance=transition.terms["distance"],
        clock=state.clock,
    )


def episode_statistics(rollout: Rollout) -> dict[str, Array]:
    """Scalars of the episodes that ended in the rollout: how many, their success rate and mean length."""
    done = rollout.done
    episodes = done.sum()
    at_least_one = jnp.maximum(episodes, 1)
    return {
        "episodes": episodes,
        "success_rate": (rollout.success & done).sum() / at_least_one,
        "episode_length": (rollout.clock * done).sum() / at_least_one,
        "final_distance": (rollout.distance * done).sum() / at_least_one,
        "reward": rollout.reward.mean(),
    }
