"""MuJoCo with full dynamics: gravity, inertia, and position servos with torque limits."""

from __future__ import annotations

from typing import cast

import mujoco
import numpy as np
from jax import Array
from mujoco.batch import Batch

from reachlab.jax_setup import jit
from reachlab.render.scene import add_table
from reachlab.robots.isolation import own_servos
from reachlab.robots.kinematics import forward_kinematics
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.settings.validation import InputError
from reachlab.sims import ArmState, BatchArray, Kind, Moved
from reachlab.sims.rendering import Drawn
from reachlab.tasks.task import Goal

GAIN_SPREAD, DAMPING_SPREAD = 0.15, 0.3
"""Where dynamics vary: relative spread of each joint's servo gains and of its damping."""

PAYLOAD_RADIUS = 0.05
"""The payload is a ball of this radius about the tool point [m]."""


class MujocoSimulator(Drawn):
    """Arms under full dynamics, stepped together on all cores.

    A control period is `physics_steps` steps of the engine, with the joints' targets held. The engine's state, float64
    rows, travels in `ArmState.engine` as its bits, so that any state can be continued from exactly.
    """

    kind: Kind = "host"

    def __init__(
        self, robot: Robot, config: SimConfig, num_envs: int, threads: int = 0, *, randomise_dynamics: bool = False
    ) -> None:
        """Simulator of `num_envs` arms on `threads` threads, 0 for one a core; results do not depend on them."""
        super().__init__(robot, config, num_envs, threads, randomise_dynamics=randomise_dynamics)
        self._model = physics_model(robot, config, payload=randomise_dynamics)
        self._substeps = config.physics_steps
        self._batch = Batch(self._model, nsim=num_envs, nthread=threads)
        self._qpos, self._qvel, self._ctrl = (self._batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        n = robot.chain.n
        self._positions, self._speeds = self._model.jnt_qposadr[:n], self._model.jnt_dofadr[:n]
        servos = own_servos(self._model, range(n))
        self._servos = np.array([servos[joint] for joint in range(n)])
        self.lag = _lag(self._model, self._servos, self._speeds)
        self._arms = _Arms(self._batch, self._servos, self._speeds) if randomise_dynamics else None
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
    ) -> ArmState:
        """See `Simulator.reset`."""
        del goal
        chosen = np.ones(len(q), bool) if state is None or mask is None else np.asarray(mask)
        self._restore(state)
        self._batch.state[chosen] = self._begin
        for rows, columns in ((self._qpos, self._positions), (self._ctrl, self._servos)):
            rows[np.ix_(chosen, columns)] = np.asarray(q)[chosen]
        if self._arms and dynamics is not None:
            self._arms.become(np.where(chosen[:, None], np.asarray(dynamics, np.float64), self._arms.sampled))
        moved = self._moved()
        pose = self._pose(moved.q)
        return ArmState(moved.q, moved.qd, pose.position, pose.quaternion, moved.engine)

    def step(self, state: ArmState | Moved, target_q: BatchArray) -> Moved:
        """See `Simulator.step`.

        Raises:
            FloatingPointError: the engine warned, e.g. of a state that is not finite or of a full contact buffer.
        """
        self._restore(state)
        self._ctrl[:, self._servos] = np.asarray(target_q)
        self._batch.step(nstep=self._substeps)
        warnings = self._batch.warning[..., 1]  # [B, kinds], how often; beside it stands what the last one was about
        if warnings.any():
            index, kind = np.argwhere(warnings)[0]
            warnings[:] = 0
            raise FloatingPointError(f"MuJoCo warned of {mujoco.mjtWarning(kind).name[7:]} in environment {index}")
        return self._moved()

    def _restore(self, state: ArmState | Moved | None) -> None:
        """Make the arms, which are about to move, those of a state; mostly they are."""
        given, self._given = self._given, None
        if state is None or given is state.engine:
            return
        rows, columns = np.asarray(state.engine).view(np.float64), self._batch.state.shape[1]
        self._batch.state[:] = rows[:, :columns]
        if self._arms:
            self._arms.become(rows[:, columns:])

    def _moved(self) -> Moved:
        """State of NumPy rows: what is compiled takes them in faster than JAX would convert them here."""
        q = self._qpos[:, self._positions].astype(np.float32)
        qd = self._qvel[:, self._speeds].astype(np.float32)
        rows = [self._batch.state, *([self._arms.sampled] if self._arms else [])]
        engine = np.concatenate(rows, axis=1).view(np.uint32)
        engine.flags.writeable = False  # who holds it holds what the arms are, see `_restore`
        self._given = cast("Array", engine)
        # No tool: the engine's own site positions are one physics step old after a step.
        return Moved(cast("Array", q), cast("Array", qd), engine=self._given)


class _Arms:
    """Arms that differ from each other by `sampled [B, 2 n + 1]` in -1 to 1: servo gains, damping and payload."""

    def __init__(self, batch: Batch, servos: np.ndarray, joints: np.ndarray) -> None:
        self._batch, self._servos, self._joints = batch, servos, joints
        names = ("actuator_gainprm", "actuator_biasprm", "dof_damping", "body_mass", "body_inertia")
        self._gain, self._bias, self._damping, self._mass, self._inertia = map(batch.expand, names)
        self._nominal = [
            np.array(field) for field in (self._gain, self._bias, self._damping, self._mass, self._inertia)
        ]
        self._payload = batch.model.body(PAYLOAD).id
        self.sampled = np.full((batch.nsim, 2 * len(joints) + 1), np.nan)

    def become(self, sampled: np.ndarray) -> None:
        """Make the arms those of `sampled`."""
        if np.array_equal(sampled, self.sampled):
            return
        self.sampled = np.array(sampled)
        n = len(self._joints)
        gains, dampings, payload = np.split(self.sampled, (n, 2 * n), axis=1)
        gain, bias, damping, mass, inertia = self._nominal
        stiff = 1 + GAIN_SPREAD * gains[:, :, None]
        self._gain[:, self._servos] = gain[:, self._servos] * stiff
        self._bias[:, self._servos] = bias[:, self._servos] * stiff
        self._damping[:, self._joints] = damping[:, self._joints] * (1 + DAMPING_SPREAD * dampings)
        load = (1 + payload[:, 0]) / 2
        self._mass[:, self._payload] = mass[:, self._payload] * load
        self._inertia[:, self._payload] = inertia[:, self._payload] * load[:, None]
        self._batch.set_const()


PAYLOAD = "payload"
"""Name of the body that the payload is."""


def _add_payload(spec: mujoco.MjSpec, tool: str, mass: float) -> None:
    site = spec.site(tool)
    body, place = (spec.body(tool), [0.0, 0.0, 0.0]) if site is None else (site.parent, site.pos)
    inertia = [0.4 * mass * PAYLOAD_RADIUS**2] * 3  # of a ball
    body.add_body(name=PAYLOAD, pos=place, mass=mass, inertia=inertia, ipos=[0, 0, 0], explicitinertial=True)


def physics_model(robot: Robot, config: SimConfig, *, payload: bool = False) -> mujoco.MjModel:
    """Compiled model of a robot with the options of a configuration, and a `payload` at the tool.

    Raises:
        InputError: the robot file does not compile with these options.
    """
    spec = robot.spec(pictures=config.collisions)
    spec.option.timestep = config.control_period / config.physics_steps
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # A state that is not finite must be noticed, not silently set back.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if config.collisions:
        add_table(spec, robot, solid=True)
    else:
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    if config.gravity_compensation:
        for body in spec.bodies:
            body.gravcomp = 1.0
    if payload:
        _add_payload(spec, robot.tool, robot.payload)
    try:
        return spec.compile()
    except ValueError as error:
        raise InputError(f"robot {robot.name!r} does not compile in MuJoCo: {' '.join(str(error).split())}.") from None


def _lag(model: mujoco.MjModel, servos: np.ndarray, joints: np.ndarray) -> tuple[float, ...]:
    """Time by which each joint follows its servo's moving command [s]: damping, the joint's own too, by stiffness."""
    damping = model.dof_damping[joints] - model.actuator_biasprm[servos, 2]
    return tuple((damping / model.actuator_gainprm[servos, 0]).tolist())
