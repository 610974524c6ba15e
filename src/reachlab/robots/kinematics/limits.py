"""Limits of the joints that a model file states: position, speed and torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from reachlab.settings.validation import InputError

TURNS, TRAVEL = 2 * np.pi, 1.0
"""Position limits where a file states none, either way: of hinges [rad], and of slides [m]."""

LARGEST = 100.0
"""Position limits beyond this, either way, are none that any arm has [rad or m]."""

ON_JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
"""How actuators act that turn a joint; others have numbers of other things."""

Limits = tuple[float | None, ...]
"""A limit of each joint, None where the file states none."""


def own_servos(model: mujoco.MjModel) -> dict[int, int]:
    """Number of the file's position servo by number of its joint, of the joints that have just one actuator.

    It draws its joint to its command, by a spring as stiff as its gain, and damps it.
    """
    gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1]
    on_joints = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    servos = on_joints & (gain > 0) & (bias == -gain) & (model.actuator_gear[:, 0] == 1)
    servos &= model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_AFFINE)
    servos &= model.actuator_dyntype == int(mujoco.mjtDyn.mjDYN_NONE)
    joints, counts = np.unique(model.actuator_trnid[on_joints, 0], return_counts=True)
    alone = servos & np.isin(model.actuator_trnid[:, 0], joints[counts == 1])
    return {int(model.actuator_trnid[actuator, 0]): int(actuator) for actuator in np.flatnonzero(alone)}


def servo_range(model: mujoco.MjModel, joint: int) -> tuple[float, float] | None:
    """Least and largest command that the file's own position servo of a joint takes [rad or m]; None without bounds."""
    servo = own_servos(model).get(joint)
    if servo is None or not model.actuator_ctrllimited[servo]:
        return None
    low, high = model.actuator_ctrlrange[servo].tolist()
    return low, high


def position_limits(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    """Lower and upper limit of a joint [rad or m], as float32 numbers not beyond the file's, nor its servo's.

    Raises:
        ValueError: the servo takes no command within the joint's limits.
    """
    free = TRAVEL if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_SLIDE) else TURNS
    low, high = model.jnt_range[joint] if _is_ranged(model, joint) else (-free, free)
    if taken := servo_range(model, joint):
        if max(low, taken[0]) >= min(high, taken[1]):
            raise ValueError(
                f"joint {model.joint(joint).name!r} has the position limits {low:g} to {high:g}, and its servo takes"
                f" commands from {taken[0]:g} to {taken[1]:g}: they have to overlap"
            )
        low, high = max(low, taken[0]), min(high, taken[1])
    return _inward(low, np.inf), _inward(high, -np.inf)


def is_limited(model: mujoco.MjModel, joint: int) -> bool:
    """Whether the file gives a joint, or its servo, position limits that can be meant."""
    return _is_ranged(model, joint) or servo_range(model, joint) is not None


def _is_ranged(model: mujoco.MjModel, joint: int) -> bool:
    return bool(model.jnt_limited[joint]) and bool(np.abs(model.jnt_range[joint]).max() <= LARGEST)


def _inward(limit: float, inside: float) -> float:
    """The limit as a float32 number that is not beyond it."""
    rounded = float(np.float32(limit))
    beyond = rounded < limit if inside > limit else rounded > limit
    return float(np.nextafter(np.float32(rounded), np.float32(inside))) if beyond else rounded


def speed_limits(model: mujoco.MjModel, joints: Sequence[int]) -> Limits:
    """Speed limits of joints [rad/s or m/s], which MJCF has no place for but `<numeric name="speed_limit">`.

    It has one for each of these joints, or one for each of the file's, at least up to the last of these.

    Raises:
        InputError: it has another number of entries, or a negative one.
    """
    n = len(joints)
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, "speed_limit") < 0:
        return (None,) * n
    speeds = model.numeric("speed_limit").data
    rows = range(n) if len(speeds) == n else joints
    if not max(rows) < len(speeds) <= model.njnt or min(speeds) < 0:
        raise InputError(f"numeric 'speed_limit' has to be a positive number for each of the {n} joints, got {speeds}.")
    return tuple(float(speeds[row]) or None for row in rows)


def torque_limits(model: mujoco.MjModel, joints: Sequence[int]) -> Limits:
    """Torque limits of joints [Nm or N]: of the joint itself, else what its actuators can give together."""
    torques = dict.fromkeys(map(int, joints), 0.0)
    for actuator in np.flatnonzero(np.isin(model.actuator_trntype, ON_JOINTS)):
        joint = int(model.actuator_trnid[actuator, 0])
        if joint in torques:
            torques[joint] += _most(model, int(actuator))
    for joint, given in torques.items():
        if model.jnt_actfrclimited[joint]:
            own = _either_way(model.jnt_actfrcrange[joint])
            torques[joint] = min(own, given or own)
    return tuple(most or None for most in torques.values())


def force_limit(model: mujoco.MjModel, leads: Sequence[int], slopes: Mapping[int, float]) -> float | None:
    """Force [N] that moves something by which joints move in proportion, `slopes` in rad or m for each metre.

    It is what actuators can give together, or what the leading joints let them; None where the file states neither.
    """
    data, moment = mujoco.MjData(model), np.zeros((model.nu, model.nv))
    mujoco.mj_fwdPosition(model, data)
    mujoco.mju_sparse2dense(moment, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    way = np.zeros(model.nv)
    way[model.jnt_dofadr[list(slopes)]] = list(slopes.values())
    gear = np.abs(model.actuator_gear[:, 0])
    given = sum(_most(model, i) / gear[i] * abs(moment[i] @ way) for i in range(model.nu))
    limited = [j for j in leads if j in slopes and model.jnt_actfrclimited[j]]
    let = sum(_either_way(model.jnt_actfrcrange[j]) * abs(slopes[j]) for j in limited)
    return min((float(force) for force in (given, let) if force > 0), default=None)


def _most(model: mujoco.MjModel, actuator: int) -> float:
    """Largest torque of an actuator: its force range, else a motor's control range; times its gear; 0 of another."""
    gear = abs(float(model.actuator_gear[actuator, 0]))
    if model.actuator_forcelimited[actuator]:
        return gear * _either_way(model.actuator_forcerange[actuator])
    motor = model.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_NONE)
    if motor and model.actuator_ctrllimited[actuator]:
        gain = abs(float(model.actuator_gainprm[actuator, 0]))
        return gear * gain * _either_way(model.actuator_ctrlrange[actuator])
    return 0.0


def _either_way(ends: np.ndarray) -> float:
    """What a range `[2]` allows in both directions; one that ends at 0, or has it outside, in its own."""
    low, high = map(float, ends)
    return min(-low, high) if low < 0.0 < high else max(abs(low), abs(high))
