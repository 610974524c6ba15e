"""A task of one's own in one file: a ball rolls on a rail beside the arm, and the tool has to follow it.

With it an observation of the ball, a controller, and a setting: docs/own-task.md goes through it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control import CONTROLLERS
from reachlab.control.bodies import Bodies, absent
from reachlab.control.resolved_rate import resolved_rate
from reachlab.control.situation import Drive, Goal, Situation
from reachlab.settings.config import LearnerConfig, LoopConfig
from reachlab.settings.preset_record import Preset
from reachlab.settings.rules import TaskSettings
from reachlab.settings.tables import Lazy
from reachlab.settings.validation import Range
from reachlab.tasks import TASKS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.reach import sample_start
from reachlab.tasks.schema import Observation, Term
from reachlab.tasks.task import Bounds, Control, Errors, Scene, Task, TaskSetup
from reachlab.tasks.terms import STATE

RADIUS = 0.03
"""Of the ball [m]."""


@dataclass(frozen=True)
class Rail(TaskSettings):
    """Settings of following a ball on a rail."""

    preset: ClassVar[Preset] = Preset(
        loop=LoopConfig(num_envs=64, total_steps=200_000, stop_early=False),
        learner=LearnerConfig(hidden=(32, 32), learning_rate=3e-3),
    )

    evaluated: ClassVar[tuple[str, ...]] = ("rail_speed", *TaskSettings.evaluated)

    observation: str = "ball"
    action: str = "joint_delta"
    reward: str = "goal_distance"
    max_steps: Annotated[int, Range(1, 10**5)] = 200
    rail_speed: Annotated[float, Range(0.0, 2.0)] = 0.1
    """Speed of the ball on its rail [m/s]."""

    @classmethod
    def task(cls) -> Task:
        """The flange stays with the ball."""
        return Task(
            tool="flange",
            control=Control("follow_ball", residual_gain=0.3, fade=0.0),
            goal_box=_ends,
            sample_goal=_sample_goal,
            sample_start=sample_start,
            sample_bodies=lambda _setup, _key, _start, goal: _ball(goal.position[None]),
            scene=lambda _: Scene(moved=1),
            move=_move,
            errors=_errors,
            check=lambda _: None,
            asks=lambda rules, period: f"follow a ball on a rail for {rules.max_steps * period:.2g} s",
            succeeds=lambda rules, _: f"at the end the tool is within {rules.success_distance:.2g} m of the ball",
        )

    gives = frozenset({"bodies"})
    """There is a body beside the arm."""


def _ball(position: Array) -> Bodies:
    return replace(absent(1, radius=RADIUS), position=position)


def _ends(setup: TaskSetup) -> Bounds:
    """Ends of the rail `[3]` m: along y, in the middle of the arm's box."""
    low, high = np.array(setup.robot.goal_box, np.float32)
    along, middle = np.array([0.0, 1.0, 0.0], np.float32), (low + high) / 2
    return middle + along * (low - middle), middle + along * (high - middle)


def _sample_goal(setup: TaskSetup, key: Array) -> Goal:
    """Where the ball begins."""
    low, high = (jnp.array(end) for end in _ends(setup))
    share = jax.random.uniform(key, (1,))
    return Goal.at(low + share * (high - low), path=share)


def _move(setup: TaskSetup, goal: Goal, bodies: Bodies, clock: Array) -> tuple[Goal, Bodies]:
    """The ball, and the goal in it, roll there and back along y; by hand a goal is taken off its path, which is NaN."""
    low, high = (end[1] for end in _ends(setup))
    way = goal.path[:, 0] + setup.rules.rail_speed * setup.period * clock / (high - low)
    place = goal.position.at[:, 1].set(low + (high - low) * (1 - jnp.abs(way % 2 - 1)))
    place = jnp.where(jnp.isnan(way)[:, None], goal.position, place)
    return replace(goal, position=place), replace(bodies, position=place[:, None])


def _errors(setup: TaskSetup, now: Situation) -> Errors:
    del setup
    distance = jnp.linalg.norm(now.bodies.position[:, 0] - now.tool_position, axis=-1)
    return Errors(distance, jnp.zeros((len(distance), 0)))


def follow_ball(drive: Drive, now: Situation) -> Array:
    """Joint displacement `[B, n]` towards the ball."""
    return resolved_rate(drive, now._replace(goal=Goal.at(now.bodies.position[:, 0])))


def _way_bounds(setup: TaskSetup) -> Bounds:
    size = np.full(3, 2 * setup.robot.chain.longest, np.float32)
    return -size, size


TASKS["rail"] = Lazy("follow a ball on a rail", "rail:Rail")
CONTROLLERS["follow_ball"] = Lazy("to the ball by the Jacobian", "rail:follow_ball")
OBSERVATIONS["ball"] = Observation(
    "as state, and the way to the ball",
    (*STATE, Term("ball", "m", lambda _, now: now.bodies.position[:, 0] - now.tool_position, _way_bounds)),
    needs=frozenset({"bodies"}),
)
