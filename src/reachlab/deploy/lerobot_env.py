"""A batch of environments as LeRobot knows them: motors are read and commanded, cameras look on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from reachlab.deploy.lerobot_form import LeRobotForm
from reachlab.envs.core import Env
from reachlab.envs.gymnasium_shared import METADATA, checked_actions, checked_seeds
from reachlab.envs.random_streams import gymnasium_keys
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import LAST_SEED, InputError

FILMED = 10
"""Environments of which LeRobot's evaluation makes films."""


class LeRobotVectorEnv(VectorEnv[Any, Any, Any]):
    """A batch of arms for LeRobot's rollouts, in the form in which `record` writes datasets.

    Actions are positions of the motors `[B, k]`. An observation is a dict:

    - `agent_pos [B, k]`: where the motors are; for both see `lerobot_units.motors_of`.
    - `environment_state [B, l]`: see `surroundings`.
    - `pixels`: of each camera `[B, size, size, 3]` uint8.

    `info["is_success"] [B]` says which episodes end in success in this step: one that told of success before its end
    would count for LeRobot too. Episodes that have ended count no more, and all begin anew by `reset`.
    """

    def __init__(self, config: RunConfig, num_envs: int = 1, cameras: Sequence[str] = (), size: int = 96) -> None:
        """Batch of environments, with pictures by so many of `CAMERAS`.

        Raises:
            InputError: no such camera, or see `Env`.
        """
        self._env, self._closed = Env(override(config, shaping=False), num_envs), False
        env = self._env
        self._form = LeRobotForm(env, cameras, size)
        rules, period = env.setup.rules, env.setup.period
        self._init, self._step = map(env.compile_whole, (env.init, env.step))
        self._idle = np.zeros((num_envs, len(env.action_bounds[0])), np.float32)
        self._of_each = {
            "task": env.config.task,
            "task_description": env.setup.task.asks(rules, period).partition(":")[0],
            "_max_episode_steps": rules.max_steps,
        }
        self.num_envs, self.render_mode = num_envs, "rgb_array"
        self.metadata = {**METADATA, "render_fps": round(1 / period), "autoreset_mode": AutoresetMode.DISABLED}
        seen, _ = self.reset(seed=0)
        self.single_observation_space: Any = _space(seen)
        self.single_action_space = _space(seen["agent_pos"])
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Observations of new episodes in all environments, those of Gymnasium's for the same seeds, and info.

        LeRobot's `options` have no effect.

        Raises:
            InputError: seeds that do not fit the batch, or it is closed.
        """
        del options
        self._need_open()
        seeds = checked_seeds(seed, self.num_envs)
        super().reset(seed=None if np.ndim(seed) else seeds[0])  # pyright: ignore[reportArgumentType]
        drawn = [int(self.np_random.integers(LAST_SEED + 1)) if one is None else one for one in seeds]
        self._state = self._init(gymnasium_keys(np.array(drawn, np.uint32)))
        return self._form.seen(self._state), {"is_success": np.zeros(self.num_envs, bool)}

    def step(self, actions: Any) -> tuple[dict[str, Any], Any, Any, Any, dict[str, Any]]:
        """Observations, rewards, terminated, truncated and info after commands to the motors `[B, k]`.

        A command beyond the limits of position, and of speed where joints take time to move, is one at the limit.

        Raises:
            InputError: an action is misshapen or not finite, and nothing has moved; or it is closed.
        """
        self._need_open()
        positions = checked_actions(actions, (self.num_envs, len(self._form.motors.names)))
        command = self._form.command(self._state, positions)
        self._state, done = self._step(self._state, self._idle, instead=command)
        success = np.asarray(done.done) & np.asarray(done.terms["success"])
        reward = np.asarray(done.reward, np.float64)
        return (
            self._form.seen(self._state),
            reward,
            np.array(done.terminated),
            np.array(done.truncated),
            {"is_success": success},
        )

    def call(self, name: str, *_: Any, **__: Any) -> Sequence[Any]:
        """What each environment answers, as a batch of single environments gives it.

        Raises:
            AttributeError: to a name that LeRobot's rollouts do not ask for.
        """
        if name == "render":
            return self.render()
        if name not in self._of_each:
            raise AttributeError(f"{name!r} is none of {', '.join(self._of_each)} and render.")
        return (self._of_each[name],) * self.num_envs

    get_attr = call

    def _need_open(self) -> None:
        if self._closed:
            raise InputError("the environment is closed: make another.")

    def render(self) -> tuple[np.ndarray, ...]:
        """A picture for people of each of the first `FILMED` environments, `[height, width, 3]` uint8."""
        return tuple(self._env.render(self._state, index) for index in range(min(self.num_envs, FILMED)))

    def close_extras(self, **_: Any) -> None:
        """Close simulator and cameras."""
        self._closed = True
        self._form.close()
        self._env.close()


def _space(part: Any) -> Any:
    """Space of one environment's share of an observation, or of a part of it, with the batch in front."""
    if isinstance(part, dict):
        return Dict({name: _space(value) for name, value in part.items()})
    low, high = (0, 255) if part.dtype == np.uint8 else (-np.inf, np.inf)
    return Box(low, high, part.shape[1:], part.dtype.type)
