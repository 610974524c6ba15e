"""What tasks share in which an object has to get over a wall across the table."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jax import Array

from reachlab.control.bodies import Bodies, Shape, joined
from reachlab.control.situation import Goal, Situation
from reachlab.robots.kinematics.forward import norm
from reachlab.tasks import objects
from reachlab.tasks.task import Errors, Scene, TaskSetup

BESIDE = 0.3
"""No object begins and none is asked for nearer to the wall than this share of the way to the table's side."""

THICK, BEYOND = 0.005, 0.15
"""Half the wall's thickness, and how much longer it is than that part of the table on either side [m]."""

LET_GO = 0.05
"""An object is placed once the hand is so far from it [m]."""


def scene(setup: TaskSetup) -> Scene:
    """The wall and the object."""
    return replace(objects.scene(setup), fixed=1)


def _beside(setup: TaskSetup, position: Array) -> Array:
    """A place `[..., 3]` on the table moved away from the wall, in its middle; all of its side is as likely."""
    low, high = objects.goal_box(setup)
    half = (high[1] - low[1]) / 2
    aside = BESIDE * half + (1 - BESIDE) * jnp.abs(position[..., 1])
    return position.at[..., 1].set(jnp.where(position[..., 1] < 0, -aside, aside))


def sample_goal(setup: TaskSetup, key: Array) -> Goal:
    """A place on either side of the wall."""
    goal = objects.sample_goal(setup, key)
    return replace(goal, position=_beside(setup, goal.position))


def sample_bodies(setup: TaskSetup, key: Array, start: Array, goal: Goal) -> Bodies:
    """The wall, and the object on the other side `[2]`."""
    thing = objects.sample_object(setup, key, start, goal)
    across = thing.position.at[:, 1].set(-jnp.sign(goal.position[1]) * jnp.abs(thing.position[:, 1]))
    low, high = objects.goal_box(setup)
    height, table = setup.rules.wall_height, setup.robot.table_top
    wall = Bodies(
        position=jnp.array([[(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, table + height / 2]]),
        quaternion=jnp.array([[1.0, 0.0, 0.0, 0.0]]),
        velocity=jnp.zeros((1, 6)),
        size=jnp.array([[(high[0] - low[0]) / 2 + BEYOND, THICK, height / 2]]),
        kind=jnp.full(1, Shape.BOX, jnp.int32),
    )
    return joined(wall, replace(thing, position=_beside(setup, across)))


def place(setup: TaskSetup, goal: Goal, position: Array, quaternion: Array, near: Array) -> tuple[Goal, Array]:
    """The goal put at the nearest place where goals are, which is not at the wall; see `Task.place`."""
    placed, found = objects.place(setup, goal, position, quaternion, near)
    low, high = objects.goal_box(setup)
    side = placed.position[:, 1]
    aside = jnp.maximum(jnp.abs(side), BESIDE * (high[1] - low[1]) / 2)
    return replace(placed, position=placed.position.at[:, 1].set(jnp.where(side < 0, -aside, aside))), found


def update(setup: TaskSetup, before: Any, errors: Errors, now: Situation, clock: Array) -> Any:
    """The last steps, see `objects.update`; nothing is still before the hand has let go."""
    gone = norm(now.tool_position - objects.achieved(now)) > LET_GO
    return objects.update(setup, before, errors, now._replace(qd=jnp.where(gone[:, None], now.qd, jnp.inf)), clock)
