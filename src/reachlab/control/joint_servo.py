"""Joint servoing: every joint goes to where the goal has it, each by itself."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.situation import Drive, Situation

TINY = 1e-6
"""Divides in place of a smaller number."""

NEAR_GAIN, FAR_GAIN = 0.5, 1.0
"""Gain at the goal and from `APPROACH` on: shares of the way that are commanded in a time of the servo's lag."""

APPROACH = 0.1
"""Distance from which on the gain falls to that at the goal [rad or m]."""

LAG_COMPENSATION = 0.4
"""Share of what its servo's lag will cost a joint in speed that is commanded at once, far from the goal. With more it
arrives hardly sooner, and jerks twice as much."""


def joint_servo(drive: Drive, now: Situation) -> Array:
    """Joint displacement `[B, n]` towards the goal's joints.

    A joint's speed is proportional to its own way, up to its limit: no Jacobian is singular, and no limit lies in
    between.
    """
    lag, most = np.array(drive.lag), jnp.array(drive.robot.speed)
    way = now.goal.joints - now.q
    far = jnp.minimum(jnp.abs(way) / APPROACH, 1.0)
    rate = jnp.minimum((NEAR_GAIN + far * (FAR_GAIN - NEAR_GAIN)) / np.maximum(drive.response, TINY), 1 / drive.period)
    speed = jnp.clip(rate * way, -most, most)
    return drive.period * speed + far * LAG_COMPENSATION * lag * (speed - now.qd)
