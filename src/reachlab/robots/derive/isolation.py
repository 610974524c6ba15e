"""The arm alone in its file: other joints are locked, and every joint of its own has a position servo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

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


class Finger(NamedTuple):
    """A joint of a gripper, driven in proportion to the first one.

    Attributes:
        joint, body: its number, and that of the body that it moves.
        closed, open: its positions where the gripper is closed, and where it is widest open [rad or m].
        servo: that drives it.
        inertia: of its drive [kg m² or kg]; the file's own friction, damping and springs are taken out.
    """

    joint: int
    body: int
    closed: float
    open: float
    servo: Servo
    inertia: float


COUPLING = (0.008, 1.0)
"""Time constant [s] and damping ratio of what couples fingers (MuJoCo's `solref`): two steps of 4 ms."""

RIGID = (0.99, 0.999, 0.001, 0.5, 2.0)
"""Impedance of it (MuJoCo's `solimp`): with the usual 0.9 the light joints of a linkage give way when it grips."""


@dataclass(frozen=True)
class Isolation:
    """What is changed in a file so that it holds an arm and nothing else that moves.

    Attributes:
        joints: numbers of the arm's joints in the file, base to tool.
        poses: position `[3]` m and quaternion `[4]` wxyz, in the body above, of the bodies by number whose joints are
            locked.
        servos: by number of the joint, of those whose servos are not the file's own.
        fingers: the gripper's joints, which follow the arm's. Without them it is locked as `poses` has it.
    """

    joints: tuple[int, ...]
    poses: Mapping[int, tuple[tuple[float, ...], tuple[float, ...]]] = field(default_factory=dict)
    servos: Mapping[int, Servo] = field(default_factory=dict)
    fingers: tuple[Finger, ...] = ()


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
    """Change a spec of the file in place: joints but those that are driven, and what refers to them, are taken out."""
    bodies, joints = spec.bodies, spec.joints
    for number, joint in enumerate(joints):
        joint.name = joint.name or f"reachlab_joint_{number}"
    fingers = {finger.joint: finger for finger in isolation.fingers}
    _keep(spec, {joints[number].name for number in (*isolation.joints, *fingers)}, bool(fingers))
    free = {finger.body for finger in isolation.fingers}
    for number, (position, quaternion) in isolation.poses.items():
        if number not in free:
            body = bodies[number]
            body.set_frame(body.parent.add_frame())
            body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
            body.pos, body.quat = position, quaternion
    for number, servo in isolation.servos.items():
        _add_servo(spec, joints[number].name, servo)
    for finger in isolation.fingers:
        joint = joints[finger.joint]
        _add_servo(spec, joint.name, finger.servo)
        joint.armature, joint.frictionloss = finger.inertia, 0.0
        joint.damping[:], joint.stiffness[:] = 0.0, 0.0
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE  # commands are within them, and they could oppose couplings
        if finger is not isolation.fingers[0]:
            _couple(spec, joints, isolation.fingers[0], finger)


def _keep(spec: mujoco.MjSpec, own: set[str], grips: bool) -> None:
    """Take out the joints that are not among `own`, what refers to them, and what else moves or holds bodies."""
    others = [joint for joint in spec.joints if joint.name not in own]
    moved = [one for one in spec.actuators if one.trntype != mujoco.mjtTrn.mjTRN_JOINT or one.target not in own]
    foreign = [spec.equalities, moved]
    if others or grips:
        foreign = [spec.keys, *foreign, spec.tuples, spec.tendons, others]
    for elements in foreign:
        for element in elements:
            spec.delete(element)


def _add_servo(spec: mujoco.MjSpec, joint: str, servo: Servo) -> None:
    """Drive a joint by a servo, and by nothing else."""
    for actuator in spec.actuators:
        if actuator.target == joint:
            spec.delete(actuator)
    added = spec.add_actuator(name=f"reachlab_servo_{joint}", target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    # The file's defaults are those of its own motors.
    no, limited = mujoco.mjtLimited.mjLIMITED_FALSE, np.isfinite(servo.torque)
    added.gear, added.dyntype = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], mujoco.mjtDyn.mjDYN_NONE
    added.ctrllimited = added.actlimited = no
    added.ctrlrange = added.actrange = [0.0, 0.0]
    added.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE if limited else no
    added.forcerange = [-servo.torque, servo.torque] if limited else [0.0, 0.0]
    added.set_to_position(kp=servo.stiffness, kv=servo.damping)


def _couple(spec: mujoco.MjSpec, joints: Sequence[mujoco.MjsJoint], first: Finger, finger: Finger) -> None:
    """Hold a finger's joint where the first one's has it."""
    lead, joint = joints[first.joint], joints[finger.joint]
    slope = (finger.open - finger.closed) / (first.open - first.closed)
    offset = (finger.closed - joint.ref) - slope * (first.closed - lead.ref)
    kind, objects = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtObj.mjOBJ_JOINT
    equality = spec.add_equality(type=kind, objtype=objects, name1=joint.name, name2=lead.name)
    equality.data[:5] = [offset, slope, 0.0, 0.0, 0.0]
    equality.solref, equality.solimp = COUPLING, RIGID
