"""In which episodes links of the arm meet, by their exact shapes."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from jax import Array

from reachlab.envs.core import Env
from reachlab.robots.shapes.clearance import capsules_at, self_distance
from reachlab.robots.shapes.self_contact import meeting
from reachlab.sims import SIMULATORS

Meets = Callable[[Array, np.ndarray], np.ndarray]
"""Whether links of the arm meet `[B]` at joints `[B, n]`, of the episodes `[B]` that are named."""


def make_meets(env: Env) -> Meets | None:
    """See `Meets`; None where dynamics do not move the arm, or no links of it can meet.

    Exact shapes are looked at only where capsules, which contain them, overlap.
    """
    robot = env.setup.robot
    if "dynamics" not in SIMULATORS[env.config.sim].gives or not (capsules := robot.capsules).pairs:
        return None

    def near(q: Array) -> Array:
        return self_distance(capsules, capsules_at(robot.chain, capsules, q)) < 0

    overlap = env.compile_part(near, "links")
    exactly = functools.cache(lambda: meeting(robot))

    def meets(q: Array, rows: np.ndarray) -> np.ndarray:
        found = np.asarray(overlap(q)) & rows
        found[found] = [exactly()(one) for one in np.asarray(q)[found]]
        return found

    return meets
