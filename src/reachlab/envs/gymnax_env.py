"""Gymnax's interface to an environment: one episode at a time, as functions that JAX can trace."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct  # pyright: ignore[reportMissingImports]
from gymnax.environments import environment, spaces  # pyright: ignore[reportMissingImports]
from jax import Array

from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, named_errors
from reachlab.envs.setup import configure_env
from reachlab.settings.validation import InputError


@struct.dataclass
class GymnaxState(environment.EnvState):
    """An episode under way.

    Attributes:
        time: steps since the reset.
        episode: the environment's own state, of a batch of one without its axis.
        terminated: the task ended the episode.
        truncated: its clock did.
    """

    episode: EnvState
    terminated: Array
    truncated: Array


class GymnaxEnv(environment.Environment[GymnaxState, environment.EnvParams]):
    """One arm that has to reach a target.

    `info` holds `is_success`, `distance` [m] and, where an orientation is asked for, `angle` [rad]. An episode is no
    longer than the setting `max_steps`; `max_steps_in_episode` of the parameters can make it shorter.
    """

    def __init__(self, task: str = "tutorial", **settings: Any) -> None:
        """Environment of a task preset, with any field of the configuration as a keyword.

        Raises:
            InputError: a task or setting that does not exist, a value that is not allowed, or what JAX cannot trace.
        """
        config = configure_env(task, **settings)
        self._env = Env(config, 1)
        if not self._env.traced:
            self._env.close()
            raise InputError(
                f"gymnax needs an environment that JAX can trace, got simulator {config.sim!r} with observation"
                f" {config.rules.observation!r}: choose sim='kinematic' and an observation without a picture."
            )

    @property
    def name(self) -> str:
        """Name of the environment."""
        return f"reachlab/{self._env.config.task}"

    @property
    def num_actions(self) -> int:
        """Numbers in an action."""
        return len(self._env.action_bounds[0])

    @property
    def default_params(self) -> environment.EnvParams:
        """Parameters with the task's own time limit."""
        return environment.EnvParams(max_steps_in_episode=self._env.config.rules.max_steps)

    def reset_env(self, key: Array, params: environment.EnvParams) -> tuple[Array, GymnaxState]:
        """First observation `[k]` of the episode that `key` stands for, and its state."""
        del params
        typed = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
        state = self._env.init((key if typed else jax.random.wrap_key_data(key))[None])
        no = jnp.zeros((), bool)
        return _single(self._env.observe(state)), GymnaxState(state.clock[0], _single(state), no, no)

    def step_env(
        self, key: Array, state: GymnaxState, action: int | float | Array, params: environment.EnvParams
    ) -> tuple[Array, GymnaxState, Array, Array, dict[Any, Any]]:
        """Result of an action `[a]`: observation `[k]`, state, reward, terminated, info; nothing in it is random."""
        del key, params
        if jnp.shape(action) != (wanted := (self.num_actions,)):
            raise InputError(f"action has shape {jnp.shape(action)}, and this environment takes {wanted}.")
        episode, done = self._env.step(_batch(state.episode), jnp.asarray(action)[None])
        episode, done = _single(episode), _single(done)
        info = {"is_success": done.terms["success"], **named_errors(self._env.setup, done.errors)}
        state = GymnaxState(episode.clock, episode, done.terminated, done.truncated)
        observation, state = self._apply_transition_gradient_policy(done.observation, state)
        return observation, state, done.reward, done.terminated, info

    def observe(
        self, key: Array, state: GymnaxState, action: int | float | Array | None, params: environment.EnvParams
    ) -> Array:
        """Observation `[k]` of a state."""
        del key, action, params
        return _single(self._env.observe(_batch(state.episode)))

    def is_terminated(self, state: GymnaxState, params: environment.EnvParams) -> Array:
        """Whether the task ended the episode."""
        del params
        return state.terminated

    def is_truncated(self, state: GymnaxState, params: environment.EnvParams) -> Array:
        """Whether the clock ended the episode, and not the task."""
        return state.truncated | (~state.terminated & (state.time >= params.max_steps_in_episode))

    def action_space(self, params: environment.EnvParams | None = None) -> spaces.Box:
        """Box of the actions `[a]`."""
        del params
        return _space(*self._env.action_bounds)

    def observation_space(self, params: environment.EnvParams | None = None) -> spaces.Space:
        """Box of the observations `[k]`, or a dict of boxes where they are in goal form."""
        del params
        return _space(*self._env.schema.bounds)


def _space(low: Any, high: Any) -> Any:
    if isinstance(low, dict):
        return spaces.Dict({name: _space(low[name], high[name]) for name in low})
    return spaces.Box(jnp.asarray(low), jnp.asarray(high), low.shape, low.dtype)


def _single(tree: Any) -> Any:
    return jax.tree.map(lambda x: x[0], tree)


def _batch(tree: Any) -> Any:
    return jax.tree.map(lambda x: x[None], tree)
