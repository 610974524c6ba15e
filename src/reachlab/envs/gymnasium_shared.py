"""What both Gymnasium faces share: a batch of episodes under way, spaces, and checks of what is handed in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import Box, Dict, Space
from numpy.typing import ArrayLike

from reachlab.envs.core import Env, merge
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.random_streams import gymnasium_keys
from reachlab.envs.setup import check
from reachlab.jax_setup import refuse_fork
from reachlab.settings.presets import configure
from reachlab.settings.validation import InputError, choose
from reachlab.tasks.observations import Schema
from reachlab.tasks.task import Bounds

LARGEST_SEED = 2**32
"""Seeds are taken modulo this."""

RENDER_MODES = ("rgb_array",)

METADATA: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 30}


class EpisodeBatch:
    """Compiled functions of an environment, and their state."""

    def __init__(self, num_envs: int, task: str, settings: dict[str, Any]) -> None:
        """Batch of environments of a task preset, with the settings changed.

        Raises:
            InputError: a setting that does not exist, or a value that is not allowed.
        """
        if num_envs < 1:
            raise InputError(f"num_envs must be at least 1, got {num_envs}.")
        # What varies in the training that a preset describes does not vary here, unless it is asked for.
        config = configure(task, **{"randomise": (), **settings})
        check(config)
        self.env = Env(config, num_envs)
        self._state: EnvState | None = None
        compiled = self.env.compile_whole
        self._init, self._step, self._reset = map(compiled, (self.env.init, self.env.step, self.env.reset))

    @property
    def state(self) -> EnvState:
        """State of the episodes under way.

        Raises:
            InputError: none has begun.
        """
        if self._state is None:
            raise InputError("the environment has no episode yet: call reset first.")
        return self._state

    @property
    def distance(self) -> np.ndarray:
        """Tool to goal now `[B]` [m]."""
        return np.array(self.state.distance)

    def reset(self, seeds: Sequence[int | None], mask: np.ndarray, random: np.random.Generator) -> None:
        """Begin new episodes in the environments of `mask [B]`: seeded, or the next of the environment's own stream."""
        refuse_fork()
        seeded = np.array([seed is not None or self._state is None for seed in seeds])
        numbers = [int(random.integers(LARGEST_SEED)) if seed is None else seed % LARGEST_SEED for seed in seeds]
        keys = gymnasium_keys(np.array(numbers, np.uint32))
        if self._state is None:
            self._state = self._init(keys)
        else:
            key = jnp.where(seeded & mask, keys, self._state.key)
            self._state = self._reset(replace(self._state, key=key), mask)

    def restart(self, mask: np.ndarray) -> None:
        """Begin new episodes in the environments of `mask [B]`."""
        self._state = self._reset(self.state, mask)

    def step(self, actions: ArrayLike) -> Transition:
        """Transition of all environments, whose actions are checked first."""
        refuse_fork()
        state = self.state
        self._state, transition = self._step(state, _checked_actions(actions, state.last_action.shape))
        return transition

    def observe(self) -> Any:
        """Observations of the present state, in memory of their own."""
        return copied(self.env.observe_now(self.state))

    def observe_some(self, mask: np.ndarray, others: Any) -> Any:
        """Observations of the present state in the environments of `mask [B]`, and `others` elsewhere."""
        return merge(mask, self.env.observe_now(self.state, mask), others)

    def observe_step(self, transition: Transition) -> Any:
        """Observations after a step, in memory of their own."""
        return self.observe() if transition.observation is None else copied(transition.observation)

    def render(self, index: int) -> np.ndarray:
        """Picture of one environment."""
        return self.env.render(self.state, index)


def checked_render_mode(mode: str | None) -> str | None:
    """The render mode.

    Raises:
        InputError: there is none of that name.
    """
    return None if mode is None else choose("render mode", mode, RENDER_MODES)


def observation_space(schema: Schema) -> Space[Any]:
    """Space of the observations that a schema describes."""
    low, high = schema.bounds
    return Dict({name: box((low[name], high[name])) for name in low}) if isinstance(low, dict) else box((low, high))


def box(bounds: Bounds) -> Box:
    """Box of lower and upper bounds."""
    low, high = bounds
    return Box(low, high, dtype=low.dtype.type)


def copied(observation: Any) -> Any:
    """Observation as NumPy arrays of its own."""
    return jax.tree.map(np.array, observation)


def single(observation: Any, index: int) -> Any:
    """Observation of one environment of a batch, in memory of its own."""
    return jax.tree.map(lambda x: np.array(x[index]), observation)


def _checked_actions(given: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Actions as float32.

    Raises:
        InputError: another shape, or a number that is not finite; names environment and index.
    """
    wanted = f"action must have shape {shape[1:]} in each of {shape[0]} environments"
    try:
        actions = np.asarray(given)
    except ValueError:
        raise InputError(f"{wanted}, got a ragged one.") from None
    if actions.shape != shape:
        raise InputError(f"{wanted}, got {actions.shape}.")
    if actions.dtype.kind not in "fiub":
        raise InputError(f"action must be numbers, got {actions.dtype}.")
    with np.errstate(over="ignore"):
        actions = actions.astype(np.float32)
    if not np.isfinite(actions).all():
        env, index = (int(i) for i in np.argwhere(~np.isfinite(actions))[0])
        raise InputError(f"action of environment {env} is {actions[env, index]} at index {index}: it must be finite.")
    return actions
