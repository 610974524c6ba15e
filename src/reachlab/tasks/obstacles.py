"""Obstacles: balls, capsules and boxes, all of them boxes that are swept by a ball."""

from __future__ import annotations

from dataclasses import dataclass

import jax
from jax import Array

FAR = (0.0, 0.0, -10.0)
"""Where obstacles are that are not there [m]: below everything, so that nothing has to tell them apart."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Obstacles:
    """At most `K` obstacles a scene; those that are not there lie at `FAR`.

    Each holds the points within its radius of a box: without half sizes a ball, with that along z alone a capsule.

    Attributes:
        position: middle `[..., K, 3]` [m].
        quaternion: orientation `[..., K, 4]`, wxyz.
        half: half sizes of the box along its own axes `[..., K, 3]` [m].
        radius: `[..., K]` [m]; 0 of a box with sharp edges.
    """

    position: Array
    quaternion: Array
    half: Array
    radius: Array

    @property
    def present(self) -> Array:
        """Which of them are there `[..., K]`."""
        return self.position[..., 2] > FAR[2] / 2
