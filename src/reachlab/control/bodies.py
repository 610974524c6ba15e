"""Bodies beside an arm: balls, capsules and boxes, all of them boxes that are swept by a ball; how near they are."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.planning.collision import FAR
from reachlab.robots.kinematics.forward import components
from reachlab.robots.kinematics.scalars import Rotation, Vec, rotation_from_quaternion
from reachlab.robots.shapes.clearance import Capsules, Segments, moving


class Shape(IntEnum):
    """Kinds of bodies, by MuJoCo's numbers (`mjtGeom`)."""

    BALL = 2
    CAPSULE = 3
    CYLINDER = 5
    BOX = 6


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Bodies:
    """Room for `K` bodies beside each arm; none where `K` is 0.

    Attributes:
        position: middle `[..., K, 3]` [m]; `FAR` of one that is not there.
        quaternion: orientation `[..., K, 4]`, wxyz.
        velocity: linear and angular `[..., K, 6]` [m/s, rad/s].
        size: `[..., K, 3]` [m]: of a ball its radius, of a capsule its radius and half its length along z, of a box and
            of a cylinder along z the half sides of the box around it; other numbers are 0.
        kind: `[..., K]`, numbers of `Shape`.
    """

    position: Array
    quaternion: Array
    velocity: Array
    size: Array
    kind: Array

    @property
    def present(self) -> Array:
        """Which of them are there `[..., K]`."""
        return self.position[..., 2] > FAR[2] / 2

    @property
    def half(self) -> Array:
        """Half sides `[..., K, 3]` m of the box that is swept by a ball: of a capsule its length alone."""
        kind, rest = self.kind[..., None], jnp.zeros_like(self.size[..., :1])
        along = jnp.concatenate([rest, rest, self.size[..., 1:2]], axis=-1)
        return jnp.where(kind >= Shape.CYLINDER, self.size, jnp.where(kind == Shape.CAPSULE, along, 0.0))

    @property
    def radius(self) -> Array:
        """Radius of that ball `[..., K]` [m]; 0 of a box and of a cylinder, which have sharp edges."""
        return jnp.where(self.kind >= Shape.CYLINDER, 0.0, self.size[..., 0])

    @property
    def mujoco_size(self) -> Array:
        """MuJoCo's `geom_size` `[..., K, 3]` m: as `size`, but of a cylinder its radius and half its length."""
        cylinder = (self.kind == Shape.CYLINDER)[..., None]
        return jnp.where(cylinder, jnp.roll(self.size, -1, axis=-1), self.size)

    @property
    def extent(self) -> Array:
        """Half sides `[..., K, 3]` m of the box around it."""
        return self.half + self.radius[..., None]

    @property
    def round(self) -> Array:
        """Whether it looks the same from all sides `[..., K]`."""
        return self.kind != Shape.BOX


def absent(*batch: int, radius: float = 0.0) -> Bodies:
    """Room `[..., K]` for bodies of which none is there, balls of a radius [m]."""
    return Bodies(
        position=jnp.broadcast_to(jnp.array(FAR), (*batch, 3)),
        quaternion=jnp.broadcast_to(jnp.array([1.0, 0.0, 0.0, 0.0]), (*batch, 4)),
        velocity=jnp.zeros((*batch, 6)),
        size=jnp.broadcast_to(jnp.array([radius, 0.0, 0.0]), (*batch, 3)),
        kind=jnp.full(batch, Shape.BALL, jnp.int32),
    )


def joined(one: Bodies, other: Bodies) -> Bodies:
    """Bodies `[K + L]` of `[K]` and `[L]`."""
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), one, other)


def turned(quaternion: Array, angle: Array) -> Array:
    """Orientations `[..., 4]`, wxyz, turned about the vertical by `angle [...]` rad."""
    w, x, y, z = components(quaternion)
    cos, sin = jnp.cos(angle / 2), jnp.sin(angle / 2)
    return jnp.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], axis=-1)


class Nearest(NamedTuple):
    """What of the bodies and the table is nearest to each of `C` moving capsules of an arm.

    Attributes:
        distance: from the capsule to it `[C, B]` [m]; where they overlap at most minus the radii.
        normal: unit vector away from it, three `[C, B]`; zero deep inside.
        point: of the capsule's axis that is nearest to it, three `[C, B]` [m].
    """

    distance: Array
    normal: tuple[Array, ...]
    point: tuple[Array, ...]


BISECTIONS = 8
"""Halvings of a capsule's axis until the point nearest to a body is found: to a few tenths of a millimetre."""

TINY = 1e-9
"""Added to a length that divides [m]."""


def nearest(capsules: Capsules, at: Segments, bodies: Bodies) -> Nearest:
    """What is nearest to each of an arm's moving capsules, which lie as `clearance.capsules_at` says.

    Args:
        capsules: of the arm.
        at: how they lie.
        bodies: of each environment `[B, K]`.
    """
    start, end, radius = moving(capsules, at)
    lower = start[2] < end[2]
    point = tuple(jnp.where(lower, a, b) for a, b in zip(start, end, strict=True))
    zero = jnp.zeros_like(point[2])
    found = Nearest(point[2] - np.array(capsules.floors, np.float32)[:, None], (zero, zero, zero + 1.0), point)
    if bodies.kind.shape[-1]:
        # Bodies in front, the capsules next and the batch last.
        each = jax.tree.map(lambda x: jnp.moveaxis(x, 1, 0)[:, None], bodies)
        others = beside(start, end, each)
        chosen = others.distance.argmin(axis=0)[None]
        other = jax.tree.map(
            lambda x: jnp.take_along_axis(jnp.broadcast_to(x, others.distance.shape), chosen, 0)[0], others
        )
        nearer = other.distance < found.distance
        found = jax.tree.map(lambda a, b: jnp.where(nearer, a, b), other, found)
    return found._replace(distance=found.distance - radius)


def beside(start: tuple[Array, ...], end: tuple[Array, ...], body: Bodies) -> Nearest:
    """From bodies to segments, whose shapes are broadcast against each other.

    The distance to a convex body is a convex function along a segment: where it no longer falls is found by bisection.
    """
    rotation, middle = _frame(body)
    back, half = rotation.transpose(), components(body.half)
    a, b = back.apply(Vec(*start).minus(middle)), back.apply(Vec(*end).minus(middle))
    along = b.minus(a)

    def halve(_: int, limits: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = limits
        share = (low + high) / 2
        falls = _off(a.plus(along.times(share)), half).dot(along) < 0
        return jnp.where(falls, share, low), jnp.where(falls, high, share)

    shape = jnp.broadcast_shapes(start[0].shape, body.radius.shape)
    low, high = jax.lax.fori_loop(0, BISECTIONS, halve, (jnp.zeros(shape), jnp.ones(shape)))
    place = a.plus(along.times((low + high) / 2))
    way = _off(place, half)
    length = way.norm()
    normal, point = rotation.apply(way.times(1 / (length + TINY))), rotation.apply(place).plus(middle)
    return Nearest(length - body.radius, _arrays(normal), _arrays(point))


def distance_from(bodies: Bodies, points: np.ndarray) -> Array:
    """Distance `[B, P]` m from each of `points [P, 3]` to the nearest of bodies `[B, K]`; 0 in a box."""
    each = jax.tree.map(lambda x: x[:, :, None], bodies)
    rotation, middle = _frame(each)
    place = rotation.transpose().apply(Vec(*jnp.asarray(points.T)).minus(middle))
    return (_off(place, components(each.half)).norm() - each.radius).min(axis=1)


def _frame(body: Bodies) -> tuple[Rotation, Vec]:
    return rotation_from_quaternion(*components(body.quaternion)), Vec(*components(body.position))


def _off(place: Vec, half: list[Array]) -> Vec:
    """How far a place is out of a box, along the box's axes."""
    return Vec(*(x - jnp.clip(x, -h, h) for x, h in zip(place, half, strict=True)))


def _arrays(vector: Vec) -> tuple[Array, ...]:
    return tuple(jnp.asarray(number) for number in vector)
