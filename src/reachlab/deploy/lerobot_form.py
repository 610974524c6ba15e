"""An environment as LeRobot sees it and commands it, in the form in which `record` writes datasets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from reachlab.deploy.lerobot_pictures import Studio
from reachlab.deploy.lerobot_units import motors_of
from reachlab.deploy.surroundings import surroundings
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState


class LeRobotForm:
    """Observations and commands of a batch of environments in LeRobot's units.

    Attributes:
        motors: names and units of the motors, see `lerobot_units.motors_of`.
    """

    def __init__(self, env: Env, cameras: Sequence[str] = (), size: int = 96) -> None:
        """Form of an environment, with pictures by so many of `CAMERAS`, of a height and width [pixels].

        Raises:
            InputError: no such camera.
        """
        self._env = env
        self._studios = {name: Studio(env, name, size) for name in cameras}
        robot, period = env.setup.robot, env.setup.period
        self.motors, self._bounds = motors_of(env.config.robot, robot), robot.commands
        self._most = np.array(robot.commands.speed) * (period if env.functions.real_time else np.inf)

    def seen(self, state: EnvState) -> dict[str, Any]:
        """What is observed: `agent_pos [B, k]`, `environment_state [B, l]` and, of each camera, `pixels`."""
        bodies, goal = state.arm.bodies, state.goal
        actuated = np.concatenate([state.arm.q, state.arm.opening], axis=1)
        seen: dict[str, Any] = {
            "agent_pos": self.motors.read(actuated).astype(np.float32),
            "environment_state": surroundings(goal, bodies),
        }
        samples, position = np.asarray(self._env.functions.view_samples(state.key)), np.asarray(goal.position)
        pictures = {
            name: studio.pictures(samples, actuated, position, bodies) for name, studio in self._studios.items()
        }
        return seen | ({"pixels": pictures} if pictures else {})

    def command(self, state: EnvState, positions: np.ndarray) -> np.ndarray:
        """Command `[B, m]` [rad or m] of positions of the motors `[B, k]`.

        One beyond the limits of position, and of speed where joints take time to move, is one at the limit.
        """
        wanted, before, bounds = self.motors.command(positions), np.asarray(state.command), self._bounds
        within = np.clip(np.clip(wanted, before - self._most, before + self._most), bounds.lower, bounds.upper)
        return within.astype(np.float32)

    def close(self) -> None:
        """Close the cameras."""
        for studio in self._studios.values():
            studio.close()
