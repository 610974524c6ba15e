"""PyBullet, the tutorial's simulator: one client for each environment."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any, NoReturn, cast

import jax
import numpy as np
from jax import Array

from reachlab.render.marks import Marks
from reachlab.render.view_randomisation import Views
from reachlab.robots.kinematics import Pose
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS, ArmState, BatchArray, Kind, Moved
from reachlab.sims.pybullet_arm import write_arm
from reachlab.sims.pybullet_world import World, import_pybullet
from reachlab.tasks.obstacles import Obstacles
from reachlab.tasks.schema import SIZE
from reachlab.tasks.task import Goal

SLOW_STEP = 0.05
"""Time that a step takes to be followed by eye [s]; the tutorial's."""


class PybulletSimulator:
    """The tutorial's simulator: joints are set, then the world moves on by a control period.

    Every environment has a client of its own, loaded once; a reset moves what is there.
    """

    kind: Kind = "host"

    def __init__(
        self,
        robot: Robot,
        config: SimConfig,
        num_envs: int,
        *,
        threads: int = 0,
        randomise_dynamics: bool = False,
        obstacles: int = 0,
    ) -> None:
        """Simulator of `num_envs` arms.

        Raises:
            InputError: PyBullet is not installed or has no display, or there are too many environments.
        """
        del threads, randomise_dynamics, obstacles
        most = SIMULATORS["pybullet"].most_envs or num_envs  # each is a client of its own, of about 29 MB
        if num_envs > most:
            raise InputError(f"simulator 'pybullet' holds at most {most} environments, got {num_envs}: use --num-envs.")
        self._bullet = import_pybullet()
        self._period, self._pace = config.control_period, SLOW_STEP if config.slow else 0.0
        self.lag = (0.0,) * robot.chain.n
        known = robot.pybullet
        with tempfile.TemporaryDirectory() as folder:  # PyBullet reads the files once, as it loads them
            urdf = known if known and robot.tool in known.tools else write_arm(robot, Path(folder))
            self._offset = urdf.tools[robot.tool]
            self._worlds = [
                World(self._bullet, robot, urdf, config.control_period, gui=config.gui and index == 0)
                for index in range(num_envs)
            ]

    def __deepcopy__(self, memo: dict[int, Any]) -> NoReturn:
        """Refuse to be copied: the falling objects are in PyBullet alone."""
        del memo
        raise InputError("an environment in 'pybullet' cannot be copied: make another, or choose another simulator.")

    @property
    def _open_worlds(self) -> list[World]:
        """The clients of all environments.

        Raises:
            InputError: they are closed.
        """
        if not self._worlds:
            raise InputError("the environment is closed: make another.")
        return self._worlds

    def reset(
        self,
        state: ArmState | None,
        q: BatchArray,
        goal: Goal,
        mask: BatchArray | None,
        dynamics: BatchArray | None = None,
        obstacles: Obstacles | None = None,
    ) -> ArmState:
        """See `Simulator.reset`."""
        del dynamics, obstacles
        wanted, points = np.asarray(q, np.float32), np.asarray(goal.position, np.float64)
        chosen = np.ones(len(wanted), bool) if state is None or mask is None else np.asarray(mask)
        for index in np.flatnonzero(chosen):
            self._open_worlds[index].drop(points[index])
            self._open_worlds[index].set_joints(wanted[index])
        now = ArmState(cast("Array", wanted), cast("Array", np.zeros_like(wanted)), *self._tool())
        if state is None:
            return now
        return jax.tree.map(lambda new, old: np.where(chosen[:, None], new, old), now, state)

    def step(self, state: ArmState | Moved, target_q: BatchArray) -> Moved:
        """See `Simulator.step`."""
        start = time.perf_counter()
        for world in self._open_worlds:
            world.step()
        # Only now are the commands waited for: they may have been under way beside the falling objects.
        q = np.asarray(target_q, np.float32)
        for world, joints in zip(self._open_worlds, q, strict=True):
            world.set_joints(joints)
        if self._pace:
            time.sleep(max(0.0, self._pace - (time.perf_counter() - start)))
        return Moved(cast("Array", q), cast("Array", (q - np.asarray(state.q)) / self._period), self._tool())

    def _tool(self) -> Pose:
        """Poses of NumPy rows: what is compiled takes them in faster than JAX would convert them here."""
        positions, quaternions = zip(*(world.link() for world in self._open_worlds), strict=True)
        position, quaternion = np.array(positions, np.float32), np.array(quaternions, np.float32)[:, [3, 0, 1, 2]]
        if self._offset:
            w, x, y, z = quaternion.T
            position += self._offset * np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1)
        return Pose(cast("Array", position), cast("Array", quaternion))

    def render(self, state: ArmState, goal: Goal, index: int, marks: Marks) -> np.ndarray:
        """See `Simulator.render`."""
        del goal, marks
        world = self._open_worlds[index]
        world.set_joints(np.asarray(state.q[index]))
        return world.picture()

    def render_observations(self, q: np.ndarray, goal: Goal, views: Views, indices: np.ndarray) -> np.ndarray:
        """See `Simulator.render_observations`; the object is drawn where it lies, and colours are PyBullet's own."""
        del goal
        out = np.empty((len(q), SIZE, SIZE), np.uint8)
        for i, index in enumerate(indices):
            self._open_worlds[index].set_joints(q[i])
            out[i] = self._open_worlds[index].observation(Views(*(x[i] for x in views)))
        return out

    def close(self) -> None:
        """See `Simulator.close`."""
        for world in self._worlds:
            world.close()
        self._worlds = []
