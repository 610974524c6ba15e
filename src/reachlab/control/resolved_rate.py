"""Resolved-rate control: joint displacements that bring the tool to a point, or keep it at one that moves.

Each step goes a share of the way (Whitney, "Resolved motion rate control of manipulators and human prostheses", IEEE
Trans. Man-Machine Systems 10(2), 1969), from where the arm will be once it has caught up with its command.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.situation import Drive, Situation
from reachlab.robots.kinematics.forward import forward_kinematics, norm
from reachlab.robots.kinematics.inverse import ik_point_step

TINY = 1e-6
"""Divides in place of a smaller number."""

NEAR_GAIN, FAR_GAIN = 0.5, 2.5
"""Gain at the goal and from `APPROACH` on: shares of the way that are commanded in a time of the servos' lag. With more
at the goal an arm whose servos lag swings about it; far from it their lag is foreseen. Chosen on the iiwa."""

APPROACH = 0.05
"""Distance from which on the gain falls to that at the goal, and the lag is foreseen less and less [m]: it is found
from measured speeds, whose noise would be felt at the goal."""

TOOL_SPEED = 1.5
"""Largest speed that is commanded of the tool [m/s]: with more, most joints are at their own limit, and the arm jerks
for little gain."""

SHAPED_GAIN, FORESEEN = 1.2, 0.75
"""Where commands are shaped, how much of the distance from a goal that moves is made up for in `SHAPING_TIME`, and the
share of the lag that is foreseen: with 3, and with all of it in a step, as without limits, arms swing; with 1.5 and 1
those that are measured late and whose joints follow within half of their usual lag."""

LOOK_AHEAD = 0.9
"""Control periods by which feed-forward looks further ahead than the lag: a command is followed in the next one."""


def resolved_rate(drive: Drive, now: Situation) -> Array:
    """Joint displacement `[B, n]` that brings the tool to the goal's position, in whatever orientation."""
    chain, lag, period = drive.robot.chain, np.array(drive.lag), drive.period
    way = now.goal.position - now.tool_position
    far = jnp.minimum(norm(way)[..., None] / APPROACH, 1.0)
    caught_up = now.q + far * jnp.array(lag) * now.qd
    way = now.goal.position - forward_kinematics(chain, caught_up).position
    gain = NEAR_GAIN + far * (FAR_GAIN - NEAR_GAIN)
    share = jnp.minimum(gain * period / max(drive.response.max(), TINY), 1.0)
    return _displaced(drive, now, caught_up, share * way)


def feed_forward(drive: Drive, now: Situation) -> Array:
    """Joint displacement `[B, n]` that keeps the tool at a goal that moves, whose velocity is fed forward.

    The command goes to where the goal will be once the arm has caught up with its command. With less than all of that
    in a step the arm would lag where the velocity changes.
    """
    chain, period = drive.robot.chain, drive.period
    lag = np.array(drive.lag) * (FORESEEN if drive.shaped else 1.0)
    caught_up = now.q + jnp.array(lag) * now.qd
    ahead = now.goal.position + (lag.max() + LOOK_AHEAD * period) * now.goal.velocity
    wanted = ahead - forward_kinematics(chain, caught_up).position
    if drive.shaped:
        along, share = LOOK_AHEAD * period * now.goal.velocity, min(SHAPED_GAIN * period / drive.response.max(), 1.0)
        wanted = along + share * (wanted - along)
    return _displaced(drive, now, caught_up, wanted)


def _displaced(drive: Drive, now: Situation, caught_up: Array, wanted: Array) -> Array:
    """Joint displacement that moves the tool by `wanted [B, 3]` m, at `TOOL_SPEED` at most, from joints `[B, n]`."""
    most = TOOL_SPEED * drive.period / (norm(wanted)[..., None] + TINY)
    commanded = now.command[..., : drive.robot.chain.n]
    return ik_point_step(drive.robot.chain, caught_up, commanded, wanted * jnp.minimum(most, 1.0))
