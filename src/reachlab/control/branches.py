"""Branches of a pose: the joint vectors that have it."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from numpy.random import Generator

from reachlab.control.planning.collision import CollisionChecker
from reachlab.jax_setup import jit
from reachlab.robots.kinematics.forward import Pose
from reachlab.robots.kinematics.inverse import inverse_kinematics
from reachlab.robots.robot import Robot

STARTS = 24
"""Joint vectors from which those of a pose are looked for: home, and random ones."""

APART = 0.1
"""Joint vectors that are nearer to each other are one [rad]."""

Solver = Callable[[np.ndarray, np.ndarray, Generator], list[np.ndarray]]
"""Gives joint vectors `[k, n]` that have each of poses `[b, 3]` m and `[b, 4]` wxyz, those that are found."""


def make_solver(robot: Robot) -> Solver:
    """Function that looks for the branches of poses."""
    chain, key = robot.chain, jax.random.key(0)
    solve = jit(lambda pose, start: inverse_kinematics(chain, pose, start, key, restarts=0), brief=True)

    def solver(position: np.ndarray, quaternion: np.ndarray, rng: Generator) -> list[np.ndarray]:
        starts = rng.uniform(chain.lower, chain.upper, (len(position), STARTS, chain.n))
        starts[:, 0] = robot.home
        pose = Pose(*(jnp.repeat(jnp.asarray(part, jnp.float32), STARTS, axis=0) for part in (position, quaternion)))
        found = solve(pose, starts.reshape(-1, chain.n).astype(np.float32))
        q, converged = np.asarray(found.q).reshape(starts.shape), np.asarray(found.converged)
        return [one[at] for one, at in zip(q, converged.reshape(starts.shape[:2]), strict=True)]

    return solver


def free_branches(checker: CollisionChecker, robot: Robot, q: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Those of joint vectors `[k, n]` that are free and differ, the soonest reached from `start [n]` first."""
    free = [one for one in q if checker.free(one)]
    different: list[np.ndarray] = []
    for one in sorted(free, key=lambda one: np.abs((one - start) / robot.speed).max()):
        if all(np.linalg.norm(one - other) > APART for other in different):
            different.append(one)
    return np.array(different).reshape(-1, robot.chain.n)
