"""MuJoCo with full dynamics: gravity, inertia, and position servos with torque limits."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import mujoco
import numpy as np
from jax import Array
from mujoco.batch import Batch

from reachlab.jax_setup import jit
from reachlab.robots.isolation import own_servos
from reachlab.robots.kinematics import forward_kinematics
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.sims import ArmState, BatchArray, Kind, Moved
from reachlab.sims.mujoco_contacts import Scenes
from reachlab.sims.mujoco_model import PAYLOAD, physics_model, servo_lag
from reachlab.sims.rendering import Drawn
from reachlab.tasks.obstacles import Obstacles
from reachlab.tasks.task import Goal

GAIN_SPREAD, DAMPING_SPREAD = 0.15, 0.3
"""Where dynamics vary: relative spread of each joint's servo gains and of its damping."""


class MujocoSimulator(Drawn):
    """Arms under full dynamics, stepped together on all cores.

    A control period is `physics_steps` steps of the engine, with the joints' targets held. The engine's state, float64
    rows, travels in `ArmState.engine` as its bits, so that any state can be continued from exactly; so do which arms
    they are, where dynamics vary, and where their obstacles are.

    Contact is told where there are obstacles: of the arm with them, with the table and with itself, see `add_contacts`,
    at the start of each of the engine's steps. What is touched in the last of them is told after the next period.
    """

    kind: Kind = "host"

    def __init__(
        self,
        robot: Robot,
        config: SimConfig,
        num_envs: int,
        threads: int = 0,
        *,
        randomise_dynamics: bool = False,
        obstacles: int = 0,
    ) -> None:
        """Simulator of `num_envs` arms on `threads` threads, 0 for one a core; results do not depend on them."""
        super().__init__(robot, config, num_envs, threads, randomise_dynamics=randomise_dynamics, obstacles=obstacles)
        self._model = physics_model(robot, config, payload=randomise_dynamics, obstacles=obstacles)
        self._substeps = config.physics_steps
        self._batch = Batch(self._model, nsim=num_envs, nthread=threads)
        self._qpos, self._qvel, self._ctrl = (self._batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        n = robot.chain.n
        self._positions, self._speeds = self._model.jnt_qposadr[:n], self._model.jnt_dofadr[:n]
        servos = own_servos(self._model, range(n))
        self._servos = np.array([servos[joint] for joint in range(n)])
        self.lag = servo_lag(self._model, self._servos, self._speeds)
        self._arms = _Arms(self._batch, self._servos, self._speeds) if randomise_dynamics else None
        self._scenes = Scenes(self._batch) if obstacles else None
        self._contacts = self._batch.bind("ncon") if obstacles else None
        self._begin = self._batch.state[0].copy()
        self._given: Array | None = None  # what `engine` the arms have now, as long as they are as they were given
        self._pose = jit(lambda q: forward_kinematics(robot.chain, q))

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
        del goal
        chosen = np.ones(len(q), bool) if state is None or mask is None else np.asarray(mask)
        self._restore(state)
        self._batch.state[chosen] = self._begin
        for rows, columns in ((self._qpos, self._positions), (self._ctrl, self._servos)):
            rows[np.ix_(chosen, columns)] = np.asarray(q)[chosen]
        if self._arms and dynamics is not None:
            self._arms.become(np.where(chosen[:, None], np.asarray(dynamics, np.float64), self._arms.numbers))
        if self._scenes and obstacles is not None:
            self._scenes.become(np.where(chosen[:, None], Scenes.numbers_of(obstacles), self._scenes.numbers))
        moved = self._moved(self._touching(chosen, state))
        pose = self._pose(moved.q)
        return ArmState(moved.q, moved.qd, pose.position, pose.quaternion, moved.engine, moved.contact)

    def rearrange(self, state: ArmState, obstacles: Obstacles) -> ArmState:
        """See `Simulator.rearrange`."""
        rows = np.array(state.engine).view(np.float64)
        numbers = Scenes.numbers_of(obstacles)
        rows[:, -numbers.shape[1] :] = numbers  # the scenes are the last of `_varied`
        return replace(state, engine=cast("Array", rows.view(np.uint32)))

    def _touching(self, chosen: np.ndarray, state: ArmState | None) -> np.ndarray | None:
        """Which arms touch something `[B]`: those `chosen` now, the others as it was told in the state."""
        if self._contacts is None:
            return None
        self._batch.forward(chosen, mujoco.mjtStage.mjSTAGE_POS.value)
        now = np.array(self._contacts, bool)
        if state is not None:
            now[~chosen] = np.asarray(state.contact)[~chosen]
        return now

    def step(self, state: ArmState | Moved, target_q: BatchArray) -> Moved:
        """See `Simulator.step`.

        Raises:
            FloatingPointError: the engine warned, e.g. of a state that is not finite or of a full contact buffer.
        """
        self._restore(state)
        self._ctrl[:, self._servos] = np.asarray(target_q)
        contact = None
        if self._scenes:
            counts = self._batch.rollout(self._substeps, record=("ncon",))["ncon"]  # [B, steps]
            contact = np.asarray(counts.any(axis=1))
        else:
            self._batch.step(nstep=self._substeps)
        warnings = self._batch.warning[..., 1]  # [B, kinds], how often; beside it stands what the last one was about
        if warnings.any():
            index, kind = np.argwhere(warnings)[0]
            warnings[:] = 0
            raise FloatingPointError(f"MuJoCo warned of {mujoco.mjtWarning(kind).name[7:]} in environment {index}")
        return self._moved(contact)

    def _restore(self, state: ArmState | Moved | None) -> None:
        """Make the arms, which are about to move, those of a state; mostly they are."""
        given, self._given = self._given, None
        if state is None or given is state.engine:
            return
        rows, columns = np.asarray(state.engine).view(np.float64), self._batch.state.shape[1]
        self._batch.state[:] = rows[:, :columns]
        for varied in self._varied:
            end = columns + varied.numbers.shape[1]
            varied.become(rows[:, columns:end])
            columns = end

    @property
    def _varied(self) -> list[_Arms | Scenes]:
        return [varied for varied in (self._arms, self._scenes) if varied]

    def _moved(self, contact: np.ndarray | None) -> Moved:
        """State of NumPy rows: what is compiled takes them in faster than JAX would convert them here."""
        q = self._qpos[:, self._positions].astype(np.float32)
        qd = self._qvel[:, self._speeds].astype(np.float32)
        rows = [self._batch.state, *(varied.numbers for varied in self._varied)]
        engine = np.concatenate(rows, axis=1).view(np.uint32)
        engine.flags.writeable = False  # who holds it holds what the arms are, see `_restore`
        self._given = cast("Array", engine)
        # No tool: the engine's own site positions are one physics step old after a step.
        return Moved(cast("Array", q), cast("Array", qd), engine=self._given, contact=cast("Array | None", contact))


class _Arms:
    """Arms that differ from each other by `numbers [B, 2 n + 1]` in -1 to 1: servo gains, damping and payload."""

    def __init__(self, batch: Batch, servos: np.ndarray, joints: np.ndarray) -> None:
        self._batch, self._servos, self._joints = batch, servos, joints
        names = ("actuator_gainprm", "actuator_biasprm", "dof_damping", "body_mass", "body_inertia")
        self._gain, self._bias, self._damping, self._mass, self._inertia = map(batch.expand, names)
        self._nominal = [
            np.array(field) for field in (self._gain, self._bias, self._damping, self._mass, self._inertia)
        ]
        self._payload = batch.model.body(PAYLOAD).id
        self.numbers = np.full((batch.nsim, 2 * len(joints) + 1), np.nan)

    def become(self, numbers: np.ndarray) -> None:
        """Make the arms those of `numbers`."""
        if np.array_equal(numbers, self.numbers):
            return
        self.numbers = np.array(numbers)
        n = len(self._joints)
        gains, dampings, payload = np.split(self.numbers, (n, 2 * n), axis=1)
        gain, bias, damping, mass, inertia = self._nominal
        stiff = 1 + GAIN_SPREAD * gains[:, :, None]
        self._gain[:, self._servos] = gain[:, self._servos] * stiff
        self._bias[:, self._servos] = bias[:, self._servos] * stiff
        self._damping[:, self._joints] = damping[:, self._joints] * (1 + DAMPING_SPREAD * dampings)
        load = (1 + payload[:, 0]) / 2
        self._mass[:, self._payload] = mass[:, self._payload] * load
        self._inertia[:, self._payload] = inertia[:, self._payload] * load[:, None]
        self._batch.set_const()
