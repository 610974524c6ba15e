"""What tasks share whose object lies on the table: where it begins, where it has to be, and when it rests there."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import Bodies, Shape
from reachlab.control.situation import Goal, Situation
from reachlab.robots.kinematics.forward import norm
from reachlab.settings.validation import InputError
from reachlab.tasks import reach
from reachlab.tasks.tabletop import working_box
from reachlab.tasks.task import Bounds, Control, Errors, Scene, Task, TaskSetup

APART = 0.08
"""Least distance of an object from its goal at the start [m]; it is drawn again up to `DRAWS` times, of which then the
farthest one is taken."""

DRAWS = 8

YAW = np.pi / 4
"""Objects are turned by up to so much either way [rad]."""

SIZE_SPREAD = 0.25
"""Where objects vary: relative spread of their size."""

REST = 0.02
"""Speed below which an object rests [m/s]."""


FORMS = {
    "box": (Shape.BOX, (1.0, 1.0, 1.0)),
    "cylinder": (Shape.CYLINDER, (1.0, 1.0, 1.0)),
    "ball": (Shape.BALL, (1.0, 0.0, 0.0)),
    "puck": (Shape.CYLINDER, (1.0, 1.0, 1 / 3)),
}
"""What the shapes of objects by name are, and their `Bodies.size` beside their `object_size`."""

LIES = 1e-4
"""A goal that is so much above others on the table is in the air [m]."""

ON_TABLE = 0.2
"""Share of the goals above a table that are on it."""


def handled(asked: str, control: Control, *, also: str = "", **parts: Any) -> Task:
    """A task with an object on the table, of what is `asked` in words and `also`, and what is not as in `push`."""
    usual: dict[str, Any] = {
        "goal_box": goal_box,
        "sample_goal": sample_goal,
        "sample_start": reach.sample_start,
        "scene": scene,
        "sample_bodies": sample_object,
        "vary": vary,
        "place": place,
        "achieved": achieved,
        "errors": errors,
        "begin": reach.begin,
        "update": update,
        "counted": reach.counted,
        "check": check,
        "asks": functools.partial(asks, asked, also),
        "succeeds": functools.partial(succeeds, also),
        "needs": frozenset({"objects"}),
    }
    return Task("flange", control, **(usual | parts))


def check(setup: TaskSetup) -> None:
    """Make sure that there is room for an object to be away from its goal.

    Raises:
        InputError: the arm's hand works in too small a part of the table.
    """
    low, high = goal_box(setup)
    if (wide := float(np.linalg.norm((high - low)[:2]))) < APART:
        raise InputError(
            f"an object has to begin {1000 * APART:.0f} mm from its goal, and the hand of robot {setup.robot.name!r},"
            f" which has {setup.robot.chain.n} joint{'s'[: setup.robot.chain.n > 1]}, works in a part of the table"
            f" {1000 * wide:.0f} mm wide: choose another arm or task."
        )


def scene(setup: TaskSetup) -> Scene:
    """The object, as the settings have it."""
    rules, (shape, form) = setup.rules, FORMS[setup.rules.object_shape]
    size, friction = tuple(rules.object_size * side for side in form), rules.object_friction
    return Scene(objects=1, shape=shape, size=size, mass=rules.object_mass, friction=friction, grip=friction)


def goal_box(setup: TaskSetup) -> Bounds:
    """Corners `[3]` m of the part of the table in which the object's middle is asked for."""
    low, high = above(setup)
    high[2] = low[2]
    return low, high


def above(setup: TaskSetup) -> Bounds:
    """Corners `[3]` m of the same part of the table, and of the air above it."""
    low, high = working_box(setup.robot)
    shape, size = FORMS[setup.rules.object_shape]
    low[2] += setup.rules.object_size * (size[0] if shape == Shape.BALL else size[2])
    return low, high


def sample_goal(setup: TaskSetup, key: Array) -> Goal:
    """A place on the table."""
    return Goal.at(_place(setup, key))


def sample_above(setup: TaskSetup, key: Array) -> Goal:
    """A place on the table or in the air above it."""
    low, high = map(jnp.array, above(setup))
    for_place, for_table = jax.random.split(key)
    place = low + (high - low) * jax.random.uniform(for_place, (3,))
    on_table = jax.random.uniform(for_table) < ON_TABLE
    return Goal.at(place.at[2].set(jnp.where(on_table, low[2], place[2])))


def _place(setup: TaskSetup, key: Array) -> Array:
    low, high = map(jnp.array, goal_box(setup))
    return low + (high - low) * jax.random.uniform(key, (3,))


def sample_object(setup: TaskSetup, key: Array, _start: Array, goal: Goal) -> Bodies:
    """The object of an episode `[1]`, at another place on the table."""
    shape, size = FORMS[setup.rules.object_shape]
    for_yaw, *for_places = jax.random.split(key, DRAWS + 1)
    places = jnp.stack([_place(setup, one) for one in for_places])
    away = norm(places - goal.position)
    position = places[jnp.where((away >= APART).any(), jnp.argmax(away >= APART), jnp.argmax(away))]
    half_turn = jax.random.uniform(for_yaw, minval=-YAW, maxval=YAW) / 2
    zero = jnp.zeros(())
    return Bodies(
        position=position[None],
        quaternion=jnp.stack([jnp.cos(half_turn), zero, zero, jnp.sin(half_turn)])[None],
        velocity=jnp.zeros((1, 6)),
        size=setup.rules.object_size * jnp.array([size]),
        kind=jnp.full(1, shape, jnp.int32),
    )


def vary(setup: TaskSetup, key: Array, goal: Goal, bodies: Bodies) -> tuple[Goal, Bodies]:
    """Goal and object of another size, both on the table; a goal in the air stays where the object has room."""
    table = jnp.array(goal_box(setup)[0])[2]
    share = 1 + SIZE_SPREAD * jax.random.uniform(key, minval=-1.0)
    up = (share - 1) * bodies.extent[-1, 2] * jnp.array([0.0, 0.0, 1.0])
    bodies = replace(bodies, position=bodies.position.at[-1].add(up), size=bodies.size.at[-1].multiply(share))
    height = goal.position[2]
    lies = jnp.where(height > table + LIES, jnp.maximum(height, table + up[2]), height + up[2])
    return replace(goal, position=goal.position.at[2].set(lies)), bodies


def place(setup: TaskSetup, goal: Goal, position: Array, _quaternion: Array, _near: Array) -> tuple[Goal, Array]:
    """The goal put at the nearest place where goals are, as high as it was where they all lie; see `Task.place`."""
    low, high = map(jnp.array, setup.task.goal_box(setup))
    height = jnp.where(low[2] == high[2], goal.position[0, 2], jnp.clip(position, low, high)[2])
    return replace(goal, position=jnp.clip(position, low, high).at[2].set(height)[None]), jnp.ones((), bool)


def achieved(now: Situation) -> Array:
    """Where the object is `[B, 3]` m."""
    return now.bodies.position[:, -1]


def errors(_setup: TaskSetup, now: Situation) -> Errors:
    """Distance from the object to the goal."""
    distance = now.goal.distance(achieved(now))
    return Errors(distance, jnp.zeros((len(distance), 0)))


def update(setup: TaskSetup, before: reach.Held, errors: Errors, now: Situation, clock: Array) -> Any:
    """The last steps, see `reach.update`; still are joints and object."""
    moves = norm(now.bodies.velocity[:, -1, :3]) >= REST
    return reach.update(setup, before, errors, now._replace(qd=jnp.where(moves[:, None], jnp.inf, now.qd)), clock)


def asks(asked: str, also: str, rules: Any, period: float) -> str:
    """What is asked for, in words."""
    steps = f"{rules.max_steps:,} steps ({rules.max_steps * period:.2g} s)"
    return f"{asked}: {_rests(rules, period)}{also}; an episode has {steps}"


def succeeds(also: str, rules: Any, period: float) -> str:
    """What an episode has to come to, in words."""
    return f"at the end {_rests(rules, period)}{also}"


def _rests(rules: Any, period: float) -> str:
    return (
        f"the object has been within {1000 * rules.success_distance:.4g} mm for {rules.hold_steps} steps"
        f" ({rules.hold_steps * period:.2g} s), slower than {REST:g} m/s, and no joint faster than"
        f" {rules.hold_speed:g} rad/s"
    )
