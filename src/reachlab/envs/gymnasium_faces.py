"""Gymnasium faces of the environment: one episode at a time, or a batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import Box, Dict, Space
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from reachlab.envs.core import Env, EnvState, Transition, merge
from reachlab.envs.settle import check
from reachlab.envs.streams import gymnasium_keys
from reachlab.jax_setup import refuse_fork
from reachlab.settings.config import RunConfig, configure
from reachlab.settings.validation import InputError, choose

LARGEST_SEED = 2**32
"""Seeds are taken modulo this."""

RENDER_MODES = ("rgb_array",)


class ReachEnv(gymnasium.Env[Any, np.ndarray]):
    """One arm that has to reach a target.

    `info` holds `is_success` and `distance` [m].
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": 30}  # noqa: RUF012 (Gymnasium's)

    def __init__(self, task: str = "tutorial", render_mode: str | None = None, **settings: Any) -> None:
        """Environment of a task preset, with any field of the configuration as a keyword.

        Raises:
            InputError: a task, setting or render mode that does not exist, or a value that is not allowed.
        """
        self.render_mode = _checked_render_mode(render_mode)
        self._lanes = _Lanes(_checked(configure(task, **settings)), 1)
        self.observation_space = _space(self._lanes.env.observation_bounds)
        self.action_space = _space(self._lanes.env.action_bounds)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """First observation of a new episode, and info; equal seeds give equal episodes from there on."""
        del options
        super().reset(seed=seed)
        self._lanes.reset([seed], None, self.np_random)
        return _lane(self._lanes.look(), 0), {"is_success": False, "distance": float(self._lanes.distance[0])}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """What an action led to: observation, reward, terminated, truncated, info.

        Raises:
            InputError: the action is misshapen or not finite; nothing has moved.
        """
        done = self._lanes.step([action])
        info = {"is_success": bool(done.terms["success"][0]), "distance": float(done.terms["distance"][0])}
        observation = _lane(self._lanes.look_after(done, np.zeros(1, bool)), 0)
        return observation, float(done.reward[0]), bool(done.terminated[0]), bool(done.truncated[0]), info

    def render(self) -> np.ndarray | None:
        """Picture of the arm, `[height, width, 3]` uint8, in render mode `rgb_array`."""
        return self._lanes.render(0) if self.render_mode == "rgb_array" else None

    @property
    def state(self) -> EnvState:
        """State of the episode under way, in a batch of one.

        Raises:
            InputError: none has begun.
        """
        return self._lanes.state

    def close(self) -> None:
        """Close the simulator."""
        self._lanes.env.close()


class ReachVectorEnv(VectorEnv[Any, np.ndarray, np.ndarray]):
    """A batch of arms, stepped together; lane i of seed s is `ReachEnv` with seed s + i."""

    def __init__(
        self,
        num_envs: int = 1,
        task: str = "tutorial",
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **settings: Any,
    ) -> None:
        """Batch of environments; settings as for `ReachEnv`.

        Raises:
            InputError: see `ReachEnv`; or an autoreset mode that does not exist.
        """
        modes = {mode.value: mode for mode in AutoresetMode}
        mode = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        self._mode = modes[choose("autoreset mode", mode, modes)]
        self.render_mode = _checked_render_mode(render_mode)
        self.metadata = {**ReachEnv.metadata, "autoreset_mode": self._mode}
        self.num_envs = num_envs
        self._lanes = _Lanes(_checked(configure(task, **settings)), num_envs)
        self.single_observation_space = _space(self._lanes.env.observation_bounds)
        self.single_action_space = _space(self._lanes.env.action_bounds)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Observations `[B, k]` and info; `options["reset_mask"] [B]` picks the lanes that begin anew."""
        super().reset(seed=seed if isinstance(seed, int) else None)
        seeds = (
            [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else list(seed or [None] * self.num_envs)
        )
        if len(seeds) != self.num_envs:
            raise InputError(f"seed must be one number or {self.num_envs} of them, got {len(seeds)}.")
        mask = self._checked_mask(options)
        self._lanes.reset(seeds, mask, self.np_random)
        self._ended = self._ended & ~mask
        info = {"is_success": np.zeros(self.num_envs, bool), "distance": self._lanes.distance}
        return self._lanes.look(), _batch_info(info, mask)

    def step(self, actions: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """What the actions `[B, a]` led to.

        Raises:
            InputError: an action is misshapen or not finite, or belongs to an episode that has ended where
                nothing resets it; nothing has moved.
        """
        if self._mode is AutoresetMode.DISABLED and self._ended.any():
            lane = int(np.flatnonzero(self._ended)[0])
            raise InputError(f"the episode of lane {lane} has ended: reset it with options={{'reset_mask': ...}}.")
        begin = self._ended if self._mode is AutoresetMode.NEXT_STEP else np.zeros(self.num_envs, bool)
        done = self._lanes.step(actions)
        if begin.any():
            self._lanes.restart(begin)
        terminated, truncated = (np.asarray(end) & ~begin for end in (done.terminated, done.truncated))
        self._ended = terminated | truncated
        info, observation = _infos(done), self._lanes.look_after(done, begin)
        if self._mode is AutoresetMode.SAME_STEP and self._ended.any():
            final = {"final_obs": _objects(observation, self._ended), "final_info": _batch_info(info, self._ended)}
            self._lanes.restart(self._ended)
            begin = self._ended
            observation = self._lanes.look_anew(begin, observation)
        else:
            final = {}
        if begin.any():
            info = {"is_success": info["is_success"] & ~begin, "distance": self._lanes.distance}
        everyone = np.ones(self.num_envs, bool)
        infos = _batch_info(info, everyone) | _batch_info(final, self._ended)
        reward = np.where(begin & (self._mode is AutoresetMode.NEXT_STEP), 0.0, np.asarray(done.reward, np.float64))
        return observation, reward, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of each lane, in render mode `rgb_array`."""
        if self.render_mode != "rgb_array":
            return None
        return tuple(self._lanes.render(lane) for lane in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the simulator."""
        del kwargs
        self._lanes.env.close()

    def _checked_mask(self, options: dict[str, Any] | None) -> np.ndarray:
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, bool)
        shape = (self.num_envs,)
        if not isinstance(mask, np.ndarray) or mask.shape != shape or mask.dtype != np.bool_ or not mask.any():
            raise InputError(f"options['reset_mask'] must be a bool array of {shape} that picks a lane, got {mask!r}.")
        return mask


class _Lanes:
    """The batch of both faces: compiled functions and their state."""

    def __init__(self, config: RunConfig, lanes: int) -> None:
        if lanes < 1:
            raise InputError(f"num_envs must be at least 1, got {lanes}.")
        self.env = Env(config, lanes)
        self._state: EnvState | None = None
        compiled = self.env.compile
        self._init, self._step, self._reset = map(compiled, (self.env.init, self.env.step, self.env.reset))

    def reset(self, seeds: Sequence[int | None], mask: np.ndarray | None, random: np.random.Generator) -> None:
        """New episodes in the lanes of `mask`: seeded, or the next of the lane's own stream."""
        refuse_fork()
        fresh = [seed is not None or self._state is None for seed in seeds]
        drawn = [int(random.integers(LARGEST_SEED)) if seed is None else seed % LARGEST_SEED for seed in seeds]
        keys = gymnasium_keys(np.array(drawn, np.uint32))
        mask = np.ones(len(seeds), bool) if mask is None else mask
        if self._state is None:
            self._state = self._init(keys)
            return
        chosen = np.array(fresh) & mask
        self._state = self._reset(replace(self._state, key=jnp.where(chosen, keys, self._state.key)), mask)

    def restart(self, mask: np.ndarray) -> None:
        """New episodes in the lanes of `mask`."""
        self._state = self._reset(self.state, mask)

    def step(self, actions: ArrayLike) -> Transition:
        """Transition of all lanes, checked first."""
        refuse_fork()
        state = self.state
        self._state, done = self._step(state, _checked_actions(actions, state.last_action.shape))
        return done

    def look(self) -> Any:
        """Observations `[B, k]` of the present state."""
        return _copied(self.env.look(self.state))

    def look_anew(self, lanes: np.ndarray, others: Any) -> Any:
        """Observations of the present state in the lanes of `lanes [B]`, and `others` in the other lanes."""
        return merge(lanes, self.env.look(self.state, lanes), others)

    def look_after(self, done: Transition, begun: np.ndarray) -> Any:
        """Observations after a step, and after the lanes of `begun [B]` have begun anew."""
        return self.look() if done.observation is None or begun.any() else _copied(done.observation)

    @property
    def distance(self) -> np.ndarray:
        """Tool to target now `[B]` [m]."""
        return np.array(self.state.distance)

    def render(self, lane: int) -> np.ndarray:
        """Picture of a lane."""
        return self.env.render(self.state, lane)

    @property
    def state(self) -> EnvState:
        """State of the episodes under way."""
        if self._state is None:
            raise InputError("the environment has no episode yet: call reset first.")
        return self._state


def _checked_actions(given: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Actions as float32.

    Raises:
        InputError: another shape, or a number that is not finite; names lane and index.
    """
    try:
        actions = np.asarray(given)
    except ValueError:
        raise InputError(f"action must have shape {shape[1:]} in each of {shape[0]} lanes, got a ragged one.") from None
    if actions.shape != shape:
        raise InputError(f"action must have shape {shape[1:]} in each of {shape[0]} lanes, got {actions.shape}.")
    if actions.dtype.kind not in "fiub":
        raise InputError(f"action must be numbers, got {actions.dtype}.")
    with np.errstate(over="ignore"):
        actions = actions.astype(np.float32)
    if not np.isfinite(actions).all():
        lane, index = (int(i) for i in np.argwhere(~np.isfinite(actions))[0])
        raise InputError(f"action of lane {lane} is {actions[lane, index]} at index {index}: it must be finite.")
    return actions


def _checked(config: RunConfig) -> RunConfig:
    """The settings, which make sense together; see `validation.check`."""
    check(config)
    return config


def _checked_render_mode(mode: str | None) -> str | None:
    return None if mode is None else choose("render mode", mode, RENDER_MODES)


def _space(bounds: tuple[Any, Any]) -> Space[Any]:
    """Box of lower and upper bounds, or a dict of boxes of dicts of bounds."""
    low, high = bounds
    if isinstance(low, dict):
        return Dict({name: _space((low[name], high[name])) for name in low})
    return Box(low, high, dtype=low.dtype.type)


def _copied(observation: Any) -> Any:
    """Observation as NumPy arrays of its own."""
    return jax.tree.map(np.array, observation)


def _lane(observation: Any, lane: int) -> Any:
    """Observation of one lane, in memory of its own."""
    return jax.tree.map(lambda x: np.array(x[lane]), observation)


def _infos(done: Transition) -> dict[str, np.ndarray]:
    return {"is_success": np.array(done.terms["success"]), "distance": np.array(done.terms["distance"])}


def _batch_info(info: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Gymnasium's form: beside every value a mask of the lanes that have it."""
    return info | {f"_{name}": mask.copy() for name in info}


def _objects(observation: Any, mask: np.ndarray) -> np.ndarray:
    """Final observations as Gymnasium gives them: an object for each lane, None where it goes on."""
    final = np.full(len(mask), None, dtype=object)
    for lane in np.flatnonzero(mask):
        final[lane] = _lane(observation, int(lane))
    return final
