"""Goals that are put somewhere by a person: in the page by hand, or in code."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.control.situation import Goal
from reachlab.robots.kinematics.chain import PosedChain
from reachlab.robots.kinematics.forward import Pose, forward_kinematics
from reachlab.robots.kinematics.inverse import ik_point_step
from reachlab.robots.shapes.clearance import free_of_contact
from reachlab.tasks.targets import nearest_joints
from reachlab.tasks.task import TaskSetup

ITERATIONS, LONGEST_STEP = 40, 0.1
"""Steps of the solver, and largest displacement of the tool in one [m]; those that arrive do so in about fifteen."""

NEAR = 1e-4
"""Distance of the tool from a point at which joints count as having it [m]."""


def joints_at(setup: TaskSetup, point: Array) -> tuple[Array, Array]:
    """Joints `[n]` near home that have a point `[3]` m; and if any were found."""
    chain = setup.robot.chain

    def step(_: int, q: Array) -> Array:
        way = point - forward_kinematics(chain, q).position
        way *= jnp.minimum(LONGEST_STEP / (jnp.linalg.norm(way) + NEAR), 1.0)
        return q + ik_point_step(chain, q, q, way)

    home = jnp.array(setup.robot.home) + 0.0 * point[0]  # of a batch where the point is: see `of_key`
    q = jax.lax.fori_loop(0, ITERATIONS, step, home)
    return q, jnp.linalg.norm(forward_kinematics(chain, q).position - point) < NEAR


def place_free_point(
    setup: TaskSetup, goal: Goal, position: Array, _quaternion: Array, _near: Array
) -> tuple[Goal, Array]:
    """A point with joints near home that have it, see `Task.place`; exactly the point of these joints."""
    q, found = joints_at(setup, position)
    reached = forward_kinematics(setup.robot.chain, q[None])
    return replace(goal, position=reached.position, joints=q[None]), found & _free(setup, q)


def place_pose(setup: TaskSetup, goal: Goal, position: Array, quaternion: Array, near: Array) -> tuple[Goal, Array]:
    """A pose with the joints nearest to the arm's that have it, see `Task.place`; exactly the pose of these joints.

    Where an arm with fewer than six joints has none, it is one of the same position and tilt.
    """
    chain, starts = setup.robot.chain, (near, goal.joints[0], jax.random.key(0))
    pose = Pose(position, quaternion / jnp.linalg.norm(quaternion))
    q, found = nearest_joints(setup, pose, *starts)
    if not chain.poses:
        whole, exact = nearest_joints(setup, pose, *starts, PosedChain(**vars(chain)))
        q, found = jnp.where(exact, whole, q), found | exact
    reached = forward_kinematics(setup.robot.chain, q[None])
    placed = replace(goal, position=reached.position, quaternion=reached.quaternion, joints=q[None])
    return placed, found & _free(setup, q)


def _free(setup: TaskSetup, q: Array) -> Array:
    return free_of_contact(setup.robot.chain, setup.robot.capsules, q[None])[0]
