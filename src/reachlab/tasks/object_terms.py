"""Terms of observations of an object beside the arm."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.hand import yaw
from reachlab.control.situation import Situation
from reachlab.tasks.schema import Term
from reachlab.tasks.task import Bounds, TaskSetup
from reachlab.tasks.terms import ARM, GOAL, LAST_ACTION, TOOL_AXES, near_form, way_bounds, within

FASTEST_OBJECT = 5.0
"""Objects are no faster along the table [m/s]."""


def _left_all(_setup: TaskSetup, now: Situation) -> Array:
    """From the object to the goal."""
    return now.goal.position - now.bodies.position[:, -1]


def _left(setup: TaskSetup, now: Situation) -> Array:
    """The same along the table."""
    return _left_all(setup, now)[:, :2]


def _faces(_setup: TaskSetup, now: Situation) -> Array:
    """Sine and cosine of four times the object's yaw: the same for each face of a cube."""
    turn = 4 * yaw(now.bodies.quaternion[:, -1])
    return jnp.stack([jnp.sin(turn), jnp.cos(turn)], axis=-1) * ~now.bodies.round[:, -1:]


def _faceless(setup: TaskSetup) -> np.ndarray:
    return np.full(2, setup.rules.object_shape != "box")


def _plane(bounds: Bounds) -> Bounds:
    return bounds[0][:2], bounds[1][:2]


def _room(setup: TaskSetup) -> float:
    """Widest opening of the gripper, and what fingers swing past it [m]; 0 where none is driven."""
    return 1.25 * setup.robot.gripper.widest if setup.robot.gripper else 0.0


OBJECT = (
    *ARM,
    GOAL,
    LAST_ACTION,
    TOOL_AXES,
    Term("object_way", "m", lambda _, now: now.bodies.position[:, -1] - now.tool_position, way_bounds),
    Term("left", "m", _left, lambda setup: _plane(way_bounds(setup))),
    Term("left_near", "1", lambda setup, now: near_form(_left(setup, now)), lambda _: within(np.ones(2))),
    Term("faces", "1", _faces, lambda _: within(np.ones(2)), _faceless),
)
"""The arm and the goal, where the object is beside both, and how it is turned."""

GRIPPED = (
    *OBJECT[:-3],  # but what is left along the table
    OBJECT[-1],
    Term("left_all", "m", _left_all, way_bounds),
    Term("left_all_near", "1", lambda setup, now: near_form(_left_all(setup, now)), lambda _: within(np.ones(3))),
    Term("opening", "m", lambda _, now: now.opening, lambda setup: within([_room(setup)])),
    Term("squeeze", "m", lambda _, now: now.opening - now.command[:, -1:], lambda setup: within([_room(setup)])),
)
"""The same in all directions, how wide the hand is open, and how far below that it is commanded."""

STRUCK = (
    *OBJECT,
    Term(
        "object_velocity", "m/s", lambda _, now: now.bodies.velocity[:, -1, :2], lambda _: within([FASTEST_OBJECT] * 2)
    ),
)
"""The same as `OBJECT`, and how fast the object slides."""
