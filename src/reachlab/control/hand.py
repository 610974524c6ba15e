"""How a hand is led over things on a table: speeds on the way to a point, turns about the vertical, joint commands."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import turned
from reachlab.control.situation import Drive, Situation
from reachlab.robots.kinematics.forward import components, forward_kinematics, norm
from reachlab.robots.kinematics.inverse import DAMPING, ik_approach, ik_point_step
from reachlab.robots.kinematics.scalars import rotation_from_quaternion
from reachlab.robots.robot import Robot

TRAVEL, GAIN, BRAKE = 1.5, 15.0, 10.0
"""Of the tool on its way to a point: largest speed [m/s], speed over distance [1/s], and deceleration [m/s²]."""

SHAPED = 1.0, 6.0, 3.0
"""The same where commands are shaped: what is commanded then comes later, and with more the hand swings at its goal."""

PASSES = 3
"""Damped steps of inverse kinematics to the tool's pose after the servos' lag."""

STRETCHED = 1e-4
"""Damping of these steps of an arm with fewer than six joints, which does its work near where it is stretched out: with
that of others an error of rounding grows a thousandfold in three steps."""

TURN = 1.2
"""Largest turn of the hand from how it is held at home [rad]."""

ROLL = 0.1
"""Largest turn of the last joint in one of those steps, where it alone turns the hand [rad]."""

TINY = 1e-6
"""Added to a length that divides [m]."""


def pace(drive: Drive, usual: tuple[float, float, float], shaped: tuple[float, float, float], far: Array) -> Array:
    """Speed `[...]` m/s at so far from where to rest `[...]` m, by a largest speed, a gain and a deceleration."""
    fastest, gain, brake = shaped if drive.shaped else usual
    return jnp.minimum(jnp.minimum(fastest, gain * far), jnp.sqrt(2 * brake * far))


def velocity_to(drive: Drive, way: Array) -> Array:
    """Velocity `[B, 3]` m/s along a way `[B, 3]` m, at whose end the tool rests."""
    far = norm(way)[:, None] + TINY
    return way / far * pace(drive, (TRAVEL, GAIN, BRAKE), SHAPED, far)


def yaw(quaternion: Array) -> Array:
    """Yaw `[B]` rad, modulo a quarter turn, of a cube with orientation `[B, 4]` that lies on any of its faces."""
    x, y, _ = rotation_from_quaternion(*components(quaternion))
    first = jnp.abs(x[2]) < jnp.abs(y[2])
    return jnp.arctan2(jnp.where(first, x[1], y[1]), jnp.where(first, x[0], y[0]))


def faces(now: Situation) -> Array:
    """Yaw `[B]` rad, modulo a quarter turn, of the object's sides; of one that is round the hand's own."""
    bodies = now.bodies
    return jnp.where(bodies.round[:, -1], heading(now.tool_quaternion), yaw(bodies.quaternion[:, -1]))


def across(drive: Drive, now: Situation, angle: Array) -> Array:
    """Turn of the hand from how it is held at home `[B]` rad, with a side of its finger tips at an angle `[B]` rad.

    Of the four sides it is the one that takes the least turn, within `TURN` of home.
    """
    turn = turn_of(drive, now)
    wanted = turn + wrapped(angle - heading(jnp.array(drive.robot.down)[None]) - turn, np.pi / 2)
    return jnp.where(jnp.abs(wanted) > TURN, wanted - jnp.sign(wanted) * np.pi / 2, wanted)


def turn_of(drive: Drive, now: Situation) -> Array:
    """Turn of the hand about the vertical from how it is held at home `[B]` rad."""
    at_home = heading(jnp.array(drive.robot.down)[None])
    return wrapped(heading(now.tool_quaternion) - at_home, 2 * np.pi)


def heading(quaternion: Array) -> Array:
    """Angle about the vertical from x to an orientation's first axis `[B]`."""
    first = rotation_from_quaternion(*components(quaternion)).x
    return jnp.arctan2(jnp.asarray(first.y), jnp.asarray(first.x))


def wrapped(angle: Array, turn: float) -> Array:
    """An angle within half a turn of 0."""
    return angle - turn * jnp.round(angle / turn)


def towards(drive: Drive, now: Situation, velocity: Array, turn: Array) -> Array:
    """Joint displacement `[B, n]` to where the tool would be after the servos' lag, all joints slowed together.

    The tool is held as at home, but for a turn `[B]` rad about the vertical, which the last joint of an arm with fewer
    than six makes.
    """
    chain = drive.robot.chain
    held = jnp.broadcast_to(jnp.array(drive.robot.down), (len(turn), 4))
    quaternion = turned(held, turn)
    place = now.tool_position + max(*drive.lag, drive.period) * velocity

    def nearer(_: int, q: Array) -> Array:
        if not chain.poses:
            q = _rolled(drive.robot, q, quaternion)
        return ik_approach(chain, q, place, quaternion, DAMPING if chain.poses else STRETCHED)

    return _together(drive, now, jax.lax.fori_loop(0, PASSES, nearer, now.q))


def swing(drive: Drive, now: Situation, velocity: Array) -> Array:
    """The same with the hand in whatever orientation it comes to: faster, since its wrist swings too."""
    far = max(*drive.lag, drive.period) * velocity
    return _together(drive, now, now.q + ik_point_step(drive.robot.chain, now.q, now.q, far))


def _together(drive: Drive, now: Situation, q: Array) -> Array:
    """Displacement `[B, n]` of the command towards joints `[B, n]`, all of them slowed together."""
    step = q - now.command[..., : drive.robot.chain.n]
    most = drive.period * np.array(drive.robot.speed, np.float32)
    return step / jnp.maximum(jnp.abs(step / most).max(axis=-1, keepdims=True), 1.0)


def _rolled(robot: Robot, q: Array, quaternion: Array) -> Array:
    """Joint vectors `[B, n]` whose last joint turns the hand about the vertical towards that of `quaternion [B, 4]`."""
    chain, roll = robot.chain, np.eye(robot.chain.n)[-1]
    with jax.ensure_compile_time_eval():
        poses = forward_kinematics(chain, jnp.array(robot.home + ROLL * roll * [[0.0], [1.0]], jnp.float32))
        sense = float(jnp.round(wrapped(jnp.diff(heading(poses.quaternion))[0], 2 * np.pi) / ROLL))
    missing = wrapped(heading(quaternion) - heading(forward_kinematics(chain, q).quaternion), 2 * np.pi)
    last = q[..., -1] + sense * jnp.clip(missing, -ROLL, ROLL)
    last = jnp.clip(last, chain.lower[-1], chain.upper[-1])
    return jnp.concatenate([q[..., :-1], last[..., None]], axis=-1)
