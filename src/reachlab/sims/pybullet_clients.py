"""What simulators in PyBullet share: a client for each environment, where its tool is, and its pictures."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, NoReturn, TypeVar, cast

import numpy as np
from jax import Array

from reachlab.control.situation import Goal
from reachlab.render.view_randomisation import Views
from reachlab.robots.kinematics.forward import Pose
from reachlab.robots.robot import PybulletModel, Robot
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.sims.pybullet_arm import write_arm
from reachlab.sims.pybullet_world import World, import_pybullet
from reachlab.sims.simulator import Kind, SimState
from reachlab.tasks.schema import SIZE

W = TypeVar("W", bound=World)


class Clients(Generic[W]):
    """Worlds of PyBullet, one for each environment, loaded once."""

    kind: Kind = "host"

    def __init__(self, robot: Robot, num_envs: int, open_world: Callable[[ModuleType, PybulletModel, int], W]) -> None:
        """Worlds of `num_envs` arms, each opened with the engine, the arm's file and the number of its environment.

        Raises:
            InputError: PyBullet is not installed or has no display, or there are too many environments.
        """
        most = SIMULATORS["pybullet"].most_envs or num_envs  # each is a client of its own, of about 29 MB
        if num_envs > most:
            raise InputError(f"simulator 'pybullet' holds at most {most} environments, got {num_envs}: use --num-envs.")
        bullet, known = import_pybullet(), robot.pybullet
        with tempfile.TemporaryDirectory() as folder:  # PyBullet reads the files once, as it loads them
            urdf = known if known and robot.tool in known.tools else write_arm(robot, Path(folder))
            self._offset = urdf.tools[robot.tool]
            self._worlds = [open_world(bullet, urdf, index) for index in range(num_envs)]

    def __deepcopy__(self, _memo: dict[int, Any]) -> NoReturn:
        """Refuse to be copied: what moves is in PyBullet alone."""
        raise InputError("an environment in 'pybullet' cannot be copied: make another, or choose another simulator.")

    @property
    def _open_worlds(self) -> list[W]:
        """The clients of all environments.

        Raises:
            InputError: they are closed.
        """
        if not self._worlds:
            raise InputError("the environment is closed: make another.")
        return self._worlds

    def _tool(self) -> Pose:
        """Poses of NumPy rows: what is compiled takes them in faster than JAX would convert them here."""
        positions, quaternions = zip(*(world.link() for world in self._open_worlds), strict=True)
        position, quaternion = np.array(positions, np.float32), np.array(quaternions, np.float32)[:, [3, 0, 1, 2]]
        if self._offset:
            w, x, y, z = quaternion.T
            position += self._offset * np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1)
        return Pose(cast("Array", position), cast("Array", quaternion))

    def render_observations(self, state: SimState, _goal: Goal, views: Views, indices: np.ndarray) -> np.ndarray:
        """See `Simulator.render_observations`; the object is drawn where it lies, and colours are PyBullet's own."""
        q, out = np.asarray(state.q), np.empty((len(indices), SIZE, SIZE), np.uint8)
        for i, index in enumerate(indices):
            self._open_worlds[index].set_joints(q[i])
            out[i] = self._open_worlds[index].observation(Views(*(x[i] for x in views)))
        return out

    def close(self) -> None:
        """See `Simulator.close`."""
        for world in self._worlds:
            world.close()
        self._worlds = []
