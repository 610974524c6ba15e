"""PyBullet with full dynamics, for scenes with objects."""

from __future__ import annotations

from types import ModuleType
from typing import cast

import jax
import numpy as np
from jax import Array

from reachlab.control.bodies import Bodies
from reachlab.control.situation import Goal
from reachlab.render.marks import Marks
from reachlab.render.view_randomisation import Views
from reachlab.robots.kinematics.limits import own_servos
from reachlab.robots.robot import PybulletModel, Robot
from reachlab.settings.config import SimConfig
from reachlab.sims.mujoco_model import physics_model, servo_lag
from reachlab.sims.objects import mass_and_share, with_objects
from reachlab.sims.pybullet_clients import Clients
from reachlab.sims.pybullet_dynamics import ObjectWorld, find_motors, substeps
from reachlab.sims.simulator import BatchArray, Begin, Moved, SimState, chosen
from reachlab.sims.wrench import Newton
from reachlab.tasks.task import Scene


class ObjectSimulator(Clients[ObjectWorld]):
    """Arms on motors that follow commands as MuJoCo's servos do, and objects that are touched.

    What is in motion and which objects they are travels in `SimState.engine`, so that any state can be continued from:
    always in the same way, but not to all digits as if it had never been left, for the engine remembers contacts too.
    """

    def __init__(self, robot: Robot, config: SimConfig, num_envs: int, scene: Scene) -> None:
        """Simulator of `num_envs` arms, see `Clients`."""
        model, self._robot, self._scene = physics_model(robot, config, scene), robot, scene
        home, period = robot.posture(np.array(robot.at_home)), config.control_period
        servos, joints = own_servos(model), range(robot.chain.n)
        self.lag = servo_lag(model, np.array([servos[joint] for joint in joints]), np.array(joints))
        motors = find_motors(model, home, period / substeps(period))
        self._posture, self._count, self._period = home, len(home), period
        self._newton = Newton(model) if scene.wrench else None

        def open_world(bullet: ModuleType, urdf: PybulletModel, index: int) -> ObjectWorld:
            return ObjectWorld(bullet, robot, urdf, period, scene, motors, gui=config.gui and index == 0)

        super().__init__(robot, num_envs, open_world)
        # What the worlds are now, first the mass of objects and their share of the friction; unknown where NaN.
        self._rows = np.full((num_envs, 2 + 2 * len(home) + 13 * scene.objects), np.nan)

    def reset(self, state: SimState | None, begin: Begin, mask: BatchArray | None) -> SimState:
        """See `Simulator.reset`."""
        bodies, q = jax.tree.map(np.asarray, begin.bodies), np.asarray(begin.q)
        rows = np.ones(len(q), bool) if state is None or mask is None else np.asarray(mask)
        varied = np.asarray(begin.dynamics, np.float64)
        # Arms do not vary here: their numbers, which come first, are left out.
        varied = varied[:, varied.shape[1] - varied.shape[1] % (2 * self._robot.chain.n + 1) :]
        joints = np.concatenate([q, np.tile(self._posture[q.shape[1] :], (len(q), 1))], axis=1)
        parts = (*mass_and_share(self._scene, varied), joints, 0 * joints, self._moving(bodies))
        begun = np.concatenate(parts, axis=1, dtype=np.float64)
        if state is not None:
            bodies = chosen(rows, bodies, jax.tree.map(np.asarray, state.bodies))
            begun = chosen(rows, begun, self._wanted(state))
        self._put(begun, bodies, rows)
        wrench = self._wrench(begun, np.zeros((len(q), 6)))
        if wrench is not None and state is not None:
            wrench = chosen(rows, wrench, np.asarray(state.wrench))
        moved, tool = self._moved(bodies), self._tool()
        if state is not None:  # what goes on keeps the sign of its quaternion too
            tool = chosen(rows, tool, jax.tree.map(np.asarray, state.tool))
        parts = (moved.bodies, moved.contact, moved.opening, moved.engine, cast("Array | None", wrench))
        return SimState(moved.q, moved.qd, tool.position, tool.quaternion, *parts)

    def step(self, state: SimState | Moved, command: BatchArray) -> Moved:
        """See `Simulator.step`."""
        bodies = jax.tree.map(np.asarray, state.bodies)
        self._put(before := self._wanted(state), bodies)
        for world, row in zip(self._open_worlds, np.asarray(command, np.float64), strict=True):
            world.step(self._robot.posture(row))
        moved = self._moved(bodies)
        wrench = self._wrench(before, np.array([world.touch for world in self._open_worlds]))
        return moved._replace(wrench=cast("Array | None", wrench))

    def _wrench(self, before: np.ndarray, touch: np.ndarray) -> np.ndarray | None:
        """Mean wrench `[B, 6]` since the worlds were those of rows `before`, of the contacts `touch [B, 6]` since."""
        if self._newton is None:
            return None
        q, qd, _ = np.split(self._rows[:, 2:], (self._count, 2 * self._count), axis=1)
        faster = (qd - before[:, 2 + self._count : 2 + 2 * self._count]) / self._period
        return np.array([self._newton.wrench(*row) for row in zip(q, qd, faster, touch, strict=True)])

    def _wanted(self, state: SimState | Moved) -> np.ndarray:
        """Rows of a state; objects that were moved by hand are where its bodies have them."""
        rows = np.array(np.asarray(state.engine).view(np.float64))
        asked, first = self._moving(state.bodies), 2 + 2 * self._count
        elsewhere = (asked != rows[:, first:].astype(np.float32)).any(axis=1)
        rows[elsewhere, first:] = asked[elsewhere]
        return rows

    def _put(self, rows: np.ndarray, bodies: Bodies, anew: np.ndarray | None = None) -> None:
        """Make the worlds those of rows and bodies, where they are not already, or of all that begin `anew [B]`."""
        other = (rows != self._rows).any(axis=1)
        for index in np.flatnonzero(other if anew is None else other | anew):
            here = (bodies.position[index], bodies.quaternion[index], bodies.size[index])
            walls = np.concatenate(here, axis=-1, dtype=np.float64)[: self._scene.fixed]
            sizes = np.asarray(here[2], np.float64)[-self._scene.objects :]
            self._open_worlds[index].become(walls, sizes, *rows[index, :2])
            self._open_worlds[index].put(rows[index, 2:])
        self._rows = rows

    def _moving(self, bodies: Bodies) -> np.ndarray:
        """Poses and velocities `[B, 13 k]` of the objects among bodies `[B, K]`."""
        parts = (bodies.position, bodies.quaternion, bodies.velocity)
        joined = np.concatenate([np.asarray(part)[:, -self._scene.objects :] for part in parts], axis=-1)
        return joined.reshape(len(joined), -1)

    def _moved(self, bodies: Bodies) -> Moved:
        """State of NumPy rows, as the simulator in MuJoCo has it."""
        now = np.array([world.now() for world in self._open_worlds])
        self._rows = np.concatenate([self._rows[:, :2], now], axis=1)
        q, qd, moving = np.split(now.astype(np.float32), (self._count, 2 * self._count), axis=1)
        n, moving = self._robot.chain.n, moving.reshape(len(q), -1, 13)
        opening = self._robot.gripper.opening(q[:, n:]).astype(np.float32) if self._robot.gripper else q[:, n:]
        bodies = with_objects(bodies, moving[..., :7], moving[..., 7:])
        contact = cast("Array", np.zeros((len(q), 0), bool))
        parts = (cast("Array", q[:, :n]), cast("Array", qd[:, :n]), bodies, contact, cast("Array", opening))
        return Moved(*parts, engine=cast("Array", self._rows.view(np.uint32)))

    def render(self, state: SimState, goal: Goal, index: int, marks: Marks) -> np.ndarray:
        """See `Simulator.render`."""
        del goal, marks
        self._put(self._wanted(state), state.bodies)
        return self._open_worlds[index].picture()

    def render_observations(self, state: SimState, goal: Goal, views: Views, indices: np.ndarray) -> np.ndarray:
        """See `Simulator.render_observations`; below the place of an object is a cross."""
        actuated = np.concatenate([state.q, state.opening], axis=1)
        joints = np.array([self._robot.posture(row) for row in actuated])
        rows = np.concatenate([joints, 0 * joints, self._moving(state.bodies)], axis=1, dtype=np.float64)
        marks = np.array(goal.position) - [0, 0, 1] * np.asarray(state.bodies.extent)[:, -1]
        for index, row, mark in zip(indices, rows, marks, strict=True):
            self._open_worlds[index].put(row)
            self._open_worlds[index].mark(mark)
        pictures = super().render_observations(state, goal, views, indices)
        self._rows = np.full_like(self._rows, np.nan)
        return pictures
