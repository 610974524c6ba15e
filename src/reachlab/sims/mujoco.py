"""MuJoCo with full dynamics: gravity, inertia, and position servos with torque limits."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import cast

import jax
import mujoco
import numpy as np
from jax import Array
from mujoco.batch import Batch

from reachlab.control.bodies import Bodies
from reachlab.control.contact_model import FixedBodies
from reachlab.jax_setup import jit
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.kinematics.limits import own_servos
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.sims.mujoco_model import PAYLOAD, Layout, check_rest, physics_model, servo_lag, stiffening
from reachlab.sims.mujoco_objects import FreeBodies
from reachlab.sims.rendering import Drawn
from reachlab.sims.simulator import BatchArray, Begin, Kind, Moved, SimState, chosen
from reachlab.sims.wrench import measured
from reachlab.tasks.task import EMPTY, Scene

GAIN_SPREAD, DAMPING_SPREAD = 0.15, 0.3
"""Where dynamics vary: relative spread of each joint's servo gains and of its damping."""

LEAST_LAG, MOST_LAG = 0.2, 1.5
"""Where the lag varies: by which share of their own lag servos follow, at least and at most."""

VARIED = frozenset({"dynamics", "lag"})
"""What varies of the arms, of the words of `RunConfig.randomise`."""


class MujocoSimulator(Drawn):
    """Arms under full dynamics, stepped together on all cores.

    A control period is `physics_steps` steps of the engine, with the joints' targets held. The engine's state, float64
    rows, travels in `SimState.engine` as its bits, so that any state can be continued from exactly; so do which arms
    they are, where dynamics vary.

    Contacts are judged where the scene says so: of the arm with bodies, the table and itself, see `add_contacts`,
    at the start of each of the engine's steps. What is touched in the last of them is told after the next period. So is
    the wrench at the wrist measured, see `sims.wrench`: its mean over these steps.
    """

    kind: Kind = "host"

    def __init__(
        self,
        robot: Robot,
        config: SimConfig,
        num_envs: int,
        threads: int = 0,
        *,
        randomise: Sequence[str] = (),
        scene: Scene = EMPTY,
    ) -> None:
        """Simulator of `num_envs` arms on `threads` threads, 0 for one a core; results do not depend on them."""
        super().__init__(robot, config, num_envs, threads, randomise=randomise, scene=scene)
        varied = VARIED.intersection(randomise)
        self._model = physics_model(robot, config, scene, payload=bool(varied))
        self._substeps = config.physics_steps
        self._batch = Batch(self._model, nsim=num_envs, nthread=threads)
        self._qpos, self._qvel, self._ctrl = (self._batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        n = robot.chain.n
        self._positions, self._speeds = self._model.jnt_qposadr[:n], self._model.jnt_dofadr[:n]
        servos = own_servos(self._model)
        self._servos = np.array([servos[joint] for joint in range(n)])
        self.lag = servo_lag(self._model, self._servos, self._speeds)
        self._gripper, fingers = robot.gripper, list(range(n, n + len(robot.gripper.open) if robot.gripper else n))
        self._fingers = self._model.jnt_qposadr[fingers]
        self._finger_servos = np.array([servos[joint] for joint in fingers], int)
        self._arms = _Arms(self._batch, self._servos, self._speeds, varied) if varied else None
        if "lag" in varied or config.servo_lag is not None:
            soonest = self._arms.soonest() if self._arms and "lag" in varied else self._model
            check_rest(soonest, robot, (self._positions, self._servos), config)
        self._fixed = FixedBodies(self._batch)
        self._free = FreeBodies(self._batch, scene)
        self._numbers = np.zeros((num_envs, 0))
        self._contacts = self._batch.bind("ncon") if scene.contacts else None
        self._sensors = self._batch.bind("sensordata") if scene.wrench else None
        self._recorded = ("ncon",) * scene.contacts + ("sensordata",) * scene.wrench
        self._untouched = np.zeros((num_envs, 0), bool)
        self._begin = self._batch.state[0].copy()
        # What `engine` and `bodies` the arms have now, as long as they are as they were given.
        self._given: tuple[Array, Bodies] | None = None
        self._pose = jit(lambda q: forward_kinematics(robot.chain, q), brief=True)

    def reset(self, state: SimState | None, begin: Begin, mask: BatchArray | None) -> SimState:
        """See `Simulator.reset`."""
        rows = np.ones(len(begin.q), bool) if state is None or mask is None else np.asarray(mask)
        self._restore(state)
        self._batch.state[rows] = self._begin
        for values, columns in ((self._qpos, self._positions), (self._ctrl, self._servos)):
            values[np.ix_(rows, columns)] = np.asarray(begin.q)[rows]
        if self._gripper:
            self._qpos[np.ix_(rows, self._fingers)] = self._ctrl[np.ix_(rows, self._finger_servos)] = self._gripper.open
        numbers = np.array(begin.dynamics, np.float64)
        if state is not None:
            numbers[~rows] = self._numbers[~rows]
        bodies = jax.tree.map(np.asarray, begin.bodies)
        if state is not None:
            bodies = chosen(rows, bodies, jax.tree.map(np.asarray, state.bodies))
        self._fixed.become(bodies)
        self._free.put(bodies, rows)
        self._become(numbers, bodies)
        wrench = self._wrench_at_rest(rows, state)
        moved = self._moved(bodies, self._touching(rows, state))
        pose, parts = self._pose(moved.q), (bodies, moved.contact, moved.opening, moved.engine)
        return SimState(moved.q, moved.qd, pose.position, pose.quaternion, *parts, cast("Array | None", wrench))

    def model(self, index: int = 0) -> mujoco.MjModel:
        """Model of one of the arms, with the bodies beside it and the objects as they are."""
        return self._batch.get_model(index)

    @property
    def layout(self) -> Layout:
        """Where in that model's arrays things are."""
        fingers, objects = (self._fingers, self._finger_servos), (self._free.position, self._free.velocity)
        return Layout(self._positions, self._speeds, self._servos, *fingers, *objects, self._fixed.geoms)

    def _touching(self, rows: np.ndarray, state: SimState | None) -> np.ndarray:
        """Which arms touch something `[B]`: those of `rows [B]` now, the others as the state says."""
        if self._contacts is None:
            return self._untouched
        self._batch.forward(rows, mujoco.mjtStage.mjSTAGE_POS.value)
        now = np.array(self._contacts, bool)
        if state is not None:
            now[~rows] = np.asarray(state.contact)[~rows]
        return now

    def _wrench_at_rest(self, rows: np.ndarray, state: SimState | None) -> np.ndarray | None:
        """Wrench `[B, 6]`, where it is measured: of those of `rows [B]` now, of the others as the state says."""
        if self._sensors is None:
            return None
        self._batch.forward(rows)
        now = measured(self._model, self._sensors)
        return now if state is None else chosen(rows, now, np.asarray(state.wrench))

    def step(self, state: SimState | Moved, command: BatchArray) -> Moved:
        """See `Simulator.step`.

        Raises:
            FloatingPointError: the engine warned, e.g. of a state that is not finite or of a full contact buffer.
        """
        self._restore(state)
        command, n = np.asarray(command), len(self._servos)
        self._ctrl[:, self._servos] = command[:, :n]
        if self._gripper:
            self._ctrl[:, self._finger_servos] = self._gripper.fingers(command[:, n:])
        contact, wrench = self._untouched, None
        if self._recorded:
            steps = self._batch.rollout(self._substeps, record=self._recorded)  # [B, steps, ...]
            contact = np.asarray(steps["ncon"].any(axis=1)) if "ncon" in steps else contact
            wrench = measured(self._model, steps["sensordata"].mean(axis=1)) if "sensordata" in steps else None
        else:
            self._batch.step(nstep=self._substeps)
        warnings = self._batch.warning[..., 1]  # [B, kinds], how often; beside it stands what the last one was about
        if warnings.any():
            index, kind = np.argwhere(warnings)[0]
            warnings[:] = 0
            raise FloatingPointError(f"MuJoCo warned of {mujoco.mjtWarning(kind).name[7:]} in environment {index}")
        return self._moved(state.bodies, contact)._replace(wrench=cast("Array | None", wrench))

    def _restore(self, state: SimState | Moved | None) -> None:
        """Continue from a state: from where the arms were left, or from where they were at any time."""
        given, self._given = self._given, None
        if state is None or state.engine is None:
            return
        if given is None or given[0] is not state.engine:
            rows, columns = np.asarray(state.engine).view(np.float64), self._batch.state.shape[1]
            self._batch.state[:] = rows[:, :columns]
            self._become(rows[:, columns:], jax.tree.map(np.asarray, state.bodies))
        if given is None or not all(map(operator.is_, *map(jax.tree.leaves, (given[1], state.bodies)))):
            bodies = jax.tree.map(np.asarray, state.bodies)
            self._fixed.become(bodies)
            self._free.put(bodies)
            self._become(self._numbers, bodies)

    def _become(self, numbers: np.ndarray, bodies: Bodies) -> None:
        """Make arms and objects those of `numbers`, see `Begin.dynamics`, and objects of the size that bodies have."""
        self._numbers, arm = numbers, self._arms.count if self._arms else 0
        if self._arms:
            self._arms.become(numbers[:, :arm])
        self._free.become(bodies, numbers[:, arm:])

    def _moved(self, bodies: Bodies, contact: np.ndarray) -> Moved:
        """State of NumPy rows: what is compiled takes them in faster than JAX would convert them here."""
        bodies = self._free.now(bodies)
        q = self._qpos[:, self._positions].astype(np.float32)
        qd = self._qvel[:, self._speeds].astype(np.float32)
        engine = np.concatenate([self._batch.state, self._numbers], axis=1).view(np.uint32)
        engine.flags.writeable = False  # who holds it holds what the arms are, see `_restore`
        self._given = cast("Array", engine), bodies
        opening = np.zeros((len(q), 0), np.float32)
        if self._gripper:
            opening = self._gripper.opening(self._qpos[:, self._fingers]).astype(np.float32)
        parts = (cast("Array", q), cast("Array", qd), bodies, cast("Array", contact), cast("Array", opening))
        # No tool: the engine's own site positions are one physics step old after a step.
        return Moved(*parts, engine=self._given[0])


class _Arms:
    """Arms that differ from each other by numbers `[B, count]` in -1 to 1: those of `Begin.dynamics` that vary."""

    def __init__(self, batch: Batch, servos: np.ndarray, joints: np.ndarray, varied: frozenset[str]) -> None:
        self._batch, self._servos, self._joints = batch, servos, joints
        names = ("actuator_gainprm", "actuator_biasprm", "dof_damping", "body_mass", "body_inertia")
        self._gain, self._bias, self._damping, self._mass, self._inertia = map(batch.expand, names)
        self._nominal = [
            np.array(field) for field in (self._gain, self._bias, self._damping, self._mass, self._inertia)
        ]
        self._payload = batch.model.body(PAYLOAD).id
        kinds = ["dynamics"] * (2 * len(joints) + 1) + ["lag"]
        self._vary = np.array([kind in varied for kind in kinds])
        self.count = int(self._vary.sum())
        self._nothing = np.array([0.0] * 2 * len(joints) + [-1.0, 0.0])
        self.numbers = np.full((batch.nsim, self.count), np.nan)

    def soonest(self) -> mujoco.MjModel:
        """Model of the arm that follows soonest, and is usual otherwise."""
        numbers = np.tile(self._nothing[self._vary], (self._batch.nsim, 1))
        numbers[:, -1] = -1.0
        self.become(numbers)
        return self._batch.get_model(0)

    def become(self, numbers: np.ndarray) -> None:
        """Make the arms those of `numbers`."""
        if np.array_equal(numbers, self.numbers):
            return
        self.numbers = np.array(numbers)
        every, n = np.tile(self._nothing, (len(numbers), 1)), len(self._joints)
        every[:, self._vary] = numbers
        gains, dampings, payload, lags = np.split(every, (n, 2 * n, 2 * n + 1), axis=1)
        gain, bias, damping, mass, inertia = self._nominal
        share = 1 + np.where(lags < 0, 1 - LEAST_LAG, MOST_LAG - 1) * lags
        stiffer = stiffening(1 / share)
        damped = bias[:, self._servos, 2] - damping[:, self._joints]
        stiff = (1 + GAIN_SPREAD * gains)[:, :, None]
        self._gain[:, self._servos] = gain[:, self._servos] * (stiff * stiffer[:, :, None])
        self._bias[:, self._servos] = bias[:, self._servos] * (stiff * stiffer[:, :, None])
        self._bias[:, self._servos, 2] = stiff[..., 0] * (bias[:, self._servos, 2] + (stiffer * share - 1) * damped)
        self._damping[:, self._joints] = damping[:, self._joints] * (1 + DAMPING_SPREAD * dampings)
        load = (1 + payload[:, 0]) / 2
        self._mass[:, self._payload] = mass[:, self._payload] * load
        self._inertia[:, self._payload] = inertia[:, self._payload] * load[:, None]
        self._batch.set_const()
