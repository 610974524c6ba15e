"""What an arm can reach of the targets of a task, found out before any time is spent on training."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.jax_setup import jit
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.kinematics.inverse import ik_point_step
from reachlab.robots.robot import Robot
from reachlab.tasks.targets import solved_for
from reachlab.tasks.task import TaskSetup

SAMPLES = 256
"""Targets and starts that are sampled."""

POSES = 4096
"""Random joint vectors from which the nearest to a target are taken to begin at."""

BEGINNINGS = 4
"""So many of them for each target."""

ITERATIONS = 50
"""Steps of the solver from each; those that arrive do so in about ten."""

LONGEST_STEP = 0.1
"""Largest tool displacement of one step of the solver [m]."""

ROUNDING = 1e-3
"""A tool this far outside the workspace counts as on its edge [m]: the solver stops within a tenth of it."""


@dataclass(frozen=True)
class Survey:
    """Shares, of `SAMPLES` each.

    Attributes:
        reached: targets to which the tool comes within the distance of success, inside the workspace where leaving it
            ends the episode.
        outside: starts outside the workspace where leaving it ends the episode, at the first step.
    """

    reached: float
    outside: float


def survey(setup: TaskSetup) -> Survey:
    """What the arm can reach of the task within its joint limits, in whatever orientation; dynamics do not count.

    An orientation that is held counts for nothing: where joint limits leave no choice, position outranks it.
    """
    random, robot, bounded = np.random.default_rng(0), setup.robot, setup.rules.ends_outside
    low, high = np.array(robot.workspace)
    reached = _drawn_within(setup) if solved_for(setup) else _within_reach(setup, random)

    noise = robot.chain.noise(setup.rules.start_noise)
    starts = robot.home + random.uniform(-1.0, 1.0, (SAMPLES, robot.chain.n)) * noise
    begun = _tool(robot, np.clip(starts, robot.chain.lower, robot.chain.upper))
    outside = bounded & ((begun < low) | (begun > high)).any(axis=-1)
    return Survey(float(reached.mean()), float(outside.mean()))


def _within_reach(setup: TaskSetup, random: np.random.Generator) -> np.ndarray:
    """Which of `SAMPLES` random targets the tool comes near to."""
    bounded, (low, high) = setup.rules.ends_outside, np.array(setup.robot.workspace)
    targets = random.uniform(*setup.task.goal_box(setup), (SAMPLES, 3))
    points = _nearest(setup.robot, np.clip(targets, low, high) if bounded else targets)
    inside = ((points >= low - ROUNDING) & (points <= high + ROUNDING)).all(axis=-1)
    near = np.asarray(np.linalg.norm(points - targets, axis=-1) < setup.rules.success_distance)
    return near & inside if bounded else near


def _drawn_within(setup: TaskSetup) -> np.ndarray:
    """Which of `SAMPLES` targets that the task draws are in its box; those that it gave up to find are not."""
    low, high = setup.task.goal_box(setup)
    keys = jax.random.split(jax.random.key(0), SAMPLES)
    drawn = np.asarray(jit(jax.vmap(lambda key: setup.task.sample_goal(setup, key).position), once=True)(keys))
    return np.asarray(((drawn >= low - ROUNDING) & (drawn <= high + ROUNDING)).all(axis=-1))


def _tool(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Tool positions `[B, 3]` m at joints `[B, n]`."""
    return np.asarray(jit(lambda q: forward_kinematics(robot.chain, q).position, once=True)(q.astype(np.float32)))


def _nearest(robot: Robot, aims: np.ndarray) -> np.ndarray:
    """Points `[B, 3]` m nearest to `aims [B, 3]` that the tool comes to."""
    chain = robot.chain
    sampled = np.random.default_rng(1).uniform(chain.lower, chain.upper, (POSES, chain.n)).astype(np.float32)

    def solve(aims: Array, poses: Array) -> Array:
        def step(_: int, q: Array) -> Array:
            way = aims[:, None] - forward_kinematics(chain, q).position
            way *= LONGEST_STEP / jnp.maximum(jnp.linalg.norm(way, axis=-1, keepdims=True), LONGEST_STEP)
            return q + ik_point_step(chain, q, q, way)

        apart = jnp.linalg.norm(aims[:, None] - forward_kinematics(chain, poses).position, axis=-1)
        _, near = jax.lax.top_k(-apart, BEGINNINGS)
        found = forward_kinematics(chain, jax.lax.fori_loop(0, ITERATIONS, step, poses[near])).position
        best = jnp.linalg.norm(aims[:, None] - found, axis=-1).argmin(axis=-1)
        return jnp.take_along_axis(found, best[:, None, None], axis=1)[:, 0]

    return np.asarray(jit(solve, once=True)(aims.astype(np.float32), sampled))
