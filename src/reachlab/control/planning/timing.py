"""Time along a path: as fast as speeds and accelerations of the joints allow."""

from __future__ import annotations

import functools
import logging
import warnings
from typing import Any

import numpy as np

from reachlab.control.planning.following import Trajectory

STEP = 0.03
"""Distance along a path between the points at which its speed is found [rad]."""

FEWEST = 30
"""Such points at least."""

SHORT = 1e-6
"""Parts of a path that are left out [rad]."""

SETTLED = 5.0
"""Times of its servos' lag after which an arm stands where it was sent."""


def ahead(q: np.ndarray, qd: np.ndarray, lag: np.ndarray) -> Trajectory:
    """The motion `q [T, n]` with speeds `qd [T, n]` of joints that follow by times `[n]` [s], commanded ahead of it."""
    return Trajectory(q, q + lag * qd)


def smoothed(q: np.ndarray, steps: int, share: np.ndarray) -> Trajectory:
    """Commands `q [T, n]`, each averaged over so many steps, so that their jerk is bounded; and how joints follow them.

    In a step a joint takes `share [n]` of its way to the command.
    """
    settling = int(SETTLED / share.min())
    held = np.concatenate([np.repeat(q[:1], steps, axis=0), q[1:], np.repeat(q[-1:], steps + settling, axis=0)])
    sums = np.cumsum(np.concatenate([np.zeros_like(q[:1]), held]), axis=0)
    command = (sums[steps:] - sums[:-steps]) / steps
    followed = [command[0]]
    for one in command[1:]:
        followed.append(followed[-1] + share * (one - followed[-1]))
    return Trajectory(np.array(followed), command)


def timed(
    path: np.ndarray, speed: np.ndarray, acceleration: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Joints and speeds `[T, n]` on a cubic spline through a path `[k, n]`, within limits `[n]`; None if none are.

    By TOPP-RA (Pham and Pham, "A new approach to time-optimal path parameterization based on reachability analysis",
    IEEE Trans. Robotics 34(3), 2018).

    Raises:
        ModuleNotFoundError: TOPP-RA is not installed.
    """
    toppra = _library()
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    path = path[np.append(True, lengths > SHORT)]
    along = np.append(0.0, np.cumsum(lengths[lengths > SHORT]))
    if len(path) == 1:
        return path, np.zeros_like(path)
    spline = toppra.SplineInterpolator(along, path, bc_type="natural")
    limits = _limits(tuple(speed), tuple(acceleration))
    points = np.linspace(0.0, along[-1], max(int(along[-1] / STEP), FEWEST))
    timing = toppra.algorithm.TOPPRA(limits, spline, gridpoints=points, solver_wrapper="seidel")
    motion = timing.compute_trajectory(0.0, 0.0)
    if motion is None:
        return None
    times = np.minimum(np.arange(0.0, motion.duration + period, period), motion.duration)
    return motion(times), motion(times, 1)


@functools.cache
def _library() -> Any:
    """TOPP-RA, which says nothing. Its docstrings hold backslashes, of which Python warns where it compiles them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import toppra
        import toppra.algorithm
        import toppra.constraint
    logging.getLogger("toppra").setLevel(logging.ERROR)
    return toppra


@functools.cache
def _limits(speed: tuple[float, ...], acceleration: tuple[float, ...]) -> list[Any]:
    kinds = _library().constraint
    both = (speed, kinds.JointVelocityConstraint), (acceleration, kinds.JointAccelerationConstraint)
    return [kind(np.stack([-np.array(most), np.array(most)], axis=1)) for most, kind in both]
