"""Obstacles: balls, capsules and boxes, all of them boxes that are swept by a ball."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.clearance import Segments, moving
from reachlab.robots.kinematics import components
from reachlab.robots.robot import Robot
from reachlab.robots.scalar_algebra import Rotation, Vec, rotation_from_quaternion

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


def nearest(robot: Robot, at: Segments, obstacles: Obstacles) -> Nearest:
    """What is nearest to each of an arm's moving capsules, which lie as `clearance.capsules_at` says.

    Args:
        robot: the arm.
        at: how they lie.
        obstacles: of each environment `[B, K]`.
    """
    start, end, radius = moving(robot.capsules, at)
    lower = start[2] < end[2]
    point = tuple(jnp.where(lower, a, b) for a, b in zip(start, end, strict=True))
    zero = jnp.zeros_like(point[2])
    table = Nearest(point[2] - np.array(robot.floors, np.float32)[:, None], (zero, zero, zero + 1.0), point)
    # Obstacles in front, the capsules next and the batch last.
    each = jax.tree.map(lambda x: jnp.moveaxis(x, 1, 0)[:, None], obstacles)
    others = beside(start, end, each)
    chosen = others.distance.argmin(axis=0)[None]
    other = jax.tree.map(
        lambda x: jnp.take_along_axis(jnp.broadcast_to(x, others.distance.shape), chosen, 0)[0], others
    )
    nearer = other.distance < table.distance
    found = jax.tree.map(lambda a, b: jnp.where(nearer, a, b), other, table)
    return found._replace(distance=found.distance - radius)


def beside(start: tuple[Array, ...], end: tuple[Array, ...], obstacle: Obstacles) -> Nearest:
    """From obstacles to segments, whose shapes are broadcast against each other.

    The distance to a convex body is a convex function along a segment: where it no longer falls is found by bisection.
    """
    rotation, middle = _frame(obstacle)
    back, half = rotation.transpose(), components(obstacle.half)
    a, b = back.apply(Vec(*start).minus(middle)), back.apply(Vec(*end).minus(middle))
    along = b.minus(a)

    def halve(_: int, limits: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = limits
        share = (low + high) / 2
        falls = _off(a.plus(along.times(share)), half).dot(along) < 0
        return jnp.where(falls, share, low), jnp.where(falls, high, share)

    shape = jnp.broadcast_shapes(start[0].shape, obstacle.radius.shape)
    low, high = jax.lax.fori_loop(0, BISECTIONS, halve, (jnp.zeros(shape), jnp.ones(shape)))
    place = a.plus(along.times((low + high) / 2))
    way = _off(place, half)
    length = way.norm()
    normal, point = rotation.apply(way.times(1 / (length + TINY))), rotation.apply(place).plus(middle)
    return Nearest(length - obstacle.radius, _arrays(normal), _arrays(point))


def distance_from(obstacles: Obstacles, points: np.ndarray) -> Array:
    """Distance `[B, P]` m from each of `points [P, 3]` to the nearest of obstacles `[B, K]`; 0 in a box."""
    each = jax.tree.map(lambda x: x[:, :, None], obstacles)
    rotation, middle = _frame(each)
    place = rotation.transpose().apply(Vec(*jnp.asarray(points.T)).minus(middle))
    return (_off(place, components(each.half)).norm() - each.radius).min(axis=1)


def _frame(obstacle: Obstacles) -> tuple[Rotation, Vec]:
    return rotation_from_quaternion(*components(obstacle.quaternion)), Vec(*components(obstacle.position))


def _off(place: Vec, half: list[Array]) -> Vec:
    """How far a place is out of a box, along the box's axes."""
    return Vec(*(x - jnp.clip(x, -h, h) for x, h in zip(place, half, strict=True)))


def _arrays(vector: Vec) -> tuple[Array, ...]:
    return tuple(jnp.asarray(number) for number in vector)
