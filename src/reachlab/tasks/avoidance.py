"""Joint displacements that keep an arm clear of obstacles: velocity dampers."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.clearance import capsules_at
from reachlab.robots.kinematics import components, frames_at
from reachlab.robots.scalar_algebra import Vec
from reachlab.tasks.obstacles import Nearest, nearest
from reachlab.tasks.task import Situation, TaskSetup

STOP = 0.03
"""Distance at which a capsule may come no nearer [m], in proportion to the arm's workspace."""

RATE = 0.08
"""Share of its way to that distance that a capsule may go in a step."""

SWEEPS = 6
"""Times that the displacement is made to obey each capsule's limit in turn."""

TINY = 1e-6
"""Added to a square that divides."""


def surroundings(setup: TaskSetup, q: Array, now: Situation) -> Nearest:
    """What is nearest to the arm's capsules at joints `q [B, n]`."""
    robot = setup.robot
    assert now.obstacles is not None, "asked before"  # noqa: S101
    return nearest(robot, capsules_at(robot.chain, robot.capsules, q), now.obstacles)


def keep_clear(setup: TaskSetup, now: Situation, step: Array) -> Array:
    """Joint displacement `[B, n]` that brings no capsule nearer to an obstacle than `RATE` allows.

    Faverjon and Tournassoud, "A local based approach for path planning of manipulators with a high number of degrees of
    freedom", ICRA 1987. The limits, one a capsule, are obeyed in turn by the smallest change (Kaczmarz, 1937).
    """
    around = surroundings(setup, now.target_q, now)
    rows = _approach(setup, now.target_q, around)
    least = -RATE * jnp.maximum(around.distance - STOP * setup.robot.scale, -STOP)
    squares = jnp.square(rows).sum(axis=1) + TINY

    def obey(turn: int, step: Array) -> Array:
        number = turn % len(rows)
        row = rows[number]
        missing = jnp.maximum(least[number] - (row * step).sum(axis=0), 0.0)
        return step + missing / squares[number] * row

    return jax.lax.fori_loop(0, SWEEPS * len(rows), obey, step.T).T


def _approach(setup: TaskSetup, q: Array, around: Nearest) -> Array:
    """By how much displacements of the joints move each moving capsule away from what is nearest, `[C, n, B]`."""
    chain, links = setup.robot.chain, np.array([link for link in setup.robot.capsules.links if link])
    frames = frames_at(chain, components(q))
    normal, point = Vec(*around.normal), Vec(*around.point)
    columns = []
    for joint, (slides, axis, origin) in enumerate(zip(chain.slides, frames.axes, frames.origins, strict=True)):
        moves = axis if slides else axis.cross(point.minus(origin))
        columns.append(jnp.where((joint < links)[:, None], normal.dot(moves), 0.0))
    return jnp.stack(columns, axis=1)


def moving_capsules(setup: TaskSetup) -> int:
    """How many of the arm's capsules its joints move."""
    return int(np.count_nonzero(setup.robot.capsules.links))


def clearance_terms(setup: TaskSetup, now: Situation, near: float) -> Array:
    """Of each moving capsule the direction away from what is nearest, shorter the further away, `[B, 3 C]`."""
    around = surroundings(setup, now.q, now)
    close = near / (near + jnp.maximum(around.distance, 0.0))
    return jnp.concatenate([(close * x).T for x in around.normal], axis=-1)


def basis_points(setup: TaskSetup, each: int) -> np.ndarray:
    """Points `[each³, 3]` m on a grid in the arm's goal box and around it."""
    low, high = np.array(setup.robot.goal_box)
    axes = [np.linspace(a, b, each) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)
