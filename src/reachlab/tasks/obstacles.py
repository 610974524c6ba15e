"""Obstacles: balls, capsules and boxes, all of them boxes that are swept by a ball."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.capsules import Capsules
from reachlab.robots.clearance import Segments, moving
from reachlab.robots.kinematics import components
from reachlab.robots.scalar_algebra import Vec, rotation_from_quaternion

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


class Nearest(NamedTuple):
    """What of the obstacles and the table is nearest to each of `C` moving capsules of an arm.

    Attributes:
        distance: from the capsule to it `[C, B]` [m]; where they overlap at most minus the radii.
        normal: unit vector away from it, three `[C, B]`; zero deep inside.
        point: of the capsule's axis that is nearest to it, three `[C, B]` [m].
    """

    distance: Array
    normal: tuple[Array, ...]
    point: tuple[Array, ...]


BISECTIONS = 8
"""Halvings of a capsule's axis until the point nearest to an obstacle is found: to a few tenths of a millimetre."""

TINY = 1e-9
"""Added to a length that divides [m]."""


def nearest(capsules: Capsules, at: Segments, obstacles: Obstacles, floor: float) -> Nearest:
    """What is nearest to each of an arm's moving capsules, which lie as `clearance.capsules_at` says.

    Args:
        capsules: the arm's.
        at: how they lie.
        obstacles: of each environment `[B, K]`.
        floor: height of the table [m].
    """
    start, end, radius = moving(capsules, at)
    lower = start[2] < end[2]
    point = tuple(jnp.where(lower, a, b) for a, b in zip(start, end, strict=True))
    zero = jnp.zeros_like(point[2])
    best = Nearest(point[2] - floor - radius, (zero, zero, zero + 1.0), point)
    for number in range(obstacles.radius.shape[-1]):
        one = beside(start, end, jax.tree.map(lambda x, k=number: x[:, k], obstacles))
        one = one._replace(distance=one.distance - radius)
        nearer = one.distance < best.distance
        best = jax.tree.map(lambda a, b, nearer=nearer: jnp.where(nearer, a, b), one, best)
    return best


def beside(start: tuple[Array, ...], end: tuple[Array, ...], obstacle: Obstacles) -> Nearest:
    """From one obstacle of each environment to axes, three `[C, B]` each.

    The distance to a convex body is a convex function along an axis: where it no longer falls is found by bisection.
    """
    rotation = rotation_from_quaternion(*components(obstacle.quaternion))
    middle, half = Vec(*components(obstacle.position)), components(obstacle.half)
    turned = rotation.transpose()
    a, b = turned.apply(Vec(*start).minus(middle)), turned.apply(Vec(*end).minus(middle))
    along = b.minus(a)

    def off(share: Array) -> tuple[Vec, Vec]:
        place = a.plus(along.times(share))
        nearest = [jnp.clip(x, -h, h) for x, h in zip(place, half, strict=True)]
        return place, place.minus(Vec(*nearest))

    def halve(_: int, limits: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = limits
        share = (low + high) / 2
        falls = off(share)[1].dot(along) < 0
        return jnp.where(falls, share, low), jnp.where(falls, high, share)

    limits = jnp.zeros_like(start[0]), jnp.ones_like(start[0])
    low, high = jax.lax.fori_loop(0, BISECTIONS, halve, limits)
    place, way = off((low + high) / 2)
    length = way.norm()
    normal = rotation.apply(way.times(1 / (length + TINY)))
    point = rotation.apply(place).plus(middle)
    return Nearest(length - obstacle.radius, _arrays(normal), _arrays(point))


def _arrays(vector: Vec) -> tuple[Array, ...]:
    return tuple(jnp.asarray(number) for number in vector)


def distance_from(obstacles: Obstacles, points: np.ndarray) -> Array:
    """Distance `[B, P]` m from each of `points [P, 3]` to the nearest obstacle; negative in a ball or capsule."""
    place = tuple(jnp.asarray(x, jnp.float32)[:, None] for x in points.T)
    distances = [
        beside(place, place, jax.tree.map(lambda x, k=number: x[:, k], obstacles)).distance
        for number in range(obstacles.radius.shape[-1])
    ]
    return jnp.stack(distances).min(axis=0).T
