"""Gymnasium's interface to a single environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from reachlab.envs.episode_steps import Now
from reachlab.envs.functions import EnvState
from reachlab.envs.gymnasium_shared import (
    METADATA,
    Episodes,
    action_space,
    checked_options,
    checked_render_mode,
    checked_seed,
    infos,
    observation_space,
    single,
)

OPTIONS = ("target",)
"""Options of `reset`."""


class ReachEnv(gymnasium.Env[Any, np.ndarray]):
    """One arm that has to reach a target.

    `info` holds `is_success`, `distance` [m], `elapsed_steps` and, where an orientation is asked for, `angle` [rad];
    with `wrench=True` also `wrench` `[6]`, the force [N] and the torque [Nm] at the wrist.

    Attributes:
        observation_space: what `reset` and `step` give.
        action_space: the box of actions.
        render_mode: `rgb_array`, or None.
        metadata: render modes, and the pictures a second with which an episode takes its time.
    """

    metadata = METADATA

    def __init__(self, task: str = "tutorial", render_mode: str | None = None, **settings: Any) -> None:
        """Environment of a task preset, with any field of the configuration as a keyword.

        Raises:
            InputError: a task, setting or render mode that does not exist, or a value that is not allowed.
        """
        self.render_mode = checked_render_mode(render_mode)
        self._episodes = Episodes(1, task, settings, AutoresetMode.DISABLED)
        self.metadata = {**METADATA, "render_fps": round(1 / self._episodes.env.setup.period)}
        self.observation_space = observation_space(self._episodes.env.schema)
        self.action_space = action_space(self._episodes.env)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """First observation of a new episode, and info; equal seeds give equal episodes from there on.

        `options["target"]` puts the target at a point `[3]` m of `target_box` or, where an orientation is asked for,
        in a pose `[7]`: position and quaternion wxyz. Without it the target is drawn.

        Raises:
            InputError: a seed that is no whole number from 0 to 2³² - 1, an option that does not exist, or a target
                that is misshapen or where the arm cannot be.
        """
        seed, given = checked_seed(seed), checked_options(options, OPTIONS)
        goal = self._episodes.goal_at(given["target"]) if "target" in given else None
        super().reset(seed=seed)
        now = self._episodes.reset([seed], np.ones(1, bool), self.np_random, goal)
        return single(now.observation, 0), _info(now)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Result of an action: observation, reward, terminated, truncated, info.

        Raises:
            InputError: the action is misshapen or not finite; nothing has moved.
        """
        now, reward, terminated, truncated, _ = self._episodes.step([action])
        return single(now.observation, 0), reward.item(), terminated.item(), truncated.item(), _info(now)

    def render(self) -> np.ndarray | None:
        """Picture of the arm, `[height, width, 3]` uint8, in render mode `rgb_array`."""
        return self._episodes.render(0) if self.render_mode == "rgb_array" else None

    @property
    def target_box(self) -> np.ndarray:
        """Lower and upper corner `[2, 3]` m of the box of the task's targets; where they lie on a table it is flat."""
        setup = self._episodes.env.setup
        return np.stack(setup.task.goal_box(setup))

    @property
    def state(self) -> EnvState:
        """State of the episode under way, in a batch of one.

        Raises:
            InputError: none has begun.
        """
        return self._episodes.state

    def close(self) -> None:
        """Close the simulator."""
        self._episodes.close()


def _info(now: Now) -> dict[str, Any]:
    return {name: value[0] if value.ndim > 1 else value.item() for name, value in infos(now).items()}
