"""Lifting: an object is gripped from above, its grip checked, and carried to a place."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from reachlab.control.hand import across, faces, towards, turn_of, velocity_to, wrapped
from reachlab.control.situation import Drive, Situation
from reachlab.robots.kinematics.forward import components, norm
from reachlab.robots.kinematics.scalars import rotation_from_quaternion

CLEAR = 0.009
"""Room that an open hand leaves on either side of the object [m]: more than a measured place is off, and than half a
turn of 5 degrees takes."""

CLOSING = 0.0008
"""A hand is closing, or grips, where its opening is commanded so far below what is measured [m]."""

REACHED, TURNED = (0.012, 0.015), 0.12
"""How near aside and in height the grasp point has to be to the object's middle [m], and how near the hand's turn to
that of its faces [rad], where fingers close."""

AWAY, EMPTY = 0.035, 0.007
"""What was gripped is lost where it is so far from the grasp point, or fingers have closed by so much more [m]."""

TOUCHING, SQUEEZED, FIRM = 0.003, 0.003, 0.006
"""Fingers touch where the opening exceeds the object by less than the first; they are then commanded into it by the
second before it is carried, and by the third more before it is carried at full speed [m]."""

SQUEEZE = 0.014
"""And at most by so much [m]: what takes longer to close takes longer to open."""

FUNNEL, HOVER, EDGE = 4.0, 0.05, 0.006
"""On the way to the object the grasp point is so much higher than the object's middle as it is aside of it, but for the
last of them [m], and at most the second of them [m]."""

TURN_ASIDE = 0.2
"""A turn that is missing counts as being so far aside [m/rad]."""

LOW, BESIDE = 0.035, 0.025
"""A hand that is lower above an object than the first, and further aside than the second, goes up before it moves
[m]."""

LEAST = 0.013
"""Least height of the grasp point above the table [m]."""

RISE, SLOPE = 0.02, 0.3
"""What is carried is so high above the table, and lower by this slope near its place [m]."""


class Grip(NamedTuple):
    """What a hand has to do with an object.

    Attributes:
        closing: fingers have been told to close `[B]`.
        closes: they close, or stay closed, on it `[B]`.
        held: it is between them `[B]`.
        firm: how firmly, 0 to 1 `[B]`.
        way: from the grasp point to its middle `[B, 3]` [m].
        missing_turn: angle `[B]` rad between the hand and its faces.
        turn: how the hand is to be turned from how it is held at home `[B]` [rad].
    """

    closing: Array
    closes: Array
    held: Array
    firm: Array
    way: Array
    missing_turn: Array
    turn: Array


def lift(drive: Drive, now: Situation) -> Array:
    """Displacement `[B, m]` of joints and gripper that grips the last body and carries it to the goal.

    It remembers nothing: the opening that is commanded tells what the hand is about.
    """
    grip = gripped(drive, now)
    carried = carry(drive, now, grip, now.goal.position)
    velocity = jnp.where(grip.held[:, None], carried, jnp.where(grip.closes[:, None], 0.0, approach(drive, now, grip)))
    return moved(drive, now, velocity, grip.turn, grip.closes)


def gripped(drive: Drive, now: Situation) -> Grip:
    """What the hand has to do with the last body."""
    middle, half = now.bodies.position[:, -1], now.bodies.extent[:, -1]
    width, opening, commanded = 2 * half[:, 1], now.opening[:, 0], now.command[:, -1]
    way, sides = middle - now.tool_position, across(drive, now, faces(now))
    turn = turn_of(drive, now)
    missing = jnp.abs(wrapped(sides - turn, 2 * jnp.pi))
    closing = commanded < jnp.minimum(opening, open_for(drive, width)) - CLOSING
    lost = (opening < width - EMPTY) | (norm(way) > AWAY)
    there = (norm(way[:, :2]) < REACHED[0]) & (jnp.abs(way[:, 2]) < REACHED[1]) & (missing < TURNED)
    closes = (closing & ~lost) | there
    squeeze = width - SQUEEZED - commanded
    between = ~lost & (opening < width + TOUCHING)
    held = closing & between & (squeeze > 0)
    # Between fingers an object is in their middle, wherever it was measured.
    axis = jnp.stack(list(rotation_from_quaternion(*components(now.tool_quaternion)).y), axis=-1)
    centred = way - (way * axis).sum(axis=-1, keepdims=True) * axis
    way = jnp.where(between[:, None], centred, way)
    return Grip(closing, closes, held, jnp.clip(squeeze / FIRM, 0.0, 1.0), way, missing, jnp.where(closes, turn, sides))


def open_for(drive: Drive, width: Array) -> Array:
    """Opening `[B]` m of a hand that goes over an object of a width `[B]` m."""
    return jnp.minimum(width + 2 * CLEAR, drive.robot.commands.upper[-1])


def approach(drive: Drive, now: Situation, grip: Grip) -> Array:
    """Velocity `[B, 3]` on the way to an object: over it as long as the hand is aside or turned."""
    way, tool, middle = grip.way, now.tool_position, now.tool_position + grip.way
    aside = norm(way[:, :2])
    over = jnp.maximum(aside - EDGE, 0.0) + TURN_ASIDE * jnp.maximum(grip.missing_turn - 0.08, 0.0)
    height = middle[:, 2] + jnp.minimum(FUNNEL * over, HOVER + jnp.clip(aside - HOVER, 0.0, HOVER))
    height = jnp.maximum(height, drive.robot.table_top + LEAST)
    low = (tool[:, 2] < middle[:, 2] + LOW) & (aside > BESIDE)
    place = jnp.where(low[:, None], tool[:, :2], middle[:, :2])
    height = jnp.where(low, middle[:, 2] + HOVER + RISE, height)
    return velocity_to(drive, jnp.concatenate([place, height[:, None]], axis=-1) - tool)


def carry(drive: Drive, now: Situation, grip: Grip, goal: Array) -> Array:
    """Velocity `[B, 3]` of what is held to a goal `[B, 3]`: above the table until near, slow before it is firm."""
    way = goal - (now.tool_position + grip.way)
    rise = jnp.clip(SLOPE * (norm(way[:, :2]) - EDGE), 0.0, RISE)
    lowest = drive.robot.table_top + now.bodies.extent[:, -1, 2] + rise
    up = jnp.maximum(goal[:, 2], lowest) - goal[:, 2]
    way = way + up[:, None] * jnp.array([0.0, 0.0, 1.0])
    return grip.firm[:, None] * velocity_to(drive, way)


def moved(drive: Drive, now: Situation, velocity: Array, turn: Array, closes: Array) -> Array:
    """Displacement `[B, m]` of joints and gripper for a velocity `[B, 3]` and a turn of the hand, open or closing."""
    width = 2 * now.bodies.extent[:, -1, 1]
    wanted = jnp.where(closes, jnp.maximum(width - SQUEEZE, 0.0), open_for(drive, width))
    return jnp.concatenate([towards(drive, now, velocity, turn), (wanted - now.command[:, -1])[:, None]], axis=-1)
