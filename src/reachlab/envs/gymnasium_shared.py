"""Shared by both interfaces of Gymnasium: a batch of episodes under way, spaces, and checks of what is handed in."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Space
from gymnasium.vector import AutoresetMode

from reachlab.control.situation import Goal
from reachlab.envs.core import Env
from reachlab.envs.episode_batch import EpisodeBatch
from reachlab.envs.episode_steps import Now, Result
from reachlab.envs.functions import EnvState
from reachlab.envs.given_goal import goal_at, make_place
from reachlab.envs.setup import configure_env
from reachlab.jax_setup import refuse_fork
from reachlab.settings.json_form import to_json
from reachlab.settings.validation import LAST_SEED, InputError, choose, whole_number
from reachlab.tasks.schema import Schema
from reachlab.tasks.task import Bounds

RENDER_MODES = ("rgb_array",)

METADATA: dict[str, Any] = {"render_modes": list(RENDER_MODES)}


class Episodes:
    """Episodes of a task preset under way in a batch of environments, whose actions are checked."""

    def __init__(
        self, num_envs: int, task: str, settings: dict[str, Any], mode: AutoresetMode, *, in_numpy: bool = True
    ) -> None:
        """Episodes of a preset with the settings changed, which begin anew as `mode` says.

        Raises:
            InputError: a setting that does not exist, or a value that is not allowed.
        """
        self.env = Env(configure_env(task, **settings), num_envs)
        self._batch, self._begun, self._closed = EpisodeBatch(self.env, mode, in_numpy=in_numpy), False, False
        self._shape = (self.env.num_envs, len(self.env.action_bounds[0]))
        self._place = make_place(self.env.setup)

    @property
    def state(self) -> EnvState:
        """State of the episodes under way.

        Raises:
            InputError: none has begun.
        """
        self._need_episodes()
        return self._batch.state

    def _need_episodes(self) -> None:
        self._need_open()
        if not self._begun:
            raise InputError("the environment has no episode yet: call reset first.")

    def _need_open(self) -> None:
        if self._closed:
            raise InputError("the environment is closed: make another.")

    def goal_at(self, target: Any) -> Goal:
        """Goal at a target that was asked for.

        Raises:
            InputError: see `placing.goal_at`.
        """
        return goal_at(self.env.setup, target, self._place)

    def reset(
        self, seeds: Sequence[int | None], mask: np.ndarray, random: np.random.Generator, goal: Goal | None = None
    ) -> Now:
        """Begin new episodes in the environments of `mask [B]`: seeded, or the next of the environment's own stream.

        They are of the `goal`, if one is given.

        Raises:
            InputError: the environment is closed.
        """
        refuse_fork()
        self._need_open()
        seeded = np.array([seed is not None or not self._begun for seed in seeds])
        numbers = [int(random.integers(LAST_SEED + 1)) if seed is None else seed for seed in seeds]
        mask = mask if self._begun else np.ones_like(mask)
        now = self._batch.reset(np.array(numbers, np.uint32), seeded, mask, goal)
        self._begun = True
        return now

    def step(self, actions: Any) -> Result:
        """Result of actions `[B, a]`.

        Raises:
            InputError: an action is misshapen or not finite, or no episode has begun; nothing has moved.
        """
        refuse_fork()
        self._need_episodes()
        return self._batch.step(checked_actions(actions, self._shape))

    def render(self, index: int) -> np.ndarray:
        """Picture of one environment."""
        return self.env.render(self.state, index)

    def close(self) -> None:
        """Close the simulator; no step or reset follows."""
        self._closed = True
        self.env.close()


def infos(now: Now) -> dict[str, Any]:
    """Infos `[B]` by name: `is_success`, `distance` [m], `elapsed_steps`, and `angle` [rad] where one is asked for.

    Where it is measured also `wrench` `[B, 6]` [N, Nm].
    """
    return {"is_success": now.success, **now.named, "elapsed_steps": now.steps}


def checked_options(options: dict[str, Any] | None, known: Sequence[str]) -> dict[str, Any]:
    """Options of `reset`.

    Raises:
        InputError: they are no dict, or one is not among the `known`.
    """
    if not isinstance(options, dict | None):
        raise InputError(f"options of reset must be a dict, got {reprlib.repr(options)}.")
    return {choose("option of reset", name, known): value for name, value in (options or {}).items()}


def checked_seed(seed: Any) -> int | None:
    """A seed of Gymnasium, None for none.

    Raises:
        InputError: it is no whole number within the limits.
    """
    return None if seed is None else whole_number("seed", seed, 0, LAST_SEED)


def checked_seeds(seed: Any, num_envs: int) -> list[int | None]:
    """Seed of each environment: from one number on, after the last the first, or each its own.

    Raises:
        InputError: one is no whole number within the limits, or there are more or less than environments.
    """
    if isinstance(seed, Sequence | np.ndarray) and np.ndim(seed) and not isinstance(seed, str):
        if len(seed) != num_envs:
            raise InputError(f"seed must be one number or {num_envs} of them, got {len(seed)}.")
        return [checked_seed(one) for one in seed]
    first = checked_seed(seed)
    return [None if first is None else (first + i) % (LAST_SEED + 1) for i in range(num_envs)]


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


SETTINGS = "reachlab"
"""Attribute of action spaces: their environment's settings as plain data. What saves spaces with a policy, as
Stable-Baselines3 does, thereby saves what the policy was trained on."""


def action_space(env: Env) -> Box:
    """Box of an environment's actions."""
    space = box(env.action_bounds)
    setattr(space, SETTINGS, to_json(env.config))
    return space


def box(bounds: Bounds) -> Box:
    """Box of lower and upper bounds."""
    low, high = bounds
    return Box(low, high, dtype=low.dtype.type)


def single(observation: Any, index: int) -> Any:
    """Observation of one environment of a batch."""
    if isinstance(observation, dict):
        return {name: part[index] for name, part in observation.items()}
    return observation[index]


def checked_actions(given: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Actions as float32; arrays of JAX and PyTorch on the CPU are not copied.

    Raises:
        InputError: another shape, or a number that is not finite; names environment and index.
    """
    try:
        actions = np.asarray(given)
    except ValueError:
        raise _misshapen("a ragged one", shape) from None
    if actions.shape == shape[1:]:
        raise InputError(f"action must have shape {shape}, a row for each environment, got {actions.shape}.")
    if actions.shape != shape:
        raise _misshapen(str(actions.shape[1:] if actions.shape[:1] == (1,) == shape[:1] else actions.shape), shape)
    if actions.dtype != np.float32:
        if actions.dtype.kind not in "fiub":
            raise InputError(f"action must be numbers, got {actions.dtype}.")
        with np.errstate(over="ignore"):
            actions = actions.astype(np.float32)
    if not np.isfinite(actions).all():
        env, index = (int(i) for i in np.argwhere(~np.isfinite(actions))[0])
        raise InputError(f"action of environment {env} is {actions[env, index]} at index {index}: it must be finite.")
    return actions


def _misshapen(got: str, shape: tuple[int, ...]) -> InputError:
    where = f" in each of {shape[0]} environments" if shape[0] > 1 else ""
    return InputError(f"action must have shape {shape[1:]}{where}, got {got}.")
