"""The arm alone in its file: other joints are locked, and every joint of its own has a position servo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np


@dataclass(frozen=True)
class Servo:
    """A position servo: torque = `stiffness` × (command − joint) − `damping` × speed, at most `torque`.

    Units are Nm/rad (N/m), Nm s/rad (N s/m) and Nm (N).
    """

    stiffness: float
    damping: float
    torque: float


@dataclass(frozen=True)
class Isolation:
    """What is changed in a file so that it holds an arm and nothing else that moves.

    Attributes:
        joints: numbers of the arm's joints in the file, base to tool.
        poses: position `[3]` m and quaternion `[4]` wxyz, in the body above, of the bodies by number whose joints are
            locked.
        servos: by number of the joint, of those whose servos are not the file's own.
    """

    joints: tuple[int, ...]
    poses: Mapping[int, tuple[tuple[float, ...], tuple[float, ...]]] = field(default_factory=dict)
    servos: Mapping[int, Servo] = field(default_factory=dict)


def own_servos(model: mujoco.MjModel, joints: Sequence[int]) -> dict[int, int]:
    """Number of the file's position servo by number of its joint, of the joints that have just one actuator."""
    acting: dict[int, list[int]] = {int(joint): [] for joint in joints}
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        if model.actuator_trntype[actuator] == int(mujoco.mjtTrn.mjTRN_JOINT) and joint in acting:
            acting[joint].append(actuator)
    return {joint: found[0] for joint, found in acting.items() if len(found) == 1 and _is_servo(model, found[0])}


def _is_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator draws its joint to its command, by a spring as stiff as its gain, and damps it."""
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    return bool(
        model.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_AFFINE)
        and model.actuator_dyntype[actuator] == int(mujoco.mjtDyn.mjDYN_NONE)
        and model.actuator_gear[actuator, 0] == 1
        and gain[0] > 0
        and bias[1] == -gain[0]
    )


def isolate(model: mujoco.MjModel, joints: Sequence[int], home: np.ndarray) -> Isolation:
    """What has to change in a file for an arm with these joints, the others locked where `home [nq]` has them."""
    data = mujoco.MjData(model)
    data.qpos[:] = home
    mujoco.mj_kinematics(model, data)
    locked = {int(model.jnt_bodyid[joint]) for joint in range(model.njnt) if joint not in joints}
    poses = {}
    for body in locked:
        position, quaternion, inverse = np.zeros(3), np.zeros(4), np.zeros(4)
        above = int(model.body_parentid[body])
        mujoco.mju_negQuat(inverse, data.xquat[above])
        mujoco.mju_rotVecQuat(position, data.xpos[body] - data.xpos[above], inverse)
        mujoco.mju_mulQuat(quaternion, inverse, data.xquat[body])
        poses[body] = (tuple(position.tolist()), tuple(quaternion.tolist()))
    return Isolation(tuple(map(int, joints)), poses)


def apply(spec: mujoco.MjSpec, isolation: Isolation) -> None:
    """Change a spec of the file in place."""
    bodies, joints = spec.bodies, spec.joints
    own = [joints[number] for number in isolation.joints]
    for number, joint in enumerate(joints):
        joint.name = joint.name or f"reachlab_joint_{number}"
    if len(own) != len(joints):
        _lock(spec, bodies, {joint.name for joint in own}, isolation.poses)
    for number, servo in isolation.servos.items():
        name = joints[number].name
        for actuator in spec.actuators:
            if actuator.target == name:
                spec.delete(actuator)
        added = spec.add_actuator(name=f"reachlab_servo_{name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        added.set_to_position(kp=servo.stiffness, kv=servo.damping)
        if np.isfinite(servo.torque):
            added.forcerange = [-servo.torque, servo.torque]


def _lock(
    spec: mujoco.MjSpec,
    bodies: Sequence[mujoco.MjsBody],
    own: set[str],
    poses: Mapping[int, tuple[tuple[float, ...], tuple[float, ...]]],
) -> None:
    """Take out all joints but the arm's own, and what refers to them."""
    for kind in (spec.keys, spec.sensors, spec.equalities, spec.tuples):
        for element in kind:
            spec.delete(element)
    for actuator in spec.actuators:
        if actuator.trntype != mujoco.mjtTrn.mjTRN_JOINT or actuator.target not in own:
            spec.delete(actuator)
    for element in (*spec.tendons, *(joint for joint in spec.joints if joint.name not in own)):
        spec.delete(element)
    for number, (position, quaternion) in poses.items():
        body = bodies[number]
        body.set_frame(body.parent.add_frame())
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.pos, body.quat = position, quaternion
