"""Limits of the joints that a model file states: position, speed and torque."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from reachlab.settings.validation import InputError


def position_limits(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    """Lower and upper limit of a joint [rad or m], infinite where it has none; as float32 numbers not beyond them."""
    low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
    return _inward(low, np.inf), _inward(high, -np.inf)


def _inward(limit: float, inside: float) -> float:
    """The limit as a float32 number that is not beyond it."""
    rounded = np.float32(limit)
    beyond = rounded < limit if inside > limit else rounded > limit
    return float(np.nextafter(rounded, np.float32(inside)) if beyond else rounded)


def speed_limits(model: mujoco.MjModel, n: int) -> tuple[float, ...] | None:
    """Speed limits `[n]` [rad/s or m/s], which a file states as `<numeric name="speed_limit">`; None without it.

    Raises:
        InputError: it has another number of entries.
    """
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, "speed_limit") < 0:
        return None
    speeds = model.numeric("speed_limit").data
    if len(speeds) != n:
        raise InputError(f"numeric 'speed_limit' has {len(speeds)} entries, the arm {n} joints; give one for each.")
    return tuple(float(speed) for speed in speeds)


def torque_limits(model: mujoco.MjModel, ids: Sequence[int]) -> tuple[float, ...] | None:
    """Torque limits of the joints' actuators; None where no joint has any."""
    torques = dict.fromkeys(ids, float("inf"))
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        if joint in torques and model.actuator_forcelimited[actuator]:
            torques[joint] = float(model.actuator_forcerange[actuator, 1])
    return tuple(torques.values()) if np.isfinite(list(torques.values())).any() else None
