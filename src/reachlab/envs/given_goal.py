"""A goal that is put somewhere by a person: in the page by hand, or in code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.situation import Goal
from reachlab.jax_setup import jit
from reachlab.settings.validation import InputError
from reachlab.sims.simulator import BatchArray
from reachlab.tasks.task import TaskSetup

SPACE = 3
"""Numbers of a position; those of a quaternion follow."""

MOVED = 1e-3
"""A target that is put further away than that is not one of the task's [m]."""

Place = Callable[[Goal, BatchArray, BatchArray, BatchArray], tuple[Goal, Array]]
"""`Task.place` of a task on an arm, compiled; the goal keeps its structure, so that nothing is compiled anew."""


def make_place(setup: TaskSetup) -> Place:
    """Function that puts a goal somewhere, and tells whether the arm can be there freely `[]`; see `Task.place`."""
    return jit(partial(setup.task.place, setup))


def goal_at(setup: TaskSetup, target: Any, place: Place) -> Goal:
    """Goal `[1, ...]` at a target `[3]` m or, where an orientation is asked for, `[7]`, position and quaternion wxyz.

    Args:
        setup: the task on the arm.
        target: what a person has asked for, unchecked.
        place: of `make_place`.

    Raises:
        InputError: the target is misshapen, not finite or outside the box of the task's goals, or the arm cannot be
            there freely.
    """
    given = _checked_target(setup, target)
    drawn = jax.eval_shape(partial(setup.task.sample_goal, setup), jax.random.key(0))
    nowhere = jax.tree.map(lambda part: jnp.zeros((1, *part.shape), part.dtype), drawn)
    before = replace(nowhere, position=jnp.array(given[None, :SPACE]))
    goal, found = place(before, given[:SPACE], given[SPACE:], np.array(setup.robot.home))
    if not found:
        raise InputError(f"the arm has no joints for target {given.tolist()}: choose another.")
    placed = np.asarray(goal.position)[0]
    if np.linalg.norm(placed - given[:SPACE]) > MOVED:
        raise InputError(
            f"the task asks for nothing at target {given[:SPACE].tolist()}: the nearest is {placed.round(4).tolist()}."
        )
    return goal


def _checked_target(setup: TaskSetup, target: Any) -> np.ndarray:
    """The target as float32 `[3]` or `[7]`.

    Raises:
        InputError: see `goal_at`.
    """
    turned = setup.rules.asks_orientation
    wanted = "7 finite numbers, a position [m] and a quaternion wxyz" if turned else "3 finite numbers [m]"
    try:
        given = np.asarray(target, np.float32)
    except (TypeError, ValueError):
        raise InputError(f"target must be {wanted}, got {target!r}.") from None
    if given.shape != (SPACE + 4 * turned,) or not np.isfinite(given).all() or (turned and not given[SPACE:].any()):
        raise InputError(f"target must be {wanted}, got {target!r}.")
    low, high = setup.task.goal_box(setup)
    if ((given[:SPACE] < low) | (given[:SPACE] > high)).any():
        corners = [", ".join(f"{number:g}" for number in corner) for corner in (low, high)]
        raise InputError(
            f"target {given[:SPACE].tolist()} is outside the box of the task's goals, ({corners[0]}) to"
            f" ({corners[1]}) m: choose one inside."
        )
    return given
