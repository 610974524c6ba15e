"""Gymnasium's face of a single environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from reachlab.envs.functions import EnvState
from reachlab.envs.gymnasium_shared import METADATA, EpisodeBatch, box, checked_render_mode, observation_space, single


class ReachEnv(gymnasium.Env[Any, np.ndarray]):
    """One arm that has to reach a target.

    `info` holds `is_success` and `distance` [m].
    """

    metadata = METADATA

    def __init__(self, task: str = "tutorial", render_mode: str | None = None, **settings: Any) -> None:
        """Environment of a task preset, with any field of the configuration as a keyword.

        Raises:
            InputError: a task, setting or render mode that does not exist, or a value that is not allowed.
        """
        self.render_mode = checked_render_mode(render_mode)
        self._batch = EpisodeBatch(1, task, settings)
        self.observation_space = observation_space(self._batch.env.schema)
        self.action_space = box(self._batch.env.action_bounds)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """First observation of a new episode, and info; equal seeds give equal episodes from there on."""
        del options
        super().reset(seed=seed)
        self._batch.reset([seed], np.ones(1, bool), self.np_random)
        return single(self._batch.observe(), 0), {"is_success": False, "distance": float(self._batch.distance[0])}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """What an action led to: observation, reward, terminated, truncated, info.

        Raises:
            InputError: the action is misshapen or not finite; nothing has moved.
        """
        done = self._batch.step([action])
        info = {"is_success": bool(done.terms["success"][0]), "distance": float(done.terms["distance"][0])}
        observation = single(self._batch.observe_step(done), 0)
        return observation, float(done.reward[0]), bool(done.terminated[0]), bool(done.truncated[0]), info

    def render(self) -> np.ndarray | None:
        """Picture of the arm, `[height, width, 3]` uint8, in render mode `rgb_array`."""
        return self._batch.render(0) if self.render_mode == "rgb_array" else None

    @property
    def state(self) -> EnvState:
        """State of the episode under way, in a batch of one.

        Raises:
            InputError: none has begun.
        """
        return self._batch.state

    def close(self) -> None:
        """Close the simulator."""
        self._batch.env.close()
