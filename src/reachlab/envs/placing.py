"""A goal that is put somewhere by a person: in the viewer by hand, or in code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.jax_setup import jit
from reachlab.robots.clearance import free_of_contact
from reachlab.robots.kinematics import Pose, forward_kinematics
from reachlab.settings.validation import InputError
from reachlab.sims import BatchArray
from reachlab.tasks.clutter import joints_at
from reachlab.tasks.targets import nearest_joints
from reachlab.tasks.task import Goal, TaskSetup

SPACE = 3
"""Numbers of a position; those of a quaternion follow."""

Place = Callable[[Goal, BatchArray, BatchArray | None, BatchArray], tuple[Goal, Array]]


def make_place(setup: TaskSetup) -> Place:
    """Function that puts a goal somewhere, and tells whether the arm can be there freely `[]`.

    Of a batch with a single goal, a position `[3]` m, an orientation `[4]` wxyz, None where any will do, and the arm's
    joints `[n]`. The joints of a pose are the nearest to these; the goal becomes exactly their pose. One that moves is
    taken off its path. The goal keeps its structure, so that nothing is compiled anew.
    """

    def place(goal: Goal, position: Array, quaternion: Array | None, near: Array) -> tuple[Goal, Array]:
        if goal.joints is None:
            stays = None if goal.velocity is None else jnp.zeros_like(goal.velocity)
            path = None if goal.path is None else jnp.full_like(goal.path, jnp.nan)
            return replace(goal, position=position[None], velocity=stays, path=path), jnp.ones((), bool)
        if quaternion is None:
            q, found = joints_at(setup, position)
        else:
            pose = Pose(position, quaternion / jnp.linalg.norm(quaternion))
            q, found = nearest_joints(setup, pose, near, goal.joints[0], jax.random.key(0))
        reached, joints = forward_kinematics(setup.robot.chain, q[None]), q[None]
        turned = None if quaternion is None else reached.quaternion
        return Goal(reached.position, turned, joints), found & free_of_contact(setup.robot, joints)[0]

    return jit(place)


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
    goal, found = place(
        nowhere, given[:SPACE], given[SPACE:] if len(given) > SPACE else None, np.array(setup.robot.home)
    )
    if not found:
        raise InputError(f"the arm has no joints for target {given.tolist()}: choose another.")
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
