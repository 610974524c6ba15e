"""What of an arm follows from its chain where nobody says it: the box in which it works, and how it holds its tool."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from reachlab.robots.chain import Chain
from reachlab.robots.kinematics import forward_kinematics
from reachlab.robots.robot import Box

SAMPLES = 4096
"""Random joint vectors from which the workspace is estimated."""

QUANTILES = (0.1, 0.9)
"""The workspace's faces have these shares of the points below them."""


def reachable_box(chain: Chain) -> Box:
    """Box around the middle 80 % of the points that the tool reaches, above the floor [m]."""
    lower, upper = chain.finite_limits()
    q = jnp.asarray(np.random.default_rng(0).uniform(lower, upper, (SAMPLES, chain.n)), jnp.float32)
    points = np.asarray(forward_kinematics(chain, q).position)
    low, high = np.quantile(points, QUANTILES, axis=0)
    low[2] = min(max(low[2], 0.0), high[2])
    return tuple(low.tolist()), tuple(high.tolist())


def held_quaternion(chain: Chain, home: tuple[float, ...]) -> tuple[float, ...]:
    """Orientation wxyz of the tool at home."""
    return tuple(np.asarray(forward_kinematics(chain, jnp.asarray(home, jnp.float32)).quaternion).tolist())
