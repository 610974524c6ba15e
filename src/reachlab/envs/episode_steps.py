"""Resets and steps of a batch of episodes: traced as a whole, or on the host, around a simulator."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.vector import AutoresetMode
from jax import Array

from reachlab.control.situation import Goal
from reachlab.envs.ahead import begin_ahead, known_ahead, moved_like, no_actions
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition, named_errors
from reachlab.envs.packing import AsTheyAre, PackedResults
from reachlab.envs.random_streams import gymnasium_keys, keys_of_seeded
from reachlab.robots.kinematics.scalars import once
from reachlab.sims.simulator import BatchArray, Moved, chosen
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


FEW, LEAST_FEW = 16, 64
"""Where at most one in 16 environments begin an episode, and that is 64 or more, nothing is computed for the others."""


class Steps:
    """Resets and steps of a batch, on the host where a simulator or a picture is.

    Attributes:
        nothing: what is held before the first reset.
        now, result: how that is handed over which `reset` and `step` give.
    """

    now: Any = AsTheyAre()
    result = now

    def __init__(self, env: Env, mode: AutoresetMode) -> None:
        """Steps of an environment whose episodes begin anew as `mode` says."""
        self._env, self._mode = env, mode
        self.nothing: Any = (None, np.zeros(env.num_envs, bool))

    def state(self, held: Any) -> EnvState:
        """State of the environment, of what is held."""
        return self._as_state(held[0])

    def reset(self, held: Any, seeds: BatchArray, seeded: BatchArray, mask: Any, goal: Goal | None) -> tuple[Any, Now]:
        """What is held and observed after new episodes began; see `EpisodeBatch.reset`."""
        state, ended = held
        if state is None:
            self.ahead()
            state = self._env.init(gymnasium_keys(seeds), goal)
        else:
            state = self._as_state(state)
            keys = keys_of_seeded(seeds, seeded & mask, state.key)
            state = self._env.reset(replace(state, key=keys), mask, goal=goal)
        return (self._as_held(state), ended & ~mask), self._begun(state)

    def ahead(self) -> None:
        """Begin to compile what is needed, where that is not one program."""

    def step(self, held: Any, actions: BatchArray) -> tuple[Any, Result]:
        """What is held, and the result, after actions."""
        before, ended = held
        state, result = self._stepped(before, actions)
        if self._mode is AutoresetMode.SAME_STEP:
            final = result.now
            state, begun = self._begin(result.terminated | result.truncated, state, final)
            result = result._replace(now=begun, final=final)
        elif self._mode is AutoresetMode.NEXT_STEP:
            state, now = self._begin(ended, state, result.now)
            goes_on = ~ended
            reward = self._xp.where(ended, self._xp.float32(0.0), result.reward)
            result = Result(now, reward, result.terminated & goes_on, result.truncated & goes_on)
        return (state, result.terminated | result.truncated), result

    @property
    def _xp(self) -> Any:
        return jnp if self._env.traced else np

    def _stepped(self, before: Any, actions: BatchArray) -> tuple[Any, Result]:
        # Computed as it is by itself: to the same bits.
        state, done = (
            once(self._env.step(once(before), actions)) if self._env.traced else self._env.step(before, actions)
        )
        return state, self._result(state, done)

    def _result(self, state: EnvState, done: Transition) -> Result:
        seen = self._env.observe_now(state) if done.observation is None else done.observation
        now = self._now(state, seen, done.terms["success"])
        return Result(now, done.reward, done.terminated, done.truncated)

    def _as_state(self, state: Any) -> EnvState:
        return state

    def _as_held(self, state: EnvState) -> Any:
        return state

    def _begin(self, mask: Any, state: Any, now: Now) -> tuple[Any, Now]:
        """State and what is observed where those of `mask [B]` begin new episodes: none, a few, or any number."""
        most = len(mask) // FEW

        def few() -> tuple[EnvState, Now]:
            index = jnp.nonzero(mask, size=most, fill_value=len(mask))[0]
            begun = self._env.reset(jax.tree.map(lambda x: x[index], state), jnp.ones(most, bool))
            return jax.tree.map(lambda old, new: old.at[index].set(new), (state, now), (begun, self._begun(begun)))

        def any_number() -> tuple[Any, Now]:
            begun = self._env.reset(self._as_state(state), mask)
            return self._as_held(begun), chosen(mask, self._begun(begun, mask), now)

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
        return self._now(state, seen, self._xp.zeros(len(state.clock), bool))

    def _now(self, state: EnvState, seen: Observed, success: BatchArray) -> Now:
        wrench = {} if state.arm.wrench is None else {"wrench": state.arm.wrench}
        return Now(seen, success, state.clock, named_errors(self._env.setup, state.errors) | wrench)


class HostSteps(Steps):
    """Steps around a simulator that JAX cannot trace: one program before the simulator's step, and one after it.

    What they give each other is packed: for a few environments it takes longer to hand arrays over than to compute.
    """

    def __init__(self, env: Env, mode: AutoresetMode) -> None:
        """Steps of an environment without pictures, whose programs are compiled as they are first called."""
        super().__init__(env, mode)
        self._pack, self._before, self._after = (
            PackedResults(function, env.num_envs) for function in (self._states, self._commands, self._judgements)
        )

    def ahead(self) -> None:
        """See `Steps.ahead`: all programs at once, where it is known what the simulator gives."""
        if known_ahead(self._env) and not self._pack.packings:
            state = begin_ahead(self._env)
            (packed,) = self._pack.ahead(state)
            (given,) = self._before.ahead(packed, no_actions(self._env))
            self._after.ahead(packed, given, moved_like(state.arm))

    def _as_state(self, state: Any) -> EnvState:
        packed, engine = state
        opened = self._pack.packings[0].in_jax(packed)
        return replace(opened, arm=replace(opened.arm, engine=engine))

    def _as_held(self, state: EnvState) -> Any:
        return self._pack(state.apart)[0], state.arm.engine

    def _stepped(self, before: Any, actions: BatchArray) -> tuple[Any, Result]:
        packed, engine = before
        (given,) = self._before(packed, actions)
        arm, (_, command, _) = self._before.packings[0].taken(given, in_numpy=True)
        moved = self._env.simulator.step(replace(arm, engine=engine), command)
        packed, result = self._after(packed, given, moved._replace(engine=None))
        return (packed, moved.engine), self._after.packings[1].taken(result, in_numpy=True)

    def _states(self, state: EnvState) -> tuple[EnvState]:
        return (state,)

    def _commands(self, packed: Any, actions: Array) -> Any:
        state = once(self._pack.packings[0].unpack(packed))
        return ((state.arm, self._env.functions.command(state, actions, None)),)

    def _judgements(self, packed: Any, given: Any, moved: Moved) -> tuple[EnvState, Result]:
        state = self._pack.packings[0].unpack(packed)
        _, (taken, command, motion) = self._before.packings[0].unpack(given)
        state, moved, command, taken, motion = once((state, moved, command, taken, motion))
        after, transition = once(self._env.functions.judge(state, moved, command, taken, motion))
        return after, self._result(after, transition)
