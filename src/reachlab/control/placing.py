"""Placing: an object is gripped, carried over a wall, set down, let go, and the hand goes away."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from reachlab.control.hand import velocity_to
from reachlab.control.lifting import Grip, approach, gripped, moved
from reachlab.control.situation import Drive, Situation
from reachlab.robots.kinematics.forward import norm

PUT, SET_DOWN = 0.006, 0.006
"""An object is let go where it is so near to its place along the table, and so near above it [m]."""

LOOSE = 2.5
"""An open hand leaves an object that is within this many times of both: what is gripped is known better than what is
measured, and seems to move as it is let go."""

OPENED = 0.008
"""The hand goes up once it is open by so much more than the object is wide [m]."""

AWAY = 0.1
"""Height above the object's place to which it goes [m]."""

HIGH = 0.01
"""So near to that height the hand rests: led by where it is measured, an arm that sags would creep on [m]."""

MARGIN = 0.02
"""Room below what is carried over a wall [m]."""

STEEP = 2.5
"""Near its place what is carried comes down with this slope, and goes up with it where it was gripped."""

SINK = 0.15
"""Largest speed with which an object is set down [m/s]."""


def place(drive: Drive, now: Situation) -> Array:
    """Displacement `[B, m]` of joints and gripper that takes the last body over the first one, a wall, to the goal."""
    grip, goal = gripped(drive, now), now.goal.position
    middle, width = now.tool_position + grip.way, 2 * now.bodies.extent[:, -1, 1]
    within = jnp.where(grip.closing, 1.0, LOOSE)
    put = (norm((goal - middle)[:, :2]) < within * PUT) & (middle[:, 2] < goal[:, 2] + within * SET_DOWN)
    up = jnp.where(now.opening[:, 0] > width + OPENED, goal[:, 2] + AWAY - now.tool_position[:, 2], 0.0)
    leaving = velocity_to(drive, up[:, None] * jnp.array([0.0, 0.0, 1.0]))
    closes, waits = grip.closes & ~put, grip.closes & ~grip.held
    velocity = jnp.where(waits[:, None], 0.0, approach(drive, now, grip))
    velocity = jnp.where(grip.held[:, None], _over(drive, now, grip, middle, goal), velocity)
    velocity = jnp.where(put[:, None], leaving, velocity)
    rests = jnp.arange(now.command.shape[-1]) < now.q.shape[-1]
    rests &= (put & (jnp.abs(up) < HIGH))[:, None]
    return jnp.where(rests, 0.0, moved(drive, now, velocity, grip.turn, closes))


def _over(drive: Drive, now: Situation, grip: Grip, middle: Array, goal: Array) -> Array:
    """Velocity `[B, 3]` of what is held: up, over the wall, and down at the goal."""
    top = now.bodies.position[:, 0, 2] + now.bodies.extent[:, 0, 2]
    cruise = top + now.bodies.extent[:, -1, 2] + MARGIN - goal[:, 2]
    way, high = goal - middle, middle[:, 2] - goal[:, 2]
    aside = norm(way[:, :2])
    rise = jnp.minimum(STEEP * jnp.maximum(aside - PUT, 0.0), cruise)
    # On the way up nothing goes aside before it is over the wall's edge, nor further than the slope down allows.
    free = jnp.clip(1 - (rise - high) / MARGIN, 0.0, 1.0)[:, None]
    velocity = velocity_to(drive, way + rise[:, None] * jnp.array([0.0, 0.0, 1.0])) * jnp.concatenate(
        [free, free, free * 0 + 1], -1
    )
    sinking = (aside < PUT) & (velocity[:, 2] < -SINK)
    velocity = jnp.where(sinking[:, None], velocity * SINK / -velocity[:, 2:], velocity)
    return grip.firm[:, None] * velocity
