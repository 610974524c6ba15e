"""What a step of an episode has led to: its errors, whether it is a success, and whether the episode ends."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from reachlab.control.situation import Situation
from reachlab.robots.kinematics.forward import added
from reachlab.robots.robot import Robot
from reachlab.tasks.task import Errors, Progress, TaskSetup


class Outcome(NamedTuple):
    """What a step led to, `[B]` each.

    Attributes:
        errors: how far what is moved is from where it has to be after it.
        gap_before, gap: the same as one number each before and after it, see `Task.gap` [m].
        near: the errors after it are those of a success.
        counted: the errors that count at the end, see `Task.counted`.
        progress: what is remembered of the episode.
        speed: of the fastest joint [rad/s or m/s].
        effort: mean square of the action.
        outside: the tool is outside the workspace, or the arm has touched something that it must not.
        success: the task is solved.
        timeout: the time is used up.
        gained: change of what success pays for: 1 on the step on which it is reached and, where the episode continues,
            -1 on the step on which it is lost.
        terminated: the task ends the episode.
    """

    errors: Errors
    gap_before: Array
    gap: Array
    near: Array
    counted: Errors
    progress: Progress
    speed: Array
    effort: Array
    outside: Array
    success: Array
    timeout: Array
    gained: Array
    terminated: Array


def outside_workspace(robot: Robot, tool_position: Array) -> Array:
    """Whether the tool, at `[B, 3]` m, is outside the robot's workspace `[B]`."""
    low, high = (jnp.array(corner) for corner in robot.workspace)
    return ((tool_position < low) | (tool_position > high)).any(axis=-1)


def judge(setup: TaskSetup, before: Errors, progress: Progress, now: Situation, clock: Array) -> Outcome:
    """What a step led to: of the errors before it, what was remembered, the situation after it and its number `[B]`.

    Leaving the workspace outranks success, and where success ends the episode it outranks a time-out on the same step.
    """
    task, rules = setup.task, setup.rules
    errors = task.errors(setup, now)
    after = task.update(setup, progress, errors, now, clock)
    counted = task.counted(errors, after)
    outside = jnp.zeros_like(errors.distance, bool)
    if rules.ends_outside:
        outside = outside_workspace(setup.robot, now.tool_position)
    if rules.ends_on_contact:
        outside |= now.contact
    success = ~outside & task.near(rules, counted)
    timeout = ~outside & (clock >= rules.max_steps)
    gained, terminated = success.astype(errors.distance.dtype), outside
    if rules.ends_at_goal:
        timeout, terminated = timeout & ~success, outside | success
    else:
        gained = gained - task.near(rules, task.counted(before, progress))
    return Outcome(
        errors=errors,
        gap_before=task.gap(rules, before),
        gap=task.gap(rules, errors),
        near=task.near(rules, errors),
        counted=counted,
        progress=after,
        speed=jnp.abs(now.qd).max(axis=-1),
        effort=added(jnp.square(now.last_action)) / now.last_action.shape[-1],
        outside=outside,
        success=success,
        timeout=timeout,
        gained=gained,
        terminated=terminated,
    )
