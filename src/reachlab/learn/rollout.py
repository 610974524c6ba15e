"""Rollouts: a policy's experience in the environment, `[T, B]`, with resets in between."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.stages import Wrapped

from reachlab.agents.policy import Memory, Policy, features, gaussian, remembered
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.jax_setup import jit
from reachlab.settings.config import LoopConfig
from reachlab.sims.simulator import chosen
from reachlab.tasks.schema import Observed


class Target(NamedTuple):
    """Where a target is that is not always seen.

    Attributes:
        place: `[..., 3]`, in halves of the workspace's edges from its middle.
        way: to it from the tool `[..., 3]` [m].
    """

    place: Array
    way: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Rollout:
    """`T` actions of `B` environments.

    Attributes:
        observation: what the policy observed `[T, B, k]`.
        output: the sampled output of its network `[T, B, a]`, in halves of the action box.
        log_prob: log density of that sample `[T, B]`.
        next_observation: what came of it `[T, B, k]`, the final observation where an episode ended.
        reward: `[T, B]`.
        terminated, truncated: ends of episodes `[T, B]`.
        success: `[T, B]`.
        distance: tool to target after the step `[T, B]` [m].
        clock: number of the step in its episode `[T, B]`.
        memory: what the policy remembered before it `[T, B, M]`; None of one without memory.
        target: where the target was then; None where it is always seen, or nothing remembered.
    """

    observation: Observed
    output: Array
    log_prob: Array
    next_observation: Observed
    reward: Array
    terminated: Array
    truncated: Array
    success: Array
    distance: Array
    clock: Array
    memory: Memory = None
    target: Target | None = None

    @property
    def done(self) -> Array:
        """Ends of episodes, either way `[T, B]`."""
        return self.terminated | self.truncated


class EngineError(FloatingPointError):
    """An engine's state is not finite any more; `rollout` is what was collected before, None if nothing was."""

    def __init__(self, message: str, rollout: Rollout | None) -> None:
        super().__init__(message)
        self.rollout = rollout


Collect = Callable[[Env, Policy, EnvState, Array, LoopConfig], tuple[EnvState, Rollout]]


def collect(env: Env, policy: Policy, state: EnvState, key: Array, config: LoopConfig) -> tuple[EnvState, Rollout]:
    """State after `rollout_steps` actions of every environment, and the experience; episodes that end begin anew."""

    def step(state: EnvState, key: Array) -> tuple[EnvState, Rollout]:
        noise = jax.random.normal(key, (env.num_envs, *policy.half.shape))
        choice, target = sample_action(policy, env.observe(state), state.memory, noise), _target(env, state)
        state, transition = env.step(replace(state, memory=choice.after), choice.action, config.action_repeat)
        row = replace(_row(choice, state, transition, transition.observation), target=target)
        return env.reset(state, transition.done, config.chained_starts or None), row

    return jax.lax.scan(step, state, jax.random.split(key, config.rollout_steps))


def host_collector(first: int = 0, of: int | None = None) -> Collect:
    """As `collect`, for a simulator that JAX cannot trace: compiled parts around its steps.

    For environments from the `first` on, `of` so many in all, it gives the rows that all of them together would have.
    """
    choose = jit(sample_action)  # once a step, and half as fast as a brief one

    @functools.cache
    def draw(*shape: int) -> Wrapped:
        return jit(jax.vmap(lambda key: jax.random.normal(key, shape)), brief=True)

    def collect(env: Env, policy: Policy, state: EnvState, key: Array, config: LoopConfig) -> tuple[EnvState, Rollout]:
        rows, observation = [], env.observe_now(state)
        noise = np.asarray(draw(of or env.num_envs, *policy.half.shape)(jax.random.split(key, config.rollout_steps)))
        for now in noise[:, first : first + env.num_envs]:
            choice, target = choose(policy, observation, state.memory, now), _target(env, state)
            try:
                state, transition = env.step(replace(state, memory=choice.after), choice.action, config.action_repeat)
            except FloatingPointError as error:
                raise EngineError(str(error), _stacked(rows) if rows else None) from None
            observation = env.observe_now(state) if env.pictured else transition.observation
            rows.append(replace(_row(choice, state, transition, observation), target=target))
            if (done := np.asarray(transition.done)).any():
                state = env.reset(state, done, config.chained_starts or None)
                observation = chosen(done, env.observe_now(state, done), observation)
        return state, _stacked(rows)

    return collect


def _stacked(rows: Sequence[Rollout]) -> Rollout:
    return jax.tree.map(lambda *x: np.stack(x), *rows)


class Choice(NamedTuple):
    """What a policy observed and remembered, what it sampled, and what it remembers then.

    `observation [B, k]`, `memory [B, M]`, `output` and `action [B, a]`, `log_prob [B]`, `after [B, M]`.
    """

    observation: Observed
    memory: Memory
    output: Array
    action: Array
    log_prob: Array
    after: Memory


def sample_action(policy: Policy, observation: Observed, memory: Memory, noise: Array) -> Choice:
    """A sample of the policy's distribution, by standard normal `noise [B, a]`."""
    known = features(policy.parameters, policy.inputs(observation, memory))
    head, after = gaussian(policy.parameters, known), remembered(policy.parameters, known)
    output = head.moved(noise)
    return Choice(observation, memory, output, policy.action(output), head.log_prob(output), after)


def _target(env: Env, state: EnvState) -> Target | None:
    """What a policy that remembers is taught."""
    if state.memory is None or not env.setup.rules.hides_goal:
        return None
    goal = state.goal.position
    return Target(env.setup.robot.in_workspace(goal), goal - state.arm.tool_position)


def _row(choice: Choice, state: EnvState, transition: Transition, after: Observed) -> Rollout:
    return Rollout(
        observation=choice.observation,
        output=choice.output,
        log_prob=choice.log_prob,
        next_observation=after,
        reward=transition.reward,
        terminated=transition.terminated,
        truncated=transition.truncated,
        success=transition.terms["success"],
        distance=transition.errors.distance,
        clock=state.clock,
        memory=choice.memory,
    )


def episode_statistics(rollout: Rollout) -> dict[str, Array]:
    """Scalars of the episodes that ended in the rollout: how many, their success rate and mean length.

    `early_rate` is the share that failed before their time, by contact or outside the workspace.
    """
    done = rollout.done
    episodes = done.sum()
    at_least_one = jnp.maximum(episodes, 1)
    return {
        "episodes": episodes,
        "success_rate": (rollout.success & done).sum() / at_least_one,
        "early_rate": (rollout.terminated & ~rollout.success).sum() / at_least_one,
        "episode_length": (rollout.clock * done).sum() / at_least_one,
        "final_distance": (rollout.distance * done).sum() / at_least_one,
        "reward": rollout.reward.mean(),
    }
