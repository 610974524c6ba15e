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

Limits = tuple[float | None, ...]
"""A limit of each joint, None where the file states none."""


def position_limits(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    """Lower and upper limit of a joint [rad or m], as float32 numbers not beyond the file's."""
    free = TRAVEL if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_SLIDE) else TURNS
    low, high = model.jnt_range[joint] if is_limited(model, joint) else (-free, free)
    return _inward(low, np.inf), _inward(high, -np.inf)


def is_limited(model: mujoco.MjModel, joint: int) -> bool:
    """Whether the file gives a joint position limits that can be meant."""
    return bool(model.jnt_limited[joint]) and bool(np.abs(model.jnt_range[joint]).max() <= LARGEST)


def _inward(limit: float, inside: float) -> float:
    """The limit as a float32 number that is not beyond it."""
    rounded = float(np.float32(limit))
    beyond = rounded < limit if inside > limit else rounded > limit
    return float(np.nextafter(np.float32(rounded), np.float32(inside))) if beyond else rounded


def speed_limits(model: mujoco.MjModel, n: int) -> Limits:
    """Speed limits `[n]` [rad/s or m/s], which MJCF has no place for but `<numeric name="speed_limit">`.

    Of one for every joint of the file, an arm that ends at an earlier tool takes the first.

    Raises:
        InputError: it has another number of entries, or a negative one.
    """
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, "speed_limit") < 0:
        return (None,) * n
    speeds = model.numeric("speed_limit").data
    if not n <= len(speeds) <= model.njnt or min(speeds) < 0:
        raise InputError(f"numeric 'speed_limit' has to be a positive number for each of the {n} joints, got {speeds}.")
    return tuple(float(speed) or None for speed in speeds[:n])


def torque_limits(model: mujoco.MjModel, joints: Sequence[int]) -> Limits:
    """Torque limits of joints [Nm or N]: of the joint itself, else what its actuators can give together."""
    torques: dict[int, float | None] = dict.fromkeys(map(int, joints))
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        if model.actuator_trntype[actuator] == int(mujoco.mjtTrn.mjTRN_TENDON):
            continue
        if joint in torques and (most := _most(model, actuator)):
            torques[joint] = (torques[joint] or 0.0) + most
    for joint, given in torques.items():
        if model.jnt_actfrclimited[joint]:
            own = float(np.abs(model.jnt_actfrcrange[joint]).max())
            torques[joint] = min(own, given or own)
    return tuple(torques.values())


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
    given = sum((_most(model, i) or 0.0) / gear[i] * abs(moment[i] @ way) for i in range(model.nu))
    limited = [j for j in leads if j in slopes and model.jnt_actfrclimited[j]]
    let = sum(float(np.abs(model.jnt_actfrcrange[j]).max()) * abs(slopes[j]) for j in limited)
    return min((float(force) for force in (given, let) if force > 0), default=None)


def _most(model: mujoco.MjModel, actuator: int) -> float | None:
    """Largest torque of an actuator: its force range, else a motor's control range; times its gear."""
    gear = abs(float(model.actuator_gear[actuator, 0]))
    if model.actuator_forcelimited[actuator]:
        return gear * float(np.abs(model.actuator_forcerange[actuator]).max())
    motor = model.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_NONE)
    if motor and model.actuator_ctrllimited[actuator]:
        gain = abs(float(model.actuator_gainprm[actuator, 0]))
        return gear * gain * float(np.abs(model.actuator_ctrlrange[actuator]).max())
    return None
