"""Time along a path: as fast as speeds and accelerations of the joints allow."""

from __future__ import annotations

import logging
from typing import Any, NamedTuple

import numpy as np

STEP = 0.03
"""Distance along a path between the points at which its speed is found [rad]."""

FEWEST = 30
"""Such points at least."""

SHORT = 1e-6
"""Parts of a path that are left out [rad]."""


class Trajectory(NamedTuple):
    """Joints `q [T, n]` [rad or m] and their speeds `qd [T, n]`, a period apart, from rest to rest."""

    q: np.ndarray
    qd: np.ndarray


def timed(path: np.ndarray, speed: np.ndarray, acceleration: np.ndarray, period: float) -> Trajectory | None:
    """The motion along a cubic spline through a path `[k, n]` within limits `[n]`; None where there is none.

    By TOPP-RA (Pham and Pham, "A new approach to time-optimal path parameterization based on reachability analysis",
    IEEE Trans. Robotics 34(3), 2018).

    Raises:
        ModuleNotFoundError: TOPP-RA is not installed.
    """
    from toppra import SplineInterpolator
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

    logging.getLogger("toppra").setLevel(logging.ERROR)
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    path = path[np.append(True, lengths > SHORT)]
    along = np.append(0.0, np.cumsum(lengths[lengths > SHORT]))
    if len(path) == 1:
        return Trajectory(path, np.zeros_like(path))
    spline = SplineInterpolator(along, path, bc_type="natural")
    limits = [
        JointVelocityConstraint(np.stack([-speed, speed], axis=1)),
        JointAccelerationConstraint(np.stack([-acceleration, acceleration], axis=1)),
    ]
    points = np.linspace(0.0, along[-1], max(int(along[-1] / STEP), FEWEST))
    motion: Any = TOPPRA(limits, spline, gridpoints=points, solver_wrapper="seidel").compute_trajectory(0.0, 0.0)
    if motion is None:
        return None
    times = np.minimum(np.arange(0.0, motion.duration + period, period), motion.duration)
    return Trajectory(motion(times), motion(times, 1))
