"""The wrench at the wrist: what a sensor of force and torque in the last joint of an arm measures.

It is the force [N] and the torque [Nm] with which all that the last joint holds acts on the rest of the arm: by its
weight, by its inertia, and by what touches it. Both are in the frame of the last moving link as the robot's file has
it, the torque about its origin. So a hand at rest pulls down by its weight, and one that presses on a table pushes up.
MuJoCo's sensors `force` and `torque` there (XML reference, sensor/force) have the opposite sign.
"""

from __future__ import annotations

import mujoco
import numpy as np

from reachlab.control.situation import WRENCH
from reachlab.robots.robot import Robot

WRIST = "reachlab_wrist"
"""Name of the frame that is added, and begin of the names of its sensors."""

_Sensor = mujoco.mjtSensor


def add_wrist(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add the frame of the last moving link of an arm, and the sensors there."""
    spec.joints[robot.chain.n - 1].parent.add_site(name=WRIST)
    for kind in (_Sensor.mjSENS_FORCE, _Sensor.mjSENS_TORQUE):
        spec.add_sensor(name=f"{WRIST}_{kind.name}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=WRIST)


def measured(model: mujoco.MjModel, sensors: np.ndarray) -> np.ndarray:
    """The wrench `[..., 6]` of a model's sensor data `[..., s]`."""
    first = model.sensor(f"{WRIST}_{_Sensor.mjSENS_FORCE.name}").adr[0]
    return -sensors[..., first : first + WRENCH].astype(np.float32)


class Newton:
    """The wrench of an arm of which another engine knows the motion and the contacts, by the laws of Newton and Euler.

    Gravity pulls at what the last joint holds, whether or not that engine leaves its compensation to the motors.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Of a model with the sensors of `add_wrist`."""
        self._model, self._data = model, mujoco.MjData(model)
        self._body = int(model.site(WRIST).bodyid[0])

    def wrench(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, touch: np.ndarray) -> np.ndarray:
        """The wrench `[6]` at positions, speeds and accelerations `[m]` of the joints.

        `touch [6]` is the force [N] of all contacts of the hand, and its moment about the world's origin [Nm].
        """
        model, data, m = self._model, self._data, len(q)
        data.qpos[:m], data.qvel[:m], data.qacc[:m] = q, qd, qdd
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        force, moment = touch[:3], touch[3:]
        data.xfrc_applied[self._body] = *force, *(moment - np.cross(data.xipos[self._body], force))
        mujoco.mj_rnePostConstraint(model, data)
        mujoco.mj_sensorAcc(model, data)
        return measured(model, data.sensordata)
