"""Following a point that moves."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
from jax import Array

from reachlab.robots.kinematics import Pose
from reachlab.settings.rules import Rules
from reachlab.settings.validation import InputError
from reachlab.tasks.paths import PATHS, place_at, sample_path
from reachlab.tasks.reach import PRECISE, outcome
from reachlab.tasks.task import Goal, Outcome, Progress, Situation, TaskSetup


def _sample_goal(setup: TaskSetup, key: Array) -> Goal:
    path = sample_path(setup, key)
    place = place_at(setup, path[None], jnp.zeros(1, jnp.int32))
    return Goal(place.position[0], velocity=place.velocity[0], path=path)


def _move(setup: TaskSetup, goal: Goal, clock: Array) -> Goal:
    """The goal on its path; one that was taken off it, as by a mouse, stays where it is."""
    assert goal.path is not None, "as it was sampled"  # noqa: S101
    place, moves = place_at(setup, goal.path, clock), goal.moves()[:, None]
    position, velocity = jnp.where(moves, place.position, goal.position), jnp.where(moves, place.velocity, 0.0)
    return replace(goal, position=position, velocity=velocity)


def _begin(setup: TaskSetup, goal: Goal, tool: Pose) -> Progress:
    del setup
    distance = goal.distance(tool.position)
    return Progress(distance, mean_square=jnp.square(distance))


def _judge(setup: TaskSetup, before: Progress, now: Situation, clock: Array) -> Outcome:
    """As for a point that stays; the error that counts is the root mean square after the settling time.

    Until then it is the distance.
    """
    assert before.mean_square is not None, "as it began"  # noqa: S101
    distance = now.goal.distance(now.tool_position)
    counted = jnp.maximum(clock - setup.rules.settle_steps, 1)
    mean = before.mean_square + (jnp.square(distance) - before.mean_square) / counted
    return outcome(setup, before, Progress(distance, mean_square=mean), now, clock)


def _check(setup: TaskSetup) -> None:
    for axis, low, high in zip("xyz", *setup.task.goal_box(setup), strict=True):
        if low >= high:
            raise InputError(
                f"a goal that moves needs a box that is wide in every direction, and it goes from {low:g} to {high:g} m"
                f" in {axis}: choose other --target-low and --target-high."
            )


def _asks(rules: Rules, period: float) -> str:
    ways = "; ".join(PATHS[name].summary for name in rules.goal_paths)
    low, high = rules.goal_speed
    return (
        f"follow a point for {rules.max_steps:,} steps ({rules.max_steps * period:.2g} s), which moves at {low:g} to"
        f" {high:g} m/s in the arm's box: {ways}"
    )


def _succeeds(rules: Rules, period: float) -> str:
    return (
        f"the root mean square of the distance after the first {rules.settle_steps * period:.2g} s is below"
        f" {1000 * rules.success_distance:.4g} mm"
    )


TRACK = replace(
    PRECISE,
    sample_goal=_sample_goal,
    move=_move,
    begin=_begin,
    judge=_judge,
    check=_check,
    asks=_asks,
    succeeds=_succeeds,
)
"""The flange follows a point."""
