"""The model that MuJoCo moves: the robot's own with the options of a configuration, and what is added to it."""

from __future__ import annotations

import copy
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from reachlab.control.contact_model import add_contacts
from reachlab.render.scene import add_table
from reachlab.robots.files.gripper import TIPS
from reachlab.robots.files.pictures import without_shapes
from reachlab.robots.kinematics.limits import own_servos
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.settings.validation import InputError
from reachlab.sims.mujoco_objects import add_objects
from reachlab.sims.wrench import add_wrist
from reachlab.tasks.task import EMPTY, Scene

PAYLOAD = "payload"
"""Name of the body that the payload is."""

PAYLOAD_RADIUS = 0.05
"""The payload is a ball of this radius about the tool point [m]."""


def _add_payload(spec: mujoco.MjSpec, tool: str, mass: float) -> None:
    site = spec.site(tool)
    body, place = (spec.body(tool), [0.0, 0.0, 0.0]) if site is None else (site.parent, site.pos)
    inertia = [0.4 * mass * PAYLOAD_RADIUS**2] * 3  # of a ball
    body.add_body(name=PAYLOAD, pos=place, mass=mass, inertia=inertia, ipos=[0, 0, 0], explicitinertial=True)


MOVING, RESTING, SETTLED, AT_REST = 0.3, 1.0, 10.0, 0.02
"""How long an arm is moved at full speed [s], how long it is waited for then [s], and besides in times of its lag; it
rests if no joint is as fast then [rad/s or m/s]."""


class Layout(NamedTuple):
    """Where in a model's arrays things are.

    Attributes:
        joints, speeds: numbers in `qpos` and `qvel` of the arm's joints `[n]`.
        servos: numbers in `ctrl` of their servos `[n]`.
        fingers, finger_servos: the same of the joints of a gripper that is driven.
        objects, object_speeds: numbers in `qpos` and `qvel` of the objects' poses `[K, 7]` and velocities `[K, 6]`.
        fixed: geoms of the bodies that do not move.
    """

    joints: np.ndarray
    speeds: np.ndarray
    servos: np.ndarray
    fingers: np.ndarray
    finger_servos: np.ndarray
    objects: np.ndarray
    object_speeds: np.ndarray
    fixed: list[int]


def physics_model(robot: Robot, config: SimConfig, scene: Scene = EMPTY, *, payload: bool = False) -> mujoco.MjModel:
    """Compiled model of `physics_spec`.

    Raises:
        InputError: the robot file does not compile with these options.
    """
    try:
        return physics_spec(robot, config, scene, payload=payload).compile()
    except InputError:
        raise
    except ValueError as error:
        why = " ".join(str(error).split()).rstrip(".")
        raise InputError(f"robot {robot.name!r} does not compile in MuJoCo: {why}.") from None


def physics_spec(robot: Robot, config: SimConfig, scene: Scene = EMPTY, *, payload: bool = False) -> mujoco.MjSpec:
    """Model of a robot with the options of a configuration.

    It has the bodies and contacts of a scene, see `add_contacts`, and a `payload` at the tool if asked for.

    Raises:
        InputError: the robot has no shapes, and is asked what it touches.
    """
    spec = robot.spec(pictures=config.collisions and not scene.contacts)
    spec.option.timestep = config.control_period / config.physics_steps
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # A state that is not finite must be noticed, not silently set back.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if scene.contacts:
        add_contacts(spec, robot, scene.bodies)
    elif scene.objects:
        without_shapes(spec, TIPS)
    elif config.collisions:
        add_table(spec, robot, solid=True)
    else:
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        without_shapes(spec)  # their poses alone take a seventh of the engine's time
    if config.gravity_compensation:
        for body in spec.bodies:
            body.gravcomp = 1.0
    if config.servo_lag is not None:
        _follow(spec, robot.chain.n, config.servo_lag)
    if payload:
        _add_payload(spec, robot.tool, robot.payload)
    if scene.objects:
        add_objects(spec, robot, scene)
    if scene.wrench:
        add_wrist(spec, robot)
    return spec


def _follow(spec: mujoco.MjSpec, n: int, lag: float) -> None:
    """Change the servos of an arm of `n` joints, which then follow a moving command by `lag` [s]."""
    model = spec.compile()
    servos, joints = own_servos(model), model.jnt_dofadr[:n]
    before = servo_lag(model, np.array([servos[joint] for joint in range(n)]), joints)
    for joint, (own, late) in enumerate(zip(model.dof_damping[joints], before, strict=True)):
        servo = spec.actuators[servos[joint]]
        stiffness = max(servo.gainprm[0] * float(stiffening(late / lag)), own / lag)
        servo.gainprm[0], servo.biasprm[1:3] = stiffness, [-stiffness, own - lag * stiffness]


def check_rest(model: mujoco.MjModel, robot: Robot, layout: tuple[np.ndarray, np.ndarray], config: SimConfig) -> None:
    """Make sure that an arm comes to rest after a motion at full speed: stiff servos swing where torque ends.

    Args:
        model: the arm's.
        robot: the arm.
        layout: numbers of its joints' positions and of their servos `[n]`.
        config: steps of the engine.

    Raises:
        InputError: it does not.
    """
    model, (positions, servos) = copy.copy(model), layout
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, n = mujoco.MjData(model), robot.chain.n
    home, lag = np.array(robot.home), max(servo_lag(model, servos, model.jnt_dofadr[:n]))
    low, high = np.array(robot.chain.lower), np.array(robot.chain.upper)
    way = np.where(home < (low + high) / 2, 1.0, -1.0) * np.array(robot.speed) * config.control_period
    data.qpos[positions] = data.ctrl[servos] = home
    for step in range(round((MOVING + RESTING + SETTLED * lag) / config.control_period)):
        if step * config.control_period < MOVING:
            data.ctrl[servos] = np.clip(data.ctrl[servos] + way, low, high)
        mujoco.mj_step(model, data, config.physics_steps)
    if not np.abs(data.qvel[model.jnt_dofadr[:n]]).max() < AT_REST:
        raise InputError(
            f"servos of robot {robot.name!r} that follow by {lag:.2g} s swing in steps of the engine of"
            f" {1000 * model.opt.timestep:.3g} ms: choose more --physics-steps, a longer --servo-lag, or leave"
            " randomise lag out."
        )


def stiffening(sooner: npt.ArrayLike) -> np.ndarray:
    """By what servos become stiffer that follow so many times sooner: they stay damped as they were.

    Those that follow later are as stiff as before, and damped more.
    """
    return np.maximum(sooner, 1.0) ** 2


def servo_lag(model: mujoco.MjModel, servos: np.ndarray, joints: np.ndarray) -> tuple[float, ...]:
    """Time by which each joint follows its servo's moving command [s]: damping, the joint's own too, by stiffness."""
    damping = model.dof_damping[joints] - model.actuator_biasprm[servos, 2]
    return tuple((damping / model.actuator_gainprm[servos, 0]).tolist())
