"""Sliding: a puck is struck so that friction brings it to rest at a place out of reach."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.hand import across, swing, towards
from reachlab.control.pushing import planned, run_up
from reachlab.control.situation import RESPONSE, Situation
from reachlab.robots.kinematics.forward import norm

GRAVITY = 9.81
"""Of the earth [m/s²]."""

FASTEST = 1.5
"""Largest speed of the tool while it strikes [m/s]."""

STEER, SIDLE = 0.8, 0.15
"""Of the finger tips' way aside a strike takes back so much of its own speed for every 3 cm, and at least of this one
[m/s]: a hand that waits comes onto the line."""

DRIFT = 4.0
"""And of the puck's drift so many times."""

LEAD = 0.3
"""So much faster than the puck the hand is commanded at most [m/s]: what it gains in a servo's lag."""

GAIN, ENOUGH = 0.7, 0.99
"""Share of the missing speed that is made up in a step, and of the speed at which the hand stops: in a step more the
last of it is lost in what servos and contacts do."""

FULL = 1.005
"""Share of the speed at which friction alone would bring the puck to the goal: with 1 the median ends 9 mm short."""

SOFT = (0.15, 4.0)
"""The hand meets the puck with so much more than its speed [m/s], and more by so much for each metre before [1/s]."""

ALIGNED = 0.003
"""Aside of the line by less than this the hand strikes; by twice as much it waits [m]."""

CLOSE = 0.95
"""A puck that has left the hand with this share of the speed is let go; with less it is struck again."""

STRUCK, MET = 0.15, 0.05
"""Speed from which on a puck that the hand no longer touches is on its way, and from which on it has been met [m/s]."""

APART = 0.004
"""Distance from which on the hand no longer touches it [m]."""


HIGHEST = 0.006
"""The hand strikes where it is lower than so much above the height at which it pushes [m], at full speed below half."""


def slide(setup: Any, now: Situation) -> Array:
    """Joint displacement `[B, n]` that strikes the last body towards the goal; `setup` is a task's with an object.

    The hand pushes it until it is so fast that friction will bring it to rest at the goal, v² = 2 µ g × way, and stops.
    The speed is corrected in every step by what the puck is measured to have, so that the last step makes it.
    """
    state = planned(now)
    moving = now.bodies.velocity[:, -1, :2]
    speed = (moving * state.line).sum(axis=-1)
    needed = FULL * jnp.sqrt(2 * GRAVITY * setup.rules.object_friction * state.left)
    touches = state.gap < APART
    middle, base = now.bodies.position[:, -1], np.array(setup.robot.chain.frames[0][1])
    ahead = np.round([np.cos(setup.robot.front), np.sin(setup.robot.front), 0.0])
    beyond = norm((middle - base)[:, :2]) > max((corner - base) @ ahead for corner in setup.robot.workspace)
    gone = ((norm(moving) > STRUCK) & (speed > jnp.where(touches, ENOUGH, CLOSE) * needed)) | beyond
    wanted = speed + jnp.minimum(GAIN * (needed - speed) / (1 - math.exp(-setup.period / RESPONSE)), LEAD)
    near = speed + SOFT[0] + SOFT[1] * state.gap
    # The tips come down, and onto the line, before they strike.
    ahead = jnp.clip((HIGHEST + state.down / 6) / (HIGHEST / 2), 0.0, 1.0)
    ahead *= jnp.clip(2 - jnp.abs(state.aside) / ALIGNED, 0.0, 1.0)
    wanted = jnp.clip(jnp.where(touches, wanted, jnp.minimum(wanted, near) * ahead), 0.0, FASTEST)
    normal = jnp.stack([-state.line[:, 1], state.line[:, 0]], axis=-1)
    drift = jnp.where(touches, DRIFT * (moving * normal).sum(axis=-1), 0.0)
    strike = (
        state.line * wanted[:, None]
        - normal * (STEER * jnp.maximum(wanted, SIDLE) * state.aside / 0.03 + drift)[:, None]
    )
    strike = jnp.concatenate([strike, 2.5 * state.down[:, None]], axis=-1)
    turn = across(setup, now, jnp.arctan2(state.line[:, 1], state.line[:, 0]))
    before = towards(setup, now, run_up(setup, now, state), turn)
    # Held down until it meets the puck, the hand is square to it.
    met = touches | (norm(moving) > MET)
    struck = jnp.where(met[:, None], swing(setup, now, strike), towards(setup, now, strike, turn))
    step = jnp.where(state.ready[:, None], struck, before)
    return jnp.where(gone[:, None], swing(setup, now, jnp.zeros_like(strike)), step)
