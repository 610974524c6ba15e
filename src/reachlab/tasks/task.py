"""What a task is made of: pure functions on the records of this file.

Functions take arrays with the batch in front and never a simulator or a generator, so that each is written once, traced
for the simulators that JAX can trace and compiled for the others.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import Bodies, Shape, absent
from reachlab.control.situation import Drive, Goal, Situation

Bounds = tuple[np.ndarray, np.ndarray]
"""Lower and upper bounds `[k]`."""

Progress = Any
"""What a task remembers of an episode beside its errors, for a batch: a pytree of the task's own."""


class Errors(NamedTuple):
    """How far what a task moves is from where it has to be: `distance [B]` m and `angle [B]` rad.

    Where any orientation will do the angle is without numbers, `[B, 0]`.
    """

    distance: Any
    angle: Any


@dataclass(frozen=True)
class Scene:
    """What may be beside the arm in an episode, and whether it can be touched.

    Attributes:
        fixed: bodies that do not move, at most.
        moved: bodies that `Task.move` moves, after the others.
        objects: bodies that move when the gripper touches them, after these; they lie on the table.
        shape: of the objects.
        size: of an object, see `Bodies.size` [m].
        mass: of an object [kg].
        friction, grip: coefficients of friction of an object on what it lies on, and at the gripper.
        friction_spread: where objects vary, the least and the largest share of it.
        contacts: contacts of the arm are judged: with the bodies, with the table and with itself.
        wrench: force and torque at the wrist are measured.
    """

    fixed: int = 0
    moved: int = 0
    objects: int = 0
    shape: Shape = Shape.BOX
    size: tuple[float, ...] = (0.0, 0.0, 0.0)
    mass: float = 0.1
    friction: float = 0.6
    grip: float = 0.6
    friction_spread: tuple[float, float] = (0.5, 5 / 3)
    contacts: bool = False
    wrench: bool = False

    @property
    def bodies(self) -> int:
        """Bodies `K` for which there is room."""
        return self.fixed + self.moved + self.objects


EMPTY = Scene()
"""Nothing beside the arm, and no contacts."""


@dataclass(frozen=True)
class Control:
    """What an engineer would do without learning, which baselines are, and which a residual action corrects.

    Attributes:
        controller: its name in `CONTROLLERS`.
        residual_gain: displacement that a residual action of 1 adds, in displacements of an action of 1.
        fade: distance from which on it falls, to nothing at the goal [m]; 0 where it never does.
        seen: the name of one that goes by what a picture shows; empty where there is none.
        dampers: velocity dampers keep every joint displacement clear of bodies and of the table.
    """

    controller: str
    residual_gain: float
    fade: float = 0.02
    seen: str = ""
    dampers: bool = False


@dataclass(frozen=True)
class TaskSetup(Drive):
    """A task on an arm; constants known while tracing.

    Attributes:
        task: the task.
        rules: its settings.
    """

    task: Task
    rules: Any

    @functools.cached_property
    def prepared(self) -> Any:
        """What the task has made for the arm, see `Task.prepare`."""
        return self.task.prepare(self)

    @property
    def scene(self) -> Scene:
        """What may be beside the arm, and what the simulator has to tell of it."""
        return replace(self.task.scene(self), wrench=self.rules.wrench)


class Keys(NamedTuple):
    """Random keys of an episode: of its goal, of its start and of what is beside the arm."""

    goal: Array
    start: Array
    scene: Array


class Sampled(NamedTuple):
    """What an episode begins with: joints `[n]`, a goal and bodies `[K]`."""

    start: Array
    goal: Goal
    bodies: Bodies


# --- what most tasks do ---------------------------------------------------------------------------


def point_errors(_setup: TaskSetup, now: Situation) -> Errors:
    """Errors of a tool that is asked for at a point, in any orientation."""
    distance = now.goal.distance(now.tool_position)
    return Errors(distance, jnp.zeros((len(distance), 0)))


def place_point(_setup: TaskSetup, goal: Goal, position: Array, _quaternion: Array, _near: Array) -> tuple[Goal, Array]:
    """A goal of position alone, see `Task.place`; one that moves is taken off its path."""
    stays, path = jnp.zeros_like(goal.velocity), jnp.full_like(goal.path, jnp.nan)
    return replace(goal, position=position[None], velocity=stays, path=path), jnp.ones((), bool)


def within_distance(rules: Any, errors: Errors) -> Any:
    """Whether a distance is that of a success `[...]`."""
    return errors.distance < rules.success_distance


def stay(_setup: TaskSetup, goal: Goal, bodies: Bodies, _clock: Array) -> tuple[Goal, Bodies]:
    """Goal and bodies that do not move by themselves."""
    return goal, bodies


def no_bodies(_setup: TaskSetup, _key: Array, _start: Array, _goal: Goal) -> Bodies:
    """Nothing beside the arm."""
    return absent(0)


def sample_apart(setup: TaskSetup, keys: Keys, goal: Goal | None, _held_out: Array | bool) -> Sampled:
    """An episode whose start, goal, if none is given, and bodies are drawn one after the other."""
    task, start = setup.task, setup.task.sample_start(setup, keys.start)
    goal = task.sample_goal(setup, keys.goal) if goal is None else goal
    return Sampled(start, goal, task.sample_bodies(setup, keys.scene, start, goal))


def nothing_remembered(_setup: TaskSetup, _errors: Errors) -> Progress:
    """Progress of a task that asks for nothing but its errors."""
    return ()


@dataclass(frozen=True)
class Task:
    """What is asked of an arm.

    Attributes:
        tool: which of a robot's tool frames is asked for, see `KnownRobot.tools`.
        control: what would be done without learning.
        goal_box: corners `[3]` m of the box that holds all goals.
        sample_goal: a goal, of a random key.
        check: raises `InputError` where the rules do not fit the robot.
        asks: what is asked for, in words, of the rules and the control period [s].
        succeeds: what an episode has to come to, in words, of the same.
        needs: what simulator and action have to give, of `reachlab.tasks.WORDS`.
        sample_start: joint vector `[n]` in which an episode starts, of a random key.
        scene: what may be beside the arm.
        sample_bodies: what is beside it in an episode `[K]`, of a random key, the joints `[n]` in which it starts and
            the goal.
        prepare: what is made once for the arm, to draw episodes from: a pytree of arrays.
        sample: start, goal and bodies of an episode, of its keys and a goal, if one is given; of those to train with
            or, where it is asked for, of others that are held out.
        vary: goal and bodies with objects of another size, of a random key.
        place: the goal put at a position `[3]` m and, where one is asked for, in an orientation `[4]` wxyz, of a goal
            `[1]`, these and the arm's joints `[n]`; and whether the arm can be there freely `[]`.
        move: goal and bodies after so many steps `[B]`; bodies are only looked at where the scene has moved ones. By
            default a goal that was put elsewhere, as by hand, has a `path` of NaN, see `place`.
        known: the goal as far as it is known to the policy.
        achieved: where what is moved truly is, `[B, 3]` m.
        errors: how far what is moved is from where it has to be; the only place that says so.
        gap: the errors as one number [m].
        near: whether errors are those of a success.
        begin: what is remembered at the start of an episode.
        update: what is remembered after a step: of what was before it, the errors and the situation after it, and its
            number in the episode `[B]`.
        counted: the errors that count at the end: of the last ones and what is remembered.
    """

    tool: str
    control: Control
    goal_box: Callable[[TaskSetup], Bounds]
    sample_goal: Callable[[TaskSetup, Array], Goal]
    check: Callable[[TaskSetup], None]
    asks: Callable[[Any, float], str]
    succeeds: Callable[[Any, float], str]
    sample_start: Callable[[TaskSetup, Array], Array]
    needs: frozenset[str] = frozenset()
    scene: Callable[[TaskSetup], Scene] = lambda _: EMPTY
    sample_bodies: Callable[[TaskSetup, Array, Array, Goal], Bodies] = no_bodies
    prepare: Callable[[TaskSetup], Any] = lambda _: None
    sample: Callable[[TaskSetup, Keys, Goal | None, Array | bool], Sampled] = sample_apart
    vary: Callable[[TaskSetup, Array, Goal, Bodies], tuple[Goal, Bodies]] = lambda _, __, goal, bodies: (goal, bodies)
    place: Callable[[TaskSetup, Goal, Array, Array, Array], tuple[Goal, Array]] = place_point
    move: Callable[[TaskSetup, Goal, Bodies, Array], tuple[Goal, Bodies]] = stay
    known: Callable[[TaskSetup, Goal], Goal] = lambda _, goal: goal
    achieved: Callable[[Situation], Array] = lambda now: now.achieved.position
    errors: Callable[[TaskSetup, Situation], Errors] = point_errors
    gap: Callable[[Any, Errors], Any] = lambda _, errors: errors.distance
    near: Callable[[Any, Errors], Any] = within_distance
    begin: Callable[[TaskSetup, Errors], Progress] = nothing_remembered
    update: Callable[[TaskSetup, Progress, Errors, Situation, Array], Progress] = lambda _, progress, *__: progress
    counted: Callable[[Errors, Progress], Errors] = lambda errors, _: errors
