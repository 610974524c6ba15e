"""PyBullet, the tutorial's simulator: one client for each environment."""

from __future__ import annotations

import time
from types import ModuleType
from typing import Any, cast

import numpy as np
from jax import Array

from reachlab.control.situation import Goal
from reachlab.render.marks import Marks
from reachlab.robots.robot import PybulletModel, Robot
from reachlab.settings.config import SimConfig
from reachlab.settings.validation import InputError
from reachlab.sims.pybullet_clients import Clients
from reachlab.sims.pybullet_objects import ObjectSimulator
from reachlab.sims.pybullet_world import TutorialWorld
from reachlab.sims.simulator import BatchArray, Begin, Moved, SimState, chosen
from reachlab.tasks.task import EMPTY, Scene

SLOW_STEP = 0.05
"""Time that a step takes to be followed by eye [s]; the tutorial's."""


class PybulletSimulator(Clients[TutorialWorld]):
    """The tutorial's simulator: joints are set, then the world moves on by a control period.

    Every environment has a client of its own, loaded once; a reset moves what is there.
    """

    def __init__(self, robot: Robot, config: SimConfig, num_envs: int) -> None:
        """Simulator of `num_envs` arms, see `Clients`."""
        self._period, self._pace = config.control_period, SLOW_STEP if config.slow else 0.0
        self.lag = (0.0,) * robot.chain.n

        def open_world(bullet: ModuleType, urdf: PybulletModel, index: int) -> TutorialWorld:
            return TutorialWorld(bullet, robot, urdf, config.control_period, gui=config.gui and index == 0)

        super().__init__(robot, num_envs, open_world)

    def reset(self, state: SimState | None, begin: Begin, mask: BatchArray | None) -> SimState:
        """See `Simulator.reset`; the tutorial's object falls onto each goal."""
        wanted, points = np.asarray(begin.q, np.float32), np.asarray(begin.goal.position, np.float64)
        rows = np.ones(len(wanted), bool) if state is None or mask is None else np.asarray(mask)
        for index in np.flatnonzero(rows):
            self._open_worlds[index].drop(points[index])
            self._open_worlds[index].set_joints(wanted[index])
        still, untouched = np.zeros_like(wanted), np.zeros((len(wanted), 0), bool)
        nothing = cast("Array", untouched), cast("Array", wanted[:, :0])
        now = SimState(cast("Array", wanted), cast("Array", still), *self._tool(), begin.bodies, *nothing)
        return now if state is None else chosen(rows, now, state)

    def step(self, state: SimState | Moved, command: BatchArray) -> Moved:
        """See `Simulator.step`."""
        start = time.perf_counter()
        for world in self._open_worlds:
            world.step()
        # Only now are the commands waited for: they may have been under way beside the falling objects.
        q = np.asarray(command, np.float32)
        for world, joints in zip(self._open_worlds, q, strict=True):
            world.set_joints(joints)
        if self._pace:
            time.sleep(max(0.0, self._pace - (time.perf_counter() - start)))
        speed = (q - np.asarray(state.q)) / self._period
        return Moved(cast("Array", q), cast("Array", speed), state.bodies, state.contact, state.opening, self._tool())

    def render(self, state: SimState, goal: Goal, index: int, marks: Marks) -> np.ndarray:
        """See `Simulator.render`."""
        del goal, marks
        world = self._open_worlds[index]
        world.set_joints(np.asarray(state.q[index]))
        return world.picture()


def make_pybullet(
    robot: Robot, config: SimConfig, num_envs: int, *, scene: Scene = EMPTY, **_: Any
) -> PybulletSimulator | ObjectSimulator:
    """The tutorial's simulator; where a scene has objects, the one with full dynamics.

    Raises:
        InputError: the wrench is asked for where joints are set.
    """
    if scene.objects:
        return ObjectSimulator(robot, config, num_envs, scene)
    if scene.wrench:
        raise InputError("simulator 'pybullet' measures no wrench where it sets joints, without an object: use mujoco.")
    return PybulletSimulator(robot, config, num_envs)
