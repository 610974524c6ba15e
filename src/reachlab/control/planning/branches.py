"""Branches of a pose: the joint vectors that have it."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from reachlab.control.planning.arm import Arm
from reachlab.control.planning.collision import CollisionChecker
from reachlab.robots.kinematics.transforms import motions

STARTS = 24
"""Joint vectors from which those of a pose are looked for: home, and random ones."""

ITERATIONS = 25
"""Steps from each of them at most."""

REACHED = 1e-5, 1e-4
"""Largest errors of what has the pose [m, rad]."""

DAMPING, BY_ERROR = 1e-5, 0.1
"""Damping of a step, and what is added to it by the square of the error."""

LONGEST = 1.0
"""Largest step of a joint [rad or m]."""

APART = 0.1
"""Joint vectors that are nearer to each other are one [rad]."""

TINY = 1e-9
"""Divides in place of a smaller number."""


def branches(
    arm: Arm, position: np.ndarray, rotation: np.ndarray, rng: Generator, iterations: int = ITERATIONS
) -> list[np.ndarray]:
    """Joint vectors `[k, n]` that have each of poses, `[b, 3]` m and `[b, 3, 3]`: those that are found.

    By steps damped by the square of the error (Sugihara, "Solvability-unconcerned inverse kinematics by the
    Levenberg-Marquardt method", IEEE Trans. Robotics 27(5), 2011).
    """
    q = rng.uniform(arm.lower, arm.upper, (len(position), STARTS, arm.n))
    q[:, 0] = arm.home
    q, whose = q.reshape(-1, arm.n), np.repeat(np.arange(len(position)), STARTS)
    left, reached = np.arange(len(q)), np.zeros(len(q), bool)
    for _ in range(iterations):
        error, jacobian, found = _errors(arm, q[left], position[whose[left]], rotation[whose[left]])
        reached[left[found]] = True
        left, error, jacobian = left[~found], error[~found], jacobian[~found]
        if not len(left):
            break
        across = np.swapaxes(jacobian, 1, 2)
        damping = DAMPING + BY_ERROR * (error**2).sum(axis=1)
        gram = jacobian @ across + damping[:, None, None] * np.eye(error.shape[1])
        step = (across @ np.linalg.solve(gram, error[..., None]))[..., 0]
        step *= LONGEST / np.maximum(np.abs(step).max(axis=1, keepdims=True), LONGEST)
        q[left] = np.clip(q[left] + step, arm.lower, arm.upper)
    return [q[reached & (whose == one)] for one in range(len(position))]


def _errors(
    arm: Arm, q: np.ndarray, position: np.ndarray, rotation: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors `[b, 6]` of the tool's poses, the Jacobians of these poses `[b, 6, n]`, and which errors are none `[b]`.

    With fewer than six joints it is the tilt alone that has an error, in the upright plane of first joint and tool.
    """
    links = arm.links_at(q)
    tool = links[:, -1]
    linear = position - tool[:, :3, 3]
    moves, turns = motions(links[:, :-1], arm.slides, tool[:, :3, 3])
    if arm.poses:
        missing = rotation @ np.swapaxes(tool[:, :3, :3], 1, 2)
        trace = np.trace(missing, axis1=1, axis2=2)
        skew = np.stack([missing[:, i, j] - missing[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
        angular = skew / np.sqrt(np.maximum(1.0 + trace, TINY))[:, None]
    else:
        points, down = tool[:, :3, :3] @ arm.approach, (rotation @ arm.approach)[:, 2]
        out = tool[:, :2, 3] - links[:, 0, :2, 3]
        across = np.stack([-out[:, 1], out[:, 0], 0 * out[:, 0]], axis=1)
        across /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), TINY)
        aside = np.sqrt(np.maximum(1.0 - down**2, 0.0))
        wanted = np.stack([aside * across[:, 1], -aside * across[:, 0], down], axis=1)
        angular = across * (across * np.cross(points, wanted)).sum(axis=1, keepdims=True)
        turns = across[:, None] * (turns * across[:, None]).sum(axis=2, keepdims=True)
    distance, angle = (np.linalg.norm(part, axis=1) for part in (linear, angular))
    jacobian = np.swapaxes(np.concatenate([moves, turns], axis=2), 1, 2)
    return np.concatenate([linear, angular], axis=1), jacobian, (distance <= REACHED[0]) & (angle <= REACHED[1])


def free_branches(checker: CollisionChecker, arm: Arm, q: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Those of joint vectors `[k, n]` that are free and differ, the soonest reached from `start [n]` first."""
    free = [one for one in q if checker.free(one)]
    different: list[np.ndarray] = []
    for one in sorted(free, key=lambda one: np.abs((one - start) / arm.speed).max()):
        if all(np.linalg.norm(one - other) > APART for other in different):
            different.append(one)
    return np.array(different).reshape(-1, arm.n)
