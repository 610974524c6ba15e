"""Gymnasium's interface to a batch of environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from reachlab.envs.gymnasium_shared import (
    METADATA,
    Episodes,
    action_space,
    checked_options,
    checked_render_mode,
    checked_seeds,
    infos,
    observation_space,
    single,
)
from reachlab.settings.validation import InputError, choose

ARRAYS = {
    "numpy": "NumPy arrays of the caller's own",
    "jax": "JAX arrays, left where they were computed; others take them over by DLPack without a copy",
}
"""Arrays that `step` and `reset` give, by name."""

OPTIONS = ("reset_mask",)
"""Options of `reset`."""


class ReachVectorEnv(VectorEnv[Any, Any, Any]):
    """A batch of arms, stepped together; environment i of seed s is `ReachEnv` with seed s + i.

    Attributes:
        num_envs: environments in the batch.
        observation_space, action_space: of the batch.
        single_observation_space, single_action_space: of one environment.
        render_mode: `rgb_array`, or None.
        metadata: render modes, and the mode in which episodes begin anew.
    """

    def __init__(
        self,
        num_envs: int = 1,
        task: str = "tutorial",
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        arrays: str = "numpy",
        **settings: Any,
    ) -> None:
        """Batch of environments that gives arrays of a kind of `ARRAYS`; settings as for `ReachEnv`.

        Raises:
            InputError: see `ReachEnv`; or an autoreset mode or a kind of arrays that does not exist.
        """
        modes = {mode.value: mode for mode in AutoresetMode}
        name = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        self._mode = modes[choose("autoreset mode", name, modes)]
        self._numpy = choose("arrays", arrays, ARRAYS) == "numpy"
        self.render_mode = checked_render_mode(render_mode)
        self._episodes = Episodes(num_envs, task, settings, self._mode, in_numpy=self._numpy)
        rate = round(1 / self._episodes.env.setup.period)
        self.metadata = {**METADATA, "render_fps": rate, "autoreset_mode": self._mode}
        self.num_envs = num_envs = self._episodes.env.num_envs
        self.single_observation_space = observation_space(self._episodes.env.schema)
        self.single_action_space = action_space(self._episodes.env)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Observations `[B, k]` and info; `options["reset_mask"] [B]` picks the environments that begin anew.

        Raises:
            InputError: an option that does not exist, or a mask or seeds that do not fit the batch.
        """
        seeds = checked_seeds(seed, self.num_envs)
        super().reset(seed=None if np.ndim(seed) else seeds[0])  # pyright: ignore[reportArgumentType]
        mask = self._checked_mask(options)
        now = self._episodes.reset(seeds, mask, self.np_random)
        self._ended = self._ended & ~mask
        return now.observation, _batch_info(infos(now), mask)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Observations, rewards, terminated, truncated and infos that the actions `[B, a]` led to.

        By autoreset mode: with `NEXT_STEP` an episode that ended in the last step begins anew in this one, whatever its
        action, without reward. With `SAME_STEP` one that ends in this step begins anew in it; its last observation and
        info are among the infos. With `DISABLED` one that has ended has to be reset, by `reset` with a mask.

        Raises:
            InputError: an action is misshapen or not finite, or belongs to an episode that has ended where
                nothing resets it; nothing has moved.
        """
        if self._mode is AutoresetMode.DISABLED and self._ended.any():
            index = int(np.flatnonzero(self._ended)[0])
            raise InputError(
                f"the episode of environment {index} has ended: reset it with options={{'reset_mask': ...}}."
            )
        now, reward, terminated, truncated, final = self._episodes.step(actions)
        if self._mode is AutoresetMode.DISABLED:
            self._ended = np.asarray(terminated) | np.asarray(truncated)
        info = _batch_info(infos(now), np.ones(self.num_envs, bool))
        if final is not None and (ended := np.asarray(terminated) | np.asarray(truncated)).any():
            observation = _objects(final.observation, ended) if self._numpy else final.observation
            info |= _batch_info({"final_obs": observation, "final_info": _batch_info(infos(final), ended)}, ended)
        return now.observation, reward.astype(np.float64) if self._numpy else reward, terminated, truncated, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of each environment, in render mode `rgb_array`."""
        if self.render_mode != "rgb_array":
            return None
        return tuple(self._episodes.render(index) for index in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the simulator."""
        del kwargs
        self._episodes.close()

    def _checked_mask(self, options: dict[str, Any] | None) -> np.ndarray:
        mask = checked_options(options, OPTIONS).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, bool)
        shape = (self.num_envs,)
        if not isinstance(mask, np.ndarray) or mask.shape != shape or mask.dtype != np.bool_ or not mask.any():
            raise InputError(
                f"options['reset_mask'] must be a bool array of {shape} that picks an environment, got {mask!r}."
            )
        return mask


def _batch_info(info: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Gymnasium's form: beside every value a mask of the environments that have it."""
    return info | {f"_{name}": mask.copy() for name in info}


def _objects(observation: Any, mask: np.ndarray) -> np.ndarray:
    """Final observations as Gymnasium gives them: an object for each environment, None where the episode continues."""
    final = np.full(len(mask), None, dtype=object)
    for index in np.flatnonzero(mask):
        final[index] = single(observation, int(index))
    return final
