"""What a task is made of: pure functions on the records of this file.

Functions take arrays with the batch in front and never a simulator or a generator, so that each is written once, traced
for the simulators that JAX can trace and compiled for the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.kinematics import angle_between
from reachlab.robots.robot import Robot
from reachlab.settings.config import Rules

Bounds = tuple[np.ndarray, np.ndarray]
"""Lower and upper bounds `[k]`."""


@dataclass(frozen=True)
class TaskSetup:
    """A task on an arm; constants known while tracing.

    Attributes:
        task: the task.
        rules: its settings.
        robot: the arm.
        period: time from one command to the next [s].
        lag: time by which each joint follows its command `[n]` [s].
    """

    task: Task
    rules: Rules
    robot: Robot
    period: float
    lag: tuple[float, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Goal:
    """Where the tool is asked to be: `position [..., 3]` m and, where asked for, `quaternion [..., 4]` wxyz."""

    position: Array
    quaternion: Array | None = None

    def distance(self, tool_position: Array) -> Array:
        """Distance `[...]` m from the tool at `[..., 3]` m to the goal."""
        return jnp.linalg.norm(tool_position - self.position, axis=-1)

    def angle(self, tool_quaternion: Array) -> Array | None:
        """Angle `[...]` rad from the tool's orientation `[..., 4]` to the goal's; None where none is asked for."""
        return None if self.quaternion is None else angle_between(tool_quaternion, self.quaternion)


class Situation(NamedTuple):
    """What observations, actions and baselines may use, for a batch.

    `q, target_q [B, n]` rad or m, `qd [B, n]` rad/s or m/s, the tool's pose `[B, 3]` m and `[B, 4]` wxyz, the goal,
    `last_action [B, a]`; the camera's `picture [B, SIZE, SIZE]` uint8 where the observation holds one; and where the
    tool truly is, `achieved [B, 3]` m, if it is measured with noise.
    """

    q: Array
    qd: Array
    tool_position: Array
    tool_quaternion: Array
    goal: Goal
    target_q: Array
    last_action: Array
    picture: Array | None = None
    achieved: Array | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Progress:
    """What a task remembers of an episode, for a batch.

    Attributes:
        distance: tool to goal `[B]` [m].
        recent: the same after each of the last steps `[B, hold_steps]` [m]; None where touching the goal is enough.
        still: whether every joint was slow after them `[B, hold_steps]`.
    """

    distance: Array
    recent: Array | None = None
    still: Array | None = None

    @property
    def error(self) -> Array:
        """The error that counts `[B]` [m].

        The distance; where the goal has to be held the held error: the largest distance after the last `hold_steps`
        steps, infinite if a joint was not still after one of them.
        """
        if self.recent is None or self.still is None:
            return self.distance
        return jnp.where(self.still, self.recent, jnp.inf).max(axis=-1)


class Outcome(NamedTuple):
    """What a step led to, `[B]` each.

    Attributes:
        distance_before, distance: tool to goal before and after it [m].
        error: what counts, see `Progress.error` [m].
        speed: of the fastest joint [rad/s or m/s].
        effort: mean square of the action.
        outside: the tool is outside the workspace.
        success: the task is solved.
        timeout: the time is used up.
        gained: what success pays for: 1 on the step on which it is reached and, where the episode continues, -1 on the
            step on which it is lost.
        terminated: the task ends the episode.
    """

    distance_before: Array
    distance: Array
    error: Array
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


@dataclass(frozen=True)
class Task:
    """What is asked of an arm.

    Attributes:
        tool: which of a robot's tool frames is asked for, see `KnownRobot.tools`.
        goal_box: corners `[3]` m of the box that holds all goals.
        sample_goal: a goal, of a random key.
        sample_start: joint vector `[n]` in which an episode starts, of a random key.
        begin: what is remembered at the start of an episode: of the distance `[B]` [m] to the goal.
        judge: what is remembered after a step, and what the step led to: of what was remembered before, the situation
            after it, and its number in the episode `[B]`.
        rests: whether the joint command stays as it is `[B]`, of what is remembered; None where it never does.
        check: raises `InputError` where the rules do not fit the robot.
        asks: what is asked for, in words, of the rules and the control period [s].
        succeeds: what an episode has to come to, in words, of the same.
    """

    tool: str
    goal_box: Callable[[TaskSetup], Bounds]
    sample_goal: Callable[[TaskSetup, Array], Goal]
    sample_start: Callable[[TaskSetup, Array], Array]
    begin: Callable[[TaskSetup, Array], Progress]
    judge: Callable[[TaskSetup, Progress, Situation, Array], tuple[Progress, Outcome]]
    rests: Callable[[TaskSetup, Progress], Array | None]
    check: Callable[[TaskSetup], None]
    asks: Callable[[Rules, float], str]
    succeeds: Callable[[Rules, float], str]
