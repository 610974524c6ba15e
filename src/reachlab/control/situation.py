"""What controllers, observations and agents may use: the arm as it is driven, what is measured, what is asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import Bodies
from reachlab.control.motion_limits import MotionLimits
from reachlab.robots.kinematics.forward import Pose, forward_kinematics, norm
from reachlab.robots.robot import Robot

RESPONSE = 0.025
"""Time constant with which a joint takes the speed that is commanded [s]: of a servo's damping and its inertia."""

SHAPING_TIME = 0.1
"""Time in which a command that is shaped takes up a speed that is wanted [s]: as limits are that nobody states."""

WRENCH = 6
"""Numbers of a wrench: a force [N] and a torque [Nm]."""


@dataclass(frozen=True)
class Drive:
    """An arm and how it follows commands; constants known while tracing.

    Attributes:
        robot: the arm.
        period: time from one command to the next [s].
        lag: time by which each joint follows its command `[n]` [s].
        late: mean age of what is measured of the joints [s].
        shaped: commands are kept within limits of acceleration and jerk, as those of an exported controller.
    """

    robot: Robot
    period: float
    lag: tuple[float, ...]
    late: float = field(default=0.0, kw_only=True)
    shaped: bool = field(default=False, kw_only=True)

    @property
    def response(self) -> np.ndarray:
        """Times `[n]` in which joints take up a speed that is wanted: of their servos, or of shaped commands [s]."""
        return np.maximum(self.lag, SHAPING_TIME if self.shaped else 0.0)


def shaped_within(drive: Drive) -> MotionLimits:
    """Limits of acceleration and jerk, and the others, within which commands can be shaped."""
    return MotionLimits(*drive.robot.commands, period=drive.period)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Goal:
    """Where something is asked to be. What a task does not ask for is an array without numbers, `[..., 0]`.

    Attributes:
        position: `[..., 3]` [m].
        quaternion: `[..., 4]`, wxyz, where an orientation is asked for.
        joints: joints `[..., n]` at which the tool is there [rad or m], where they have been looked for.
        velocity: `[..., 3]` [m/s], where it moves.
        path: on which it moves `[..., k]`, see `paths`; not a number once it was taken off it.
    """

    position: Array
    quaternion: Array
    joints: Array
    velocity: Array
    path: Array

    @classmethod
    def at(
        cls,
        position: Array,
        *,
        quaternion: Array | None = None,
        joints: Array | None = None,
        velocity: Array | None = None,
        path: Array | None = None,
    ) -> Goal:
        """Goal of which nothing is asked but what is given."""
        nothing = jnp.zeros((*jnp.shape(position)[:-1], 0))
        parts = (quaternion, joints, velocity, path)
        return cls(position, *(nothing if part is None else part for part in parts))

    def distance(self, position: Array) -> Array:
        """Distance `[...]` m from a place `[..., 3]` m to the goal."""
        return norm(position - self.position)

    def moves(self) -> Array:
        """Whether it moves by itself `[...]`."""
        return (~jnp.isnan(self.path)).any(axis=-1)


class Situation(NamedTuple):
    """What observations, actions and baselines may use, for a batch; `n` joints and `m` actuators, see `Robot`.

    Attributes:
        q, qd: joints `[B, n]` [rad or m] and their speeds, as measured.
        tool_position, tool_quaternion: of the tool at these joints, `[B, 3]` [m] and `[B, 4]` wxyz.
        goal: what is asked for.
        command: the last command `[B, m]` [rad or m].
        last_action: `[B, a]`.
        bodies: what is beside the arm `[B, K]`.
        contact: whether the arm touched anything in the last control period `[B]`; `[B, 0]` where that is not judged.
        achieved: where the tool truly is, or what the task moves.
        opening: of the gripper, as measured `[B, 1]` [m]; `[B, 0]` where none is driven.
        picture: the camera's `[B, SIZE, SIZE]` uint8, where the observation holds one.
        wrench: force and torque at the wrist, as measured `[B, 6]` [N, Nm]; None where they are not.
    """

    q: Array
    qd: Array
    tool_position: Array
    tool_quaternion: Array
    goal: Goal
    command: Array
    last_action: Array
    bodies: Bodies
    contact: Array
    achieved: Pose
    opening: Array
    picture: Array | None = None
    wrench: Array | None = None


def up_to_date(drive: Drive, now: Situation) -> Situation:
    """The situation with the joints where they have come to since they were measured.

    Their speed goes over to the one at which they lag behind the command by `lag`, but where commands that are shaped
    follow a goal that moves. Joints without lag are there.
    """
    if not drive.late:
        return now
    chain, lag = drive.robot.chain, np.maximum(drive.lag, drive.late)
    # A motion that is shaped goes on at its speed, and how far gravity displaces a joint is taken for none.
    steady = drive.shaped and now.goal.velocity.size
    share = 0.0 if steady else 1 - math.exp(-drive.late / RESPONSE)
    qd = now.qd + share * ((now.command[..., : chain.n] - now.q) / lag.astype(np.float32) - now.qd)
    q = jnp.where(np.array(drive.lag) > 0, now.q + drive.late * now.qd, now.command[..., : chain.n])
    pose = forward_kinematics(chain, q)
    return now._replace(q=q, qd=qd, tool_position=pose.position, tool_quaternion=pose.quaternion)
