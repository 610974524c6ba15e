"""Pushing: an object on a table is moved to a place by closed finger tips behind it."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from reachlab.control.hand import TINY, TRAVEL, across, pace, towards, velocity_to, yaw
from reachlab.control.situation import Drive, Situation
from reachlab.robots.files.gripper import BEYOND, GRIPPERS
from reachlab.robots.kinematics.forward import norm

LOW, OVER = 0.015, 0.022
"""Height of the grasp point above the table while it pushes, and above the object's top on its way round it [m]."""

TIP = GRIPPERS["parallel"].tip[0]
"""From the middle of the finger tips to their flat sides [m]."""

BEHIND = 0.016
"""From the place where finger tips would touch to that from which a push begins [m]."""

ASIDE, FAR_BEHIND, INSIDE = 0.018, 0.05, 0.045
"""A push goes on while the finger tips are so little aside of its line, so near behind the object and no further in
it [m]."""

SEEN = 0.004
"""So far in an object tips are taken to be in one that is measured beside where it is, not in one seen late [m]."""

OVERLAP, CLEAR = 0.008, 0.002
"""Least height of what the finger tips and the object have in common while they push, and distance of tips that come
down behind it [m]."""

PUSH, PUSH_GAIN, PUSH_BRAKE = 0.6, 10.0, 2.0
"""Of the tool while it pushes, as in `hand`. Friction of 0.3 stops an object that slides ahead with 3 m/s²."""

PUSH_SHAPED = 0.3, 4.0, 0.6
"""The same where commands are shaped."""

DOWN_GAIN, LEVEL = 6.0, 0.02
"""Of the tool on its way to that height: speed over distance [1/s]. So far from it a push is at half its speed, and
half as far at its full one [m]."""

STEER = 2.0
"""Of the finger tips' way aside a push takes back so much of its own speed for every 3 cm."""

LATCH, DONE, AGAIN = 0.015, 0.006, 0.009
"""Distances from the goal from which on the line of a push no longer turns to it, at which a push has ended, and at
which a hand that rests begins another [m]."""

LEAST = 0.003
"""What may be left of a push when it ends [m]: friction in the joints holds a hand that has so little left to push."""

DONE_SEEN = 0.012, 0.025
"""The last two of these where both are seen in a picture [m]: it shows them elsewhere as the hand moves."""

STILL = 0.02
"""A hand rests where no joint is faster [rad/s]."""

STRAY = 0.5
"""Cosine of the angle between that line and the one to the goal below which the object has to be pushed anew."""


class Push(NamedTuple):
    """Where things are in the plane of the table.

    Attributes:
        line: unit vector `[B, 2]` of a push.
        left: what is left of it `[B]` [m].
        along, aside: where the tool is along and beside that line, from the object's middle `[B]` [m].
        gap: between finger tips and object, along the line `[B]` [m].
        ready: whether the finger tips are where a push begins `[B]`.
        down: vertical velocity of the tool to the height at which it pushes `[B]` [m/s].
    """

    line: Array
    left: Array
    along: Array
    aside: Array
    gap: Array
    ready: Array
    down: Array


def push(drive: Drive, now: Situation, done: float = DONE, again: float = AGAIN) -> Array:
    """Joint displacement `[B, n]` that pushes the first body to the goal, within `done`; see `AGAIN`.

    The tool goes round the object to behind it, comes down and pushes, with a correction aside like that of a trailer
    that is backed; it remembers nothing.
    """
    state = planned(now)
    speed = pace(drive, (PUSH, PUSH_GAIN, PUSH_BRAKE), PUSH_SHAPED, state.left)
    # Tips that come down while they push make a cube tumble that sticks to them.
    speed = speed * jnp.clip(1.5 - jnp.abs(state.down) / (DOWN_GAIN * LEVEL), 0.2, 1.0)
    speed = jnp.minimum(speed + 8 * jnp.maximum(state.gap - 0.003, 0.0), TRAVEL)
    normal = _normal(state.line)
    pushing = state.line * speed[:, None] - normal * ((STEER * speed + 0.05) * state.aside / 0.03)[:, None]
    pushing = jnp.concatenate([pushing, state.down[:, None]], axis=-1)
    velocity = jnp.where(state.ready[:, None], pushing, run_up(drive, now, state))
    away = norm((now.goal.position - now.bodies.position[:, -1])[:, :2])
    # A hand that rests against the object lets it creep: it goes on resting.
    rests = jnp.abs(now.qd).max(axis=-1) < STILL
    ends = (away < jnp.where(rests, again, done)) & (~state.ready | (state.left < LEAST))
    turn = across(drive, now, jnp.arctan2(state.line[:, 1], state.line[:, 0]))
    return jnp.where(ends[:, None], 0.0, towards(drive, now, velocity, turn))


def push_seen(drive: Drive, now: Situation) -> Array:
    """The same of an object and a goal that are seen in a picture, a few millimetres beside where they are."""
    return push(drive, now, *DONE_SEEN)


def _normal(line: Array) -> Array:
    return jnp.stack([-line[:, 1], line[:, 0]], axis=-1)


def planned(now: Situation) -> Push:
    """The push that the situation asks for, and whether the finger tips are where it begins."""
    middle, half = now.bodies.position[:, -1], now.bodies.extent[:, -1]
    way, back = now.goal.position[:, :2] - middle[:, :2], now.tool_position[:, :2] - middle[:, :2]
    away = norm(way)
    straight = way / (away[:, None] + TINY)
    # Near the goal the line to it turns with every millimetre aside: the finger tips say where they push.
    hand = -back / (norm(back)[:, None] + TINY)
    low = now.tool_position[:, 2] < now.goal.position[:, 2] - half[:, 2] + 0.05
    keeps = (away < LATCH) & ((hand * straight).sum(axis=-1) > STRAY) & low
    line = jnp.where(keeps[:, None], hand, straight)
    left = jnp.maximum((way * line).sum(axis=-1), 0.0)
    along, aside = (back * line).sum(axis=-1), (back * _normal(line)).sum(axis=-1)
    turn = yaw(now.bodies.quaternion[:, -1]) - jnp.arctan2(line[:, 1], line[:, 0])
    reach = half[:, 0] * jnp.abs(jnp.cos(turn)) + half[:, 1] * jnp.abs(jnp.sin(turn))
    reach = jnp.where(now.bodies.round[:, -1], half[:, 0], reach) + TIP
    gap = -along - reach
    # Tips are never in an object: one that seems to be there was seen late, and is before them.
    ahead = jnp.where((gap > -INSIDE) & (jnp.abs(aside) < ASIDE) & low, jnp.maximum(-gap - SEEN, 0.0), 0.0)
    left, along, gap = jnp.maximum(left - ahead, 0.0), along - ahead, gap + ahead
    ready = (gap > -INSIDE) & (gap < FAR_BEHIND) & (jnp.abs(aside) < ASIDE) & low
    ready &= (left > 0.0005) | (away < DONE)
    # Over the object's edge nothing is pushed, but stood on.
    ready &= (now.tool_position[:, 2] < now.goal.position[:, 2] + half[:, 2] - OVERLAP + BEYOND) | (gap > CLEAR)
    down = DOWN_GAIN * (now.goal.position[:, 2] - half[:, 2] + LOW - now.tool_position[:, 2])
    return Push(line, left, along, aside, gap, ready, down)


def run_up(drive: Drive, now: Situation, state: Push) -> Array:
    """Velocity `[B, 3]` on the way to behind the object, over it where it is in the way."""
    tool, middle, half = now.tool_position, now.bodies.position[:, -1], now.bodies.extent[:, -1]
    table = now.goal.position[:, 2] - half[:, 2]
    reach = -state.along - state.gap
    before = middle[:, :2] - state.line * (reach + BEHIND)[:, None]
    away, over = norm(before - tool[:, :2]), 2 * half[:, 2] + OVER
    height = table + jnp.where(away < 0.012, LOW, jnp.minimum(LOW + 4 * (away - 0.012), over))
    blocked = (tool[:, 2] < table + over - 0.012) & (away > 0.02) & (state.along > -reach - 0.004)
    place = jnp.where(blocked[:, None], tool[:, :2], before)
    height = jnp.where(blocked, table + over + 0.01, height)
    way = jnp.concatenate([place, height[:, None]], axis=-1) - tool
    return velocity_to(drive, way)
