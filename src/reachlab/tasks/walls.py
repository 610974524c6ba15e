"""What tasks share in which an object has to get over a wall across the table."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import Bodies, Shape, joined
from reachlab.control.situation import Goal, Situation
from reachlab.robots.kinematics.forward import norm
from reachlab.settings.validation import InputError
from reachlab.tasks import objects
from reachlab.tasks.task import Errors, Scene, TaskSetup

BESIDE = 0.3
"""No object begins and none is asked for nearer to the wall than this share of the way to the table's side."""

CLEAR, MOST_BESIDE = 0.001, 0.9
"""What is left between an object and the wall, at least [m], and most of the table's side that this may take."""

THICK, BEYOND = 0.005, 0.15
"""Half the wall's thickness, and how much longer it is than that part of the table on either side [m]."""

LET_GO = 0.05
"""An object is placed once the hand is so far from it [m]."""


def scene(setup: TaskSetup) -> Scene:
    """The wall and the object."""
    return replace(objects.scene(setup), fixed=1)


def check(setup: TaskSetup) -> None:
    """Make sure that there is room for an object on either side of the wall.

    Raises:
        InputError: the arm's hand works in too small a part of the table, beside an object of this size.
    """
    objects.check(setup)
    _, half, least = _sides(setup)
    if least > MOST_BESIDE * half:
        raise InputError(
            f"an object has to be {1000 * least:.0f} mm from the wall, and the hand of {setup.robot.name!r} works"
            f" in {1000 * half:.0f} mm on either side of it: choose a smaller --object-size or another arm."
        )


def _sides(setup: TaskSetup) -> tuple[float, float, float]:
    """The wall's place across the table, how far that reaches on either side, and how near to it no object is [m]."""
    low, high = objects.goal_box(setup)
    half, (widest, *_) = (high[1] - low[1]) / 2, objects.scene(setup).size
    diagonal = np.sqrt(2) * (1 + objects.SIZE_SPREAD) * widest
    return (low[1] + high[1]) / 2, half, max(BESIDE * half, THICK + diagonal + CLEAR)


def _beside(setup: TaskSetup, position: Array) -> Array:
    """A place `[..., 3]` on the table moved away from the wall, in its middle; all of its side is as likely."""
    middle, half, least = _sides(setup)
    side = position[..., 1] - middle
    aside = least + (1 - least / half) * jnp.abs(side)
    return position.at[..., 1].set(middle + jnp.where(side < 0, -aside, aside))


def sample_goal(setup: TaskSetup, key: Array) -> Goal:
    """A place on either side of the wall."""
    goal = objects.sample_goal(setup, key)
    return replace(goal, position=_beside(setup, goal.position))


def sample_bodies(setup: TaskSetup, key: Array, start: Array, goal: Goal) -> Bodies:
    """The wall, and the object on the other side `[2]`."""
    thing = objects.sample_object(setup, key, start, goal)
    (low, high), (middle, *_) = objects.goal_box(setup), _sides(setup)
    side = jnp.abs(thing.position[:, 1] - middle)
    across = thing.position.at[:, 1].set(middle - jnp.sign(goal.position[1] - middle) * side)
    height, table = setup.rules.wall_height, setup.robot.table_top
    wall = Bodies(
        position=jnp.array([[(low[0] + high[0]) / 2, middle, table + height / 2]]),
        quaternion=jnp.array([[1.0, 0.0, 0.0, 0.0]]),
        velocity=jnp.zeros((1, 6)),
        size=jnp.array([[(high[0] - low[0]) / 2 + BEYOND, THICK, height / 2]]),
        kind=jnp.full(1, Shape.BOX, jnp.int32),
    )
    return joined(wall, replace(thing, position=_beside(setup, across)))


def place(setup: TaskSetup, goal: Goal, position: Array, quaternion: Array, near: Array) -> tuple[Goal, Array]:
    """The goal put at the nearest place where goals are, which is not at the wall; see `Task.place`."""
    placed, found = objects.place(setup, goal, position, quaternion, near)
    middle, _, least = _sides(setup)
    side = placed.position[:, 1] - middle
    aside = middle + jnp.where(side < 0, -1, 1) * jnp.maximum(jnp.abs(side), least)
    return replace(placed, position=placed.position.at[:, 1].set(aside)), found


def update(setup: TaskSetup, before: Any, errors: Errors, now: Situation, clock: Array) -> Any:
    """The last steps, see `objects.update`; nothing is still before the hand has let go."""
    gone = norm(now.tool_position - objects.achieved(now)) > LET_GO
    return objects.update(setup, before, errors, now._replace(qd=jnp.where(gone[:, None], now.qd, jnp.inf)), clock)
