"""A target that a person moves and turns by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.jax_setup import jit
from reachlab.robots.clearance import free_of_contact
from reachlab.robots.kinematics import Pose, forward_kinematics
from reachlab.sims import BatchArray
from reachlab.tasks.clutter import joints_at
from reachlab.tasks.targets import nearest_joints
from reachlab.tasks.task import Goal, TaskSetup

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
