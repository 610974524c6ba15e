"""A batch of episodes under way, as the interfaces of other libraries step it: one call a step, resets included."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode

from reachlab.control.situation import Goal
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvFunctions, EnvState, named_errors
from reachlab.envs.packing import AsTheyAre, make_packing
from reachlab.envs.random_streams import env_keys, gymnasium_keys
from reachlab.jax_setup import jit
from reachlab.robots.kinematics.scalars import once
from reachlab.settings.config import RunConfig
from reachlab.sims.simulator import BatchArray
from reachlab.tasks.schema import Observed


class Now(NamedTuple):
    """Observation of episodes, and `[B]` each: success, steps, and what infos name beside, as `distance` [m].

    Where an orientation is asked for `angle` [rad] is among these, and where it is measured `wrench` `[B, 6]` [N, Nm].
    """

    observation: Observed
    success: BatchArray
    steps: BatchArray
    named: dict[str, BatchArray]


class Result(NamedTuple):
    """Result of a step.

    Attributes:
        now: after it; of the new episode, where one has begun in it.
        reward, terminated, truncated: `[B]`; nothing, where the step did no more than begin an episode.
        final: before episodes began anew in the step in which they ended; None where they do not.
    """

    now: Now
    reward: BatchArray
    terminated: BatchArray
    truncated: BatchArray
    final: Now | None = None


class EpisodeBatch:
    """Episodes under way in every environment of a batch; they begin anew as Gymnasium's autoreset mode says."""

    def __init__(self, env: Env, mode: AutoresetMode, *, in_numpy: bool) -> None:
        """Batch of an environment's episodes; it gives NumPy arrays of their own, or JAX arrays.

        Compiled programs are shared with batches that are settled alike.
        """
        self._steps = _compiled(env.config, env.num_envs, mode) if env.traced else Steps(env, mode)
        self._in_numpy, self._held = in_numpy, self._steps.nothing

    @property
    def state(self) -> EnvState:
        """State of the environment, after the first reset."""
        return self._steps.held.in_jax(self._held)[0]

    def reset(self, seeds: np.ndarray, seeded: np.ndarray, mask: np.ndarray, goal: Goal | None = None) -> Now:
        """Begin new episodes in the environments of `mask [B]`; the first time these are all.

        Those that are `seeded [B]` begin the first episode of their seed, `seeds [B]` uint32, the others the next one,
        all of them with the `goal` if one is given.
        """
        self._held, now = self._steps.reset(self._held, seeds, seeded, mask, goal)
        return self._steps.now.taken(now, in_numpy=self._in_numpy)

    def step(self, actions: BatchArray) -> Result:
        """Take a step with actions `[B, a]`, float32 and finite."""
        self._held, result = self._steps.step(self._held, actions)
        return self._steps.result.taken(result, in_numpy=self._in_numpy)


FEW, LEAST_FEW = 16, 64
"""Where at most one in 16 environments begin an episode, and that is 64 or more, nothing is computed for the others."""

Held = tuple[EnvState, Any]
"""Held state: the environment's, and whose episode ended in the last step `[B]`."""


class Steps:
    """Resets and steps of a batch, on the host where a simulator or a picture is.

    Attributes:
        nothing: what is held before the first reset.
        held, now, result: how that is handed over which is held, and which `reset` and `step` give.
    """

    held: Any = AsTheyAre()
    now = result = held

    def __init__(self, env: Env, mode: AutoresetMode) -> None:
        """Steps of an environment whose episodes begin anew as `mode` says."""
        self._env, self._mode = env, mode
        self.nothing: Any = (None, np.zeros(env.num_envs, bool))

    def reset(self, held: Any, seeds: BatchArray, seeded: BatchArray, mask: Any, goal: Goal | None) -> tuple[Held, Now]:
        """Held state and observation after new episodes began; see `EpisodeBatch.reset`."""
        (state, ended), keys = held, gymnasium_keys(seeds)
        if state is None:
            state = self._env.init(keys, goal)
        else:
            keys = jnp.where(seeded & mask, keys, state.key)
            state = self._env.reset(replace(state, key=keys), mask, goal=goal)
        return (state, ended & ~mask), self._begun(state)

    def step(self, held: Held, actions: BatchArray) -> tuple[Held, Result]:
        """Held state and result after actions."""
        before, ended = held
        # Computed as it is by itself: to the same bits.
        state, done = (
            once(self._env.step(once(before), actions)) if self._env.traced else self._env.step(before, actions)
        )
        seen = self._env.observe_now(state) if done.observation is None else done.observation
        now = self._now(state, seen, done.terms["success"])
        result = Result(now, done.reward, done.terminated, done.truncated)
        if self._mode is AutoresetMode.SAME_STEP:
            state, begun = self._begin(done.done, state, now)
            result = result._replace(now=begun, final=now)
        elif self._mode is AutoresetMode.NEXT_STEP:
            state, now = self._begin(ended, state, now)
            goes_on = ~ended
            reward = jnp.where(ended, 0.0, done.reward)
            result = Result(now, reward, done.terminated & goes_on, done.truncated & goes_on)
        return (state, result.terminated | result.truncated), result

    def _begin(self, mask: Any, state: EnvState, now: Now) -> tuple[EnvState, Now]:
        """State and what is observed where those of `mask [B]` begin new episodes: none, a few, or any number."""
        most = len(mask) // FEW

        def few() -> tuple[EnvState, Now]:
            index = jnp.nonzero(mask, size=most, fill_value=len(mask))[0]
            begun = self._env.reset(jax.tree.map(lambda x: x[index], state), jnp.ones(most, bool))
            return jax.tree.map(lambda old, new: old.at[index].set(new), (state, now), (begun, self._begun(begun)))

        def any_number() -> tuple[EnvState, Now]:
            begun = self._env.reset(state, mask)
            return begun, EnvFunctions.merge(mask, self._begun(begun, mask), now, jnp if self._env.traced else np)

        if not self._env.traced:
            mask = np.asarray(mask)
            return any_number() if mask.any() else (state, now)
        if most < LEAST_FEW:
            return jax.lax.cond(mask.any(), any_number, lambda: (state, now))
        count = mask.sum()
        cases = (lambda: (state, now)), few, any_number
        return jax.lax.switch((count > 0).astype(int) + (count > most), cases)

    def _begun(self, state: EnvState, mask: np.ndarray | None = None) -> Now:
        """Observation of episodes that begin; of pictures those of the environments of `mask [B]`."""
        seen = self._env.observe(state) if self._env.traced else self._env.observe_now(state, mask)
        return self._now(state, seen, jnp.zeros(len(state.clock), bool))

    def _now(self, state: EnvState, seen: Observed, success: BatchArray) -> Now:
        wrench = {} if state.arm.wrench is None else {"wrench": state.arm.wrench}
        return Now(seen, success, state.clock, named_errors(self._env.setup, state.errors) | wrench)


class Programs(Steps):
    """Resets and steps that are one compiled program each; what they take and give is packed, but for arguments."""

    def __init__(self, env: Env, mode: AutoresetMode) -> None:
        """Programs of an environment, compiled as they are first called."""
        super().__init__(env, mode)
        actions = np.zeros((env.num_envs, len(env.action_bounds[0])), np.float32)
        held = jax.eval_shape(env.init, env_keys(0, env.num_envs)), self.nothing[1]
        packing = functools.partial(make_packing, num_envs=env.num_envs)
        self.held, self.now = packing(held), packing(jax.eval_shape(self._begun, held[0]))
        self.result = packing(jax.eval_shape(super().step, held, actions)[1])
        self.nothing = self.held.zeros
        self.reset = jit(functools.partial(self._packed, super().reset, self.now))
        self.step = jit(functools.partial(self._packed, super().step, self.result))

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Itself: it holds nothing that changes."""
        del memo
        return self

    def _packed(self, function: Callable[..., Any], packing: Any, packed: Any, *arguments: Any) -> Any:
        held, result = function(self.held.unpack(packed), *arguments)
        return self.held.pack(held), packing.pack(result)


@functools.lru_cache(maxsize=16)
def _compiled(config: RunConfig, num_envs: int, mode: AutoresetMode) -> Programs:
    return Programs(Env(config, num_envs), mode)
