"""Gymnasium's face of a batch of environments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from reachlab.envs.functions import Transition
from reachlab.envs.gymnasium_shared import METADATA, EpisodeBatch, box, checked_render_mode, observation_space, single
from reachlab.settings.validation import InputError, choose

Step = tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]
"""Observations, rewards, terminated, truncated and infos."""


class ReachVectorEnv(VectorEnv[Any, np.ndarray, np.ndarray]):
    """A batch of arms, stepped together; environment i of seed s is `ReachEnv` with seed s + i."""

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
        name = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        mode = modes[choose("autoreset mode", name, modes)]
        steps: dict[AutoresetMode, Callable[[np.ndarray], Step]] = {
            AutoresetMode.NEXT_STEP: self._step_next,
            AutoresetMode.SAME_STEP: self._step_same,
            AutoresetMode.DISABLED: self._step_disabled,
        }
        self._step = steps[mode]
        self.render_mode = checked_render_mode(render_mode)
        self.metadata = {**METADATA, "autoreset_mode": mode}
        self.num_envs = num_envs
        self._batch = EpisodeBatch(num_envs, task, settings)
        self.single_observation_space = observation_space(self._batch.env.schema)
        self.single_action_space = box(self._batch.env.action_bounds)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Observations `[B, k]` and info; `options["reset_mask"] [B]` picks the environments that begin anew."""
        super().reset(seed=seed if isinstance(seed, int) else None)
        seeds = (
            [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else list(seed or [None] * self.num_envs)
        )
        if len(seeds) != self.num_envs:
            raise InputError(f"seed must be one number or {self.num_envs} of them, got {len(seeds)}.")
        mask = self._checked_mask(options)
        self._batch.reset(seeds, mask, self.np_random)
        self._ended = self._ended & ~mask
        info = {"is_success": np.zeros(self.num_envs, bool), "distance": self._batch.distance}
        return self._batch.observe(), _batch_info(info, mask)

    def step(self, actions: np.ndarray) -> Step:
        """What the actions `[B, a]` led to.

        Raises:
            InputError: an action is misshapen or not finite, or belongs to an episode that has ended where
                nothing resets it; nothing has moved.
        """
        return self._step(actions)

    def _step_disabled(self, actions: np.ndarray) -> Step:
        """Nothing is reset: an episode that has ended has to be, by `reset` with a mask."""
        if self._ended.any():
            index = int(np.flatnonzero(self._ended)[0])
            raise InputError(
                f"the episode of environment {index} has ended: reset it with options={{'reset_mask': ...}}."
            )
        done = self._batch.step(actions)
        terminated, truncated = np.array(done.terminated), np.array(done.truncated)
        self._ended = terminated | truncated
        return self._batch.observe_step(done), _rewards(done), terminated, truncated, self._infos(_info(done))

    def _step_next(self, actions: np.ndarray) -> Step:
        """An episode that ended in the last step begins anew in this one, whatever its action; it gets no reward."""
        begun = self._ended
        done = self._batch.step(actions)
        if begun.any():
            self._batch.restart(begun)
        terminated, truncated = (np.asarray(end) & ~begun for end in (done.terminated, done.truncated))
        self._ended = terminated | truncated
        observation = self._batch.observe() if begun.any() else self._batch.observe_step(done)
        infos = self._infos(self._begun_info(_info(done), begun))
        return observation, np.where(begun, 0.0, _rewards(done)), terminated, truncated, infos

    def _step_same(self, actions: np.ndarray) -> Step:
        """An episode that ends in this step begins anew in it; its last observation and info are among the infos."""
        done = self._batch.step(actions)
        terminated, truncated = np.array(done.terminated), np.array(done.truncated)
        ended = self._ended = terminated | truncated
        observation, info, final = self._batch.observe_step(done), _info(done), {}
        if ended.any():
            final = {"final_obs": _objects(observation, ended), "final_info": _batch_info(info, ended)}
            self._batch.restart(ended)
            observation = self._batch.observe_some(ended, observation)
        infos = self._infos(self._begun_info(info, ended)) | _batch_info(final, ended)
        return observation, _rewards(done), terminated, truncated, infos

    def _begun_info(self, info: dict[str, Any], begun: np.ndarray) -> dict[str, Any]:
        """Infos of a step in which the environments of `begun [B]` were reset."""
        if not begun.any():
            return info
        return {"is_success": info["is_success"] & ~begun, "distance": self._batch.distance}

    def _infos(self, info: dict[str, Any]) -> dict[str, Any]:
        return _batch_info(info, np.ones(self.num_envs, bool))

    def render(self) -> tuple[np.ndarray, ...] | None:
        """A picture of each environment, in render mode `rgb_array`."""
        if self.render_mode != "rgb_array":
            return None
        return tuple(self._batch.render(index) for index in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the simulator."""
        del kwargs
        self._batch.env.close()

    def _checked_mask(self, options: dict[str, Any] | None) -> np.ndarray:
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, bool)
        shape = (self.num_envs,)
        if not isinstance(mask, np.ndarray) or mask.shape != shape or mask.dtype != np.bool_ or not mask.any():
            raise InputError(
                f"options['reset_mask'] must be a bool array of {shape} that picks an environment, got {mask!r}."
            )
        return mask


def _rewards(done: Transition) -> np.ndarray:
    return np.array(done.reward, np.float64)


def _info(done: Transition) -> dict[str, np.ndarray]:
    return {"is_success": np.array(done.terms["success"]), "distance": np.array(done.terms["distance"])}


def _batch_info(info: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Gymnasium's form: beside every value a mask of the environments that have it."""
    return info | {f"_{name}": mask.copy() for name in info}


def _objects(observation: Any, mask: np.ndarray) -> np.ndarray:
    """Final observations as Gymnasium gives them: an object for each environment, None where the episode continues."""
    final = np.full(len(mask), None, dtype=object)
    for index in np.flatnonzero(mask):
        final[index] = single(observation, int(index))
    return final
