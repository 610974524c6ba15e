"""Position servos for arms whose file has motors or no actuators: gains that follow from what the arm's joints move."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from reachlab.robots.derive.isolation import Servo
from reachlab.robots.kinematics.chain import tool_body
from reachlab.robots.kinematics.limits import position_limits

NATURAL_FREQUENCY, DAMPING_RATIO = 20.0, 1.0
"""Of a joint on its servo, with the largest inertia that it may have to move [rad/s]; with less it is damped more.
Joints follow a moving command by `LAG`, as the iiwa's do."""

LAG = 2 * DAMPING_RATIO / NATURAL_FREQUENCY
"""Time by which joints follow a moving command: damping, the joint's own included, by stiffness [s]."""

LARGEST_SAG = 0.02
"""A servo is at least so stiff that gravity and dry friction displace its joint by no more than this [rad or m]."""

SATURATION = 0.02
"""And at most so stiff that its torque is used up when the joint is this far from its command [rad or m]."""

HOLDING = 3.0
"""Torque limit where none is known, in torques that hold the arm against gravity in its hardest pose."""

ACCELERATION, LEAST_TORQUE = 20.0, 0.05
"""And at least what accelerates the joint so, with the largest inertia [rad/s² or m/s²]; never less than that torque
[Nm or N]."""

LARGEST_PAYLOAD, OF_MASS = 2.0, 0.1
"""Payload that arms vary by at most [kg], and in shares of the mass that the joints move."""

SPARED = 0.7
"""Share of a joint's torque that holding the arm and its largest payload may take, in half of all poses."""

SHORT_OF_BRAKING = 0.8
"""Share of the torque that stops a joint within `LAG` below which it is said to overshoot. Joint 5 of the Panda in
`pybullet_data` has 0.72 of it, and swings at the end of fast ways: `ik` hold 93 % of the poses."""

GRAVITY, TINY = 9.81, 1e-9
"""Of the earth [m/s²]; and a number that divides in place of a smaller one."""

BALL = 0.4 * 0.05**2
"""Moment of inertia of a payload, a ball of 5 cm, about its middle [kg m² a kg]."""

POSES = 256
"""Random joint vectors at which inertia and gravity are computed."""


@dataclass(frozen=True)
class Loads:
    """What an arm's joints have to move and to hold, at `POSES` random joint vectors.

    Attributes:
        inertia: what each joint moves, `[POSES, n]` [kg m² or kg].
        gravity: torque that holds the arm, `[POSES, n]` [Nm or N].
        lifting: torque that holds another kilogram at the tool, `[POSES, n]` [Nm/kg or N/kg].
        arm: how far the tool moves when a joint does, `[POSES, n]` [m/rad or 1].
        damping: the joints' own, of their bearings and gears, `[n]` [Nm s/rad or N s/m].
        friction: their dry friction, `[n]` [Nm or N].
    """

    inertia: np.ndarray
    gravity: np.ndarray
    lifting: np.ndarray
    arm: np.ndarray
    damping: np.ndarray
    friction: np.ndarray

    def resistance(self, speed: np.ndarray) -> np.ndarray:
        """Torque `[n]` that friction and damping take at joint speeds `[n]` [Nm or N]."""
        return self.friction + self.damping * speed


def find_loads(model: mujoco.MjModel, tool: str) -> Loads:
    """Loads of an arm, all of whose model's joints are its own, with a tool frame."""
    data, random, (body, _) = mujoco.MjData(model), np.random.default_rng(0), tool_body(model, tool)
    lower, upper = np.array([position_limits(model, joint) for joint in range(model.njnt)]).T
    addresses, dofs = model.jnt_qposadr, model.jnt_dofadr
    inertia, gravity, lifting, arm = (np.zeros((POSES, model.njnt)) for _ in range(4))
    full, linear = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
    for pose in range(POSES):
        data.qpos[addresses] = random.uniform(lower, upper)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        mujoco.mj_jacBody(model, data, linear, None, body)
        inertia[pose], gravity[pose], lifting[pose] = full.diagonal()[dofs], data.qfrc_bias[dofs], linear[2, dofs]
        arm[pose] = np.linalg.norm(linear[:, dofs], axis=0)
    damping, friction = model.dof_damping[dofs].copy(), model.dof_frictionloss[dofs].copy()
    return Loads(inertia, np.abs(gravity), GRAVITY * np.abs(lifting), arm, damping, friction)


def default_torques(loads: Loads, speed: np.ndarray) -> np.ndarray:
    """Torque limits `[n]` of joints of which none are known [Nm or N], for speed limits `[n]`: none overshoots."""
    rate = np.maximum(ACCELERATION, SHORT_OF_BRAKING * speed / LAG)
    accelerating = np.maximum(rate * loads.inertia.max(axis=0), LEAST_TORQUE)
    return np.maximum(HOLDING * loads.gravity.max(axis=0), accelerating) + loads.resistance(speed)


def payload(loads: Loads, torque: np.ndarray, mass: float) -> float:
    """Payload [kg] that joints with torque limits `[n]`, which move a mass [kg], can hold almost everywhere."""
    spared = np.maximum(SPARED * torque - loads.gravity, 0.0) / np.maximum(loads.lifting, TINY)
    return float(min(np.median(spared.min(axis=1)), LARGEST_PAYLOAD, OF_MASS * mass))


def largest_inertia(loads: Loads, load: float) -> np.ndarray:
    """The most that each joint has to move with a payload [kg], `[n]` [kg m² or kg]."""
    return (loads.inertia + load * (np.square(loads.arm) + BALL)).max(axis=0)


def servos(loads: Loads, torque: np.ndarray, load: float) -> list[Servo]:
    """Servos of all joints, for torque limits `[n]` and a payload [kg].

    The stiffness is inertia × frequency², more where gravity and friction would displace the joint too far, and no more
    than its torque allows, but so much that the joint's own damping does not make it follow later than `LAG`. The
    damping is what the joint's own leaves of `LAG` × stiffness.
    """
    held = (loads.gravity + load * loads.lifting).max(axis=0) + loads.friction
    stiffness = np.maximum(largest_inertia(loads, load) * NATURAL_FREQUENCY**2, held / LARGEST_SAG)
    stiffness = np.maximum(np.minimum(stiffness, torque / SATURATION), loads.damping / LAG)
    damping = np.maximum(LAG * stiffness - loads.damping, 0.0)
    return [Servo(*map(float, one)) for one in zip(stiffness, damping, torque, strict=True)]


def too_weak(loads: Loads, torque: np.ndarray, speed: np.ndarray) -> dict[int, float]:
    """Torque [Nm or N] to move at full speed, by number of the joint, of those whose limit `[n]` is less.

    It is what gravity takes in the hardest pose, with friction and damping. These joints follow fast commands later
    than `LAG`.
    """
    needed = loads.gravity.max(axis=0) + loads.resistance(speed)
    return {int(joint): float(needed[joint]) for joint in np.flatnonzero(needed > torque)}


def too_heavy(loads: Loads, torque: np.ndarray, speed: np.ndarray) -> dict[int, float]:
    """Torque [Nm or N] that stops a joint within `LAG` from full speed, by number, of those with far too little.

    It is for the largest inertia, without gravity; joints with less than `SHORT_OF_BRAKING` of it overshoot.
    """
    needed = loads.inertia.max(axis=0) * speed / LAG
    return {int(joint): float(needed[joint]) for joint in np.flatnonzero(SHORT_OF_BRAKING * needed > torque)}
