"""What a task is made of: pure functions on the records of this file.

Functions take arrays with the batch in front and never a simulator or a generator, so that each is written once, traced
for the simulators that JAX can trace and compiled for the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.kinematics import Pose, angle_between, norm
from reachlab.robots.robot import Robot
from reachlab.settings.rules import Rules
from reachlab.tasks.obstacles import Obstacles

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
    """Where the tool is asked to be.

    Attributes:
        position: `[..., 3]` [m].
        quaternion: `[..., 4]`, wxyz; None where any orientation will do.
        joints: joints `[..., n]` at which the tool is there [rad or m]; None where nobody has looked for them.
        velocity: `[..., 3]` [m/s]; None where it does not move.
        path: on which it moves, `[..., k]`, see `paths`; None where it does not, not a number where it does no more.
    """

    position: Array
    quaternion: Array | None = None
    joints: Array | None = None
    velocity: Array | None = None
    path: Array | None = None

    def distance(self, tool_position: Array) -> Array:
        """Distance `[...]` m from the tool at `[..., 3]` m to the goal."""
        return norm(tool_position - self.position)

    def moves(self) -> Array:
        """Whether it moves by itself `[...]`."""
        return jnp.zeros(self.position.shape[:-1], bool) if self.path is None else ~jnp.isnan(self.path[..., 0])

    def angle(self, tool_quaternion: Array) -> Array | None:
        """Angle `[...]` rad from the tool's orientation `[..., 4]` to the goal's; None where none is asked for."""
        return None if self.quaternion is None else angle_between(tool_quaternion, self.quaternion)


class Situation(NamedTuple):
    """What observations, actions and baselines may use, for a batch.

    `q, target_q [B, n]` rad or m, `qd [B, n]` rad/s or m/s, the tool's pose `[B, 3]` m and `[B, 4]` wxyz, the goal,
    `last_action [B, a]`; the camera's `picture [B, SIZE, SIZE]` uint8 where the observation holds one; where the tool
    truly is, `achieved`, if it is measured with noise; the obstacles, where there are any; and whether the arm touched
    anything in the last control period, `contact [B]`, where the simulator tells it.
    """

    q: Array
    qd: Array
    tool_position: Array
    tool_quaternion: Array
    goal: Goal
    target_q: Array
    last_action: Array
    picture: Array | None = None
    achieved: Pose | None = None
    obstacles: Obstacles | None = None
    contact: Array | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Progress:
    """What a task remembers of an episode, for a batch.

    Attributes:
        distance: tool to goal `[B]` [m].
        angle: between their orientations `[B]` [rad]; None where any will do.
        recent: the distance after each of the last steps `[B, hold_steps]` [m]; None where touching the goal is enough.
        recent_angle: the angle after them `[B, hold_steps]` [rad], likewise.
        still: whether every joint was slow after them `[B, hold_steps]`.
        mean_square: of the distances after the steps that count `[B]` [m²]; None where the goal does not move.
    """

    distance: Array
    angle: Array | None = None
    recent: Array | None = None
    recent_angle: Array | None = None
    still: Array | None = None
    mean_square: Array | None = None

    @property
    def error(self) -> Array:
        """The error that counts `[B]` [m].

        The distance; where the goal has to be held the held error: the largest distance after the last `hold_steps`
        steps, infinite if a joint was not still after one of them; where it moves the root mean square.
        """
        if self.mean_square is not None:
            return jnp.sqrt(self.mean_square)
        return self.distance if self.recent is None else self._held(self.recent)

    @property
    def angle_error(self) -> Array | None:
        """The same of the angle `[B]` [rad]; None where any orientation will do."""
        return self.angle if self.recent_angle is None else self._held(self.recent_angle)

    def _held(self, recent: Array) -> Array:
        assert self.still is not None, "remembered together"  # noqa: S101
        return jnp.where(self.still, recent, jnp.inf).max(axis=-1)

    def near(self, rules: Rules) -> Array:
        """Whether the tool is at the goal now `[B]`."""
        return within(rules, self.distance, self.angle)

    def solved(self, rules: Rules) -> Array:
        """Whether the errors that count are those of a success `[B]`."""
        return within(rules, self.error, self.angle_error)


def within(rules: Rules, distance: Any, angle: Any | None) -> Any:
    """Whether errors `[...]` in m and, where an orientation is asked for, rad are those of a success."""
    near = distance < rules.success_distance
    return near if angle is None else near & (angle < rules.success_angle)


def gap(rules: Rules, distance: Any, angle: Any | None) -> Any:
    """Errors `[...]` in m and rad as one [m]."""
    return distance if angle is None else distance + rules.angle_weight * angle


class Outcome(NamedTuple):
    """What a step led to, `[B]` each.

    Attributes:
        gap_before, gap: how far the tool is from the goal before and after it, see `gap` [m].
        progress: what is remembered of the episode: distance, angle and the errors that count.
        speed: of the fastest joint [rad/s or m/s].
        effort: mean square of the action.
        outside: the tool is outside the workspace, or the arm has touched something that it must not.
        success: the task is solved.
        timeout: the time is used up.
        gained: what success pays for: 1 on the step on which it is reached and, where the episode continues, -1 on the
            step on which it is lost.
        terminated: the task ends the episode.
    """

    gap_before: Array
    gap: Array
    progress: Progress
    speed: Array
    effort: Array
    outside: Array
    success: Array
    timeout: Array
    gained: Array
    terminated: Array

    @property
    def distance(self) -> Array:
        """Tool to goal after the step `[B]` [m]."""
        return self.progress.distance


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
        sample_obstacles: the obstacles of an episode, of a random key, the joints `[n]` in which it starts and the
            goal; None where there are none.
        move: the goal after so many steps `[B]`; None where it stays.
        sample_start: joint vector `[n]` in which an episode starts, of a random key.
        begin: what is remembered at the start of an episode: of the goal and the tool's pose.
        judge: what a step led to: of what was remembered before, the situation after it, and its number in the episode
            `[B]`.
        rests: whether the joint command stays as it is `[B]`, of what is remembered; None where it never does.
        check: raises `InputError` where the rules do not fit the robot.
        asks: what is asked for, in words, of the rules and the control period [s].
        succeeds: what an episode has to come to, in words, of the same.
    """

    tool: str
    goal_box: Callable[[TaskSetup], Bounds]
    sample_goal: Callable[[TaskSetup, Array], Goal]
    sample_obstacles: Callable[[TaskSetup, Array, Array, Goal], Obstacles] | None
    move: Callable[[TaskSetup, Goal, Array], Goal] | None
    sample_start: Callable[[TaskSetup, Array], Array]
    begin: Callable[[TaskSetup, Goal, Pose], Progress]
    judge: Callable[[TaskSetup, Progress, Situation, Array], Outcome]
    rests: Callable[[TaskSetup, Progress], Array | None]
    check: Callable[[TaskSetup], None]
    asks: Callable[[Rules, float], str]
    succeeds: Callable[[Rules, float], str]
