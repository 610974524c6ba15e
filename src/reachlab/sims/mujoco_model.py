"""The model that MuJoCo moves: the robot's own with the options of a configuration, and what is added to it."""

from __future__ import annotations

import mujoco
import numpy as np

from reachlab.render.scene import add_table
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.settings.validation import InputError
from reachlab.sims.mujoco_contacts import add_contacts

PAYLOAD = "payload"
"""Name of the body that the payload is."""

PAYLOAD_RADIUS = 0.05
"""The payload is a ball of this radius about the tool point [m]."""


def _add_payload(spec: mujoco.MjSpec, tool: str, mass: float) -> None:
    site = spec.site(tool)
    body, place = (spec.body(tool), [0.0, 0.0, 0.0]) if site is None else (site.parent, site.pos)
    inertia = [0.4 * mass * PAYLOAD_RADIUS**2] * 3  # of a ball
    body.add_body(name=PAYLOAD, pos=place, mass=mass, inertia=inertia, ipos=[0, 0, 0], explicitinertial=True)


def physics_model(robot: Robot, config: SimConfig, *, payload: bool = False, obstacles: int = 0) -> mujoco.MjModel:
    """Compiled model of a robot with the options of a configuration.

    It has a `payload` at the tool if asked for, and with `obstacles` so many of them and all contacts, see
    `add_contacts`.

    Raises:
        InputError: the robot file does not compile with these options.
    """
    if obstacles and config.collisions:
        raise InputError("collisions has no effect among obstacles, where every contact counts: leave it out.")
    if obstacles and not any(robot.capsules.links):
        raise InputError(f"robot {robot.name!r} has no shapes in its file: what it touches cannot be told.")
    spec = robot.spec(pictures=config.collisions)
    spec.option.timestep = config.control_period / config.physics_steps
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # A state that is not finite must be noticed, not silently set back.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    if obstacles:
        add_contacts(spec, robot, obstacles)
    elif config.collisions:
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


def servo_lag(model: mujoco.MjModel, servos: np.ndarray, joints: np.ndarray) -> tuple[float, ...]:
    """Time by which each joint follows its servo's moving command [s]: damping, the joint's own too, by stiffness."""
    damping = model.dof_damping[joints] - model.actuator_biasprm[servos, 2]
    return tuple((damping / model.actuator_gainprm[servos, 0]).tolist())
