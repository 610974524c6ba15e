"""Goals that move on paths: how they are sampled and moved, and the error that counts."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
from jax import Array

from reachlab.control.bodies import Bodies
from reachlab.control.situation import Goal, Situation
from reachlab.settings.validation import InputError
from reachlab.tasks.paths import place_at, sample_path
from reachlab.tasks.task import Errors, TaskSetup


def sample_goal(setup: TaskSetup, key: Array) -> Goal:
    """A goal at the begin of a random path."""
    path = sample_path(setup, key)
    place = place_at(setup, path[None], jnp.zeros(1, jnp.int32))
    return Goal.at(place.position[0], velocity=place.velocity[0], path=path)


def move(setup: TaskSetup, goal: Goal, bodies: Bodies, clock: Array) -> tuple[Goal, Bodies]:
    """The goal on its path; one that was taken off it, as by a mouse, stays where it is."""
    place, moves = place_at(setup, goal.path, clock), goal.moves()[:, None]
    position, velocity = jnp.where(moves, place.position, goal.position), jnp.where(moves, place.velocity, 0.0)
    return replace(goal, position=position, velocity=velocity), bodies


def known(setup: TaskSetup, goal: Goal) -> Goal:
    """The goal as the policy knows it: at rest, where the settings keep its velocity from it."""
    return goal if setup.rules.goal_velocity else replace(goal, velocity=jnp.zeros_like(goal.velocity))


def begin(_setup: TaskSetup, errors: Errors) -> Array:
    """Mean square of the distance `[B]` [m²]."""
    return jnp.square(errors.distance)


def update(setup: TaskSetup, mean_square: Array, errors: Errors, _now: Situation, clock: Array) -> Array:
    """Mean square of the distances after the settling time; until then it is that of the last one."""
    counted = jnp.maximum(clock - setup.rules.settle_steps, 1)
    return mean_square + (jnp.square(errors.distance) - mean_square) / counted


def counted(errors: Errors, mean_square: Array) -> Errors:
    """The root mean square is the error that counts."""
    return Errors(jnp.sqrt(mean_square), errors.angle)


def check(setup: TaskSetup) -> None:
    """Make sure that goals have room to move.

    Raises:
        InputError: they have none.
    """
    for axis, low, high in zip("xyz", *setup.task.goal_box(setup), strict=True):
        if low >= high:
            raise InputError(
                f"a goal that moves needs a box that is wide in every direction, and it goes from {low:g} to {high:g} m"
                f" in {axis}: choose other --target-low and --target-high."
            )
