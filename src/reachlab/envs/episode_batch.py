"""A batch of episodes under way, as the interfaces of other libraries step it: one call a step, resets included."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, Protocol, Self

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode
from jax import Array

from reachlab.envs.core import Env, merge
from reachlab.envs.functions import EnvState, Stepped, Transition
from reachlab.envs.packing import Apart, Packed, make_packing
from reachlab.envs.random_streams import env_keys, gymnasium_keys
from reachlab.jax_setup import jit
from reachlab.robots.scalar_algebra import once
from reachlab.settings.config import RunConfig
from reachlab.sims import BatchArray
from reachlab.tasks.schema import Observed
from reachlab.tasks.task import Goal


class Now(NamedTuple):
    """What is observed of episodes and told of them: observations, and `[B]` each success, distance [m] and steps.

    Where an orientation is asked for, the angle [rad] too.
    """

    observation: Observed
    success: BatchArray
    distance: BatchArray
    steps: BatchArray
    angle: BatchArray | None = None


class Result(NamedTuple):
    """What a step led to.

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


class EpisodeBatch(Protocol):
    """Episodes under way in every environment of a batch."""

    @property
    def state(self) -> EnvState:
        """State of the environment, after the first reset."""
        ...

    def reset(self, seeds: np.ndarray, seeded: np.ndarray, mask: np.ndarray, goal: Goal | None = None) -> Now:
        """Begin new episodes in the environments of `mask [B]`; the first time these are all.

        Those that are `seeded [B]` begin the first episode of their seed, `seeds [B]` uint32, the others the next one,
        all of them with the `goal` if one is given.
        """
        ...

    def step(self, actions: BatchArray) -> Result:
        """Take a step with actions `[B, a]`, float32 and finite."""
        ...


def make_batch(env: Env, mode: AutoresetMode, *, in_numpy: bool) -> EpisodeBatch:
    """Batch of an environment's episodes, which begin anew as Gymnasium's autoreset mode says.

    It gives NumPy arrays of their own, or JAX arrays.
    """
    return TracedBatch(env, mode, in_numpy) if env.traced else HostBatch(env, mode, in_numpy)


FEW, LEAST_FEW = 16, 64
"""Where at most one in 16 environments begin an episode, and that is 64 or more, nothing is computed for the others."""

# --- where everything is traced -------------------------------------------------------------------


class TracedBatch:
    """A batch whose step is one compiled program."""

    def __init__(self, env: Env, mode: AutoresetMode, in_numpy: bool) -> None:
        """Batch of an environment's episodes; programs are shared with those that are settled alike."""
        self._programs, self._in_numpy = _programs(env.config, env.num_envs, mode), in_numpy
        self._state = self._programs.state.nothing()

    @property
    def state(self) -> EnvState:
        """See `EpisodeBatch.state`."""
        return self._programs.state.taken(self._state, in_numpy=False)[0]

    def reset(self, seeds: np.ndarray, seeded: np.ndarray, mask: np.ndarray, goal: Goal | None = None) -> Now:
        """See `EpisodeBatch.reset`."""
        self._state, now = self._programs.reset(self._state, seeds, seeded, mask, goal)
        return self._programs.now.taken(now, self._in_numpy)

    def step(self, actions: BatchArray) -> Result:
        """See `EpisodeBatch.step`."""
        self._state, result = self._programs.step(self._state, actions)
        return self._programs.result.taken(result, self._in_numpy)


@functools.lru_cache(maxsize=16)
def _programs(config: RunConfig, num_envs: int, mode: AutoresetMode) -> Programs:
    return Programs(Env(config, num_envs), mode)


class Programs:
    """Compiled programs of a batch; what they take and give is packed, all but seeds, masks and actions.

    Attributes:
        state: how the environment's state is packed, and whose episode ended in the last step.
        now, result: how that is packed which `reset` and `step` give.
        reset: packed state and `Now`, of packed state, seeds, `seeded`, a mask and a goal, see `EpisodeBatch.reset`.
        step: packed state and `Result`, of packed state and actions.
    """

    def __init__(self, env: Env, mode: AutoresetMode) -> None:
        """Programs of an environment, compiled as they are first called."""
        self._env = env
        stepped = {
            AutoresetMode.DISABLED: self._step_alone,
            AutoresetMode.NEXT_STEP: self._step_after_begin,
            AutoresetMode.SAME_STEP: self._step_and_begin,
        }[mode]
        ended = np.zeros(env.num_envs, bool)
        actions = np.zeros((env.num_envs, len(env.action_bounds[0])), np.float32)
        state = jax.eval_shape(env.init, env_keys(0, env.num_envs)), ended
        packing = functools.partial(make_packing, num_envs=env.num_envs)
        self.state = packing(state)
        self.now = packing(jax.eval_shape(self._now, state[0]))
        self.result = packing(jax.eval_shape(stepped, *state, actions)[1])
        self.reset = jit(functools.partial(self._packed, self._reset, self.now))
        self.step = jit(functools.partial(self._packed, stepped, self.result))

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Itself: it holds nothing that changes."""
        del memo
        return self

    def _packed(self, function: Callable[..., Any], packing: Packed | Apart, packed: Any, *arguments: Array) -> Any:
        """Packed state and result of a function of a state, whose episodes ended, and other arguments."""
        state, result = function(*self.state.unpack(packed), *arguments)
        return self.state.pack(state), packing.pack(result)

    def _reset(self, state: EnvState, ended: Array, seeds: Array, seeded: Array, mask: Array, goal: Goal | None) -> Any:
        keys = jnp.where(seeded & mask, gymnasium_keys(seeds), state.key)
        state = self._env.reset(replace(state, key=keys), mask, goal=goal)
        return (state, ended & ~mask), self._now(state)

    def _step(self, state: EnvState, actions: Array) -> Stepped:
        """The environment's step, computed as it is by itself: to the same bits."""
        return once(self._env.step(once(state), actions))

    def _step_alone(self, state: EnvState, ended: Array, actions: Array) -> Any:
        del ended
        state, done = self._step(state, actions)
        return (state, done.done), _result(state, done, done.observation)

    def _step_after_begin(self, state: EnvState, begun: Array, actions: Array) -> Any:
        stepped, done = self._step(state, actions)
        state, now = self._begin(begun, stepped, _result(stepped, done, done.observation).now)
        reward = jnp.where(begun, 0.0, done.reward)
        terminated, truncated = done.terminated & ~begun, done.truncated & ~begun
        return (state, terminated | truncated), Result(now, reward, terminated, truncated)

    def _step_and_begin(self, state: EnvState, ended: Array, actions: Array) -> Any:
        del ended
        stepped, done = self._step(state, actions)
        result = _result(stepped, done, done.observation)
        state, now = self._begin(done.done, stepped, result.now)
        return (state, done.done), result._replace(now=now, final=result.now)

    def _begin(self, mask: Array, state: EnvState, now: Now) -> tuple[EnvState, Now]:
        """State and what is observed where those of `mask [B]` begin new episodes: none, a few, or any number."""
        most = len(mask) // FEW

        def few() -> tuple[EnvState, Now]:
            index = jnp.nonzero(mask, size=most, fill_value=len(mask))[0]
            begun = self._env.reset(jax.tree.map(lambda x: x[index], state), jnp.ones(most, bool))
            return jax.tree.map(lambda old, new: old.at[index].set(new), (state, now), (begun, self._now(begun)))

        def any_number() -> tuple[EnvState, Now]:
            begun = self._env.reset(state, mask)
            return begun, jax.tree.map(functools.partial(_pick, mask), self._now(begun), now)

        if most < LEAST_FEW:
            return jax.lax.cond(mask.any(), any_number, lambda: (state, now))
        count = mask.sum()
        cases = (lambda: (state, now)), few, any_number
        return jax.lax.switch((count > 0).astype(int) + (count > most), cases)

    def _now(self, state: EnvState) -> Now:
        """What is observed of episodes that begin."""
        return _now(state, self._env.observe(state), jnp.zeros(len(state.distance), bool))


def _pick(mask: Array, new: Array, old: Array) -> Array:
    return jnp.where(mask.reshape(mask.shape + (1,) * (new.ndim - 1)), new, old)


# --- where a simulator or a picture is on the host ------------------------------------------------


class HostBatch:
    """A batch whose steps the environment takes on the host."""

    def __init__(self, env: Env, mode: AutoresetMode, in_numpy: bool) -> None:
        """Batch of an environment's episodes."""
        self._env, self._mode = env, mode
        self._array: Any = np.array if in_numpy else jnp.asarray
        self._ended = np.zeros(env.num_envs, bool)
        self._state: EnvState | None = None

    @property
    def state(self) -> EnvState:
        """See `EpisodeBatch.state`."""
        assert self._state is not None, "reset comes first"  # noqa: S101
        return self._state

    def reset(self, seeds: np.ndarray, seeded: np.ndarray, mask: np.ndarray, goal: Goal | None = None) -> Now:
        """See `EpisodeBatch.reset`."""
        keys = gymnasium_keys(seeds)
        if self._state is None:
            self._state = self._env.init(keys, goal)
        else:
            keys = jnp.where(seeded & mask, keys, self._state.key)
            self._state = self._env.reset(replace(self._state, key=keys), mask, goal=goal)
        self._ended = self._ended & ~mask
        return jax.tree.map(self._array, self._now())

    def step(self, actions: BatchArray) -> Result:
        """See `EpisodeBatch.step`."""
        return jax.tree.map(self._array, self._step(actions))

    def _step(self, actions: BatchArray) -> Result:
        begun = self._ended if self._mode is AutoresetMode.NEXT_STEP else np.zeros_like(self._ended)
        self._state, done = self._env.step(self.state, actions)
        if begun.any():
            self._state = self._env.reset(self._state, begun)
            self._ended = np.asarray(done.done) & ~begun
            now = self._now()._replace(success=np.asarray(done.terms["success"]) & ~begun)
            terminated, truncated = (np.asarray(end) & ~begun for end in (done.terminated, done.truncated))
            return Result(now, np.where(begun, 0.0, done.reward), terminated, truncated)
        self._ended = np.asarray(done.done)
        seen = self._env.observe_now(self._state) if done.observation is None else done.observation
        result = _result(self._state, done, seen)
        if self._mode is not AutoresetMode.SAME_STEP:
            return result
        now = self._begun(self._ended, result.now) if self._ended.any() else result.now
        return result._replace(now=now, final=result.now)

    def _begun(self, mask: np.ndarray, now: Now) -> Now:
        """What is observed once those of `mask [B]` have begun new episodes."""
        self._state = self._env.reset(self.state, mask)
        observation = merge(mask, self._env.observe_now(self._state, mask), now.observation)
        return _now(self._state, observation, np.asarray(now.success) & ~mask)

    def _now(self) -> Now:
        """What is observed of episodes that begin."""
        state, success = self.state, np.zeros(self._env.num_envs, bool)
        return _now(state, self._env.observe_now(state), success)


def _result(state: EnvState, done: Transition, seen: Observed) -> Result:
    """Result of a step to a state after which nothing begins anew."""
    return Result(_now(state, seen, done.terms["success"]), done.reward, done.terminated, done.truncated)


def _now(state: EnvState, seen: Observed, success: BatchArray) -> Now:
    """What is observed of a state and told of it."""
    return Now(seen, success, state.distance, state.clock, state.progress.angle)
