"""Limits of the joints that a model file states: position, speed and torque."""

from __future__ import annotations

from collections.abc import Sequence

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
    if len(speeds) not in (n, model.njnt):
        raise InputError(f"numeric 'speed_limit' has {len(speeds)} entries, the arm {n} joints; give one for each.")
    if min(speeds) < 0:
        raise InputError(f"numeric 'speed_limit' has the entry {min(speeds):g}, but a limit is a positive number.")
    return tuple(float(speed) or None for speed in speeds[:n])


def torque_limits(model: mujoco.MjModel, joints: Sequence[int]) -> Limits:
    """Torque limits of joints [Nm or N]: of the joint itself, else what its actuators can give together."""
    torques: dict[int, float | None] = dict.fromkeys(map(int, joints))
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        if joint in torques and (most := _most(model, actuator)):
            torques[joint] = (torques[joint] or 0.0) + most
    for joint, given in torques.items():
        if model.jnt_actfrclimited[joint]:
            own = float(np.abs(model.jnt_actfrcrange[joint]).max())
            torques[joint] = min(own, given or own)
    return tuple(torques.values())


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
