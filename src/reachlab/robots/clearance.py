"""How near an arm's capsules are to each other, to a plane and to obstacles, at a batch of joint vectors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.chain import Chain
from reachlab.robots.kinematics import components, link_frames
from reachlab.robots.scalar_algebra import Vec, once

if TYPE_CHECKING:
    from reachlab.robots.capsules import Capsules

TINY = 1e-12
"""What is divided by in place of the square of a smaller length [m²], or of the area that segments span [m⁴]."""


class Segments(NamedTuple):
    """Segments from one point to another; coordinates are arrays of any shape, in JAX or NumPy [m]."""

    start: Vec
    end: Vec


def capsules_at(chain: Chain, capsules: Capsules, q: Array) -> Segments:
    """Axes of an arm's capsules in the world at joint vectors `q [B, n]`, coordinates `[C, B]` m.

    The batch is last: these arrays are long in it.
    """
    frames = link_frames(chain, components(q))
    sides = []
    for points in (capsules.starts, capsules.ends):
        placed = []
        for link, point in zip(capsules.links, points, strict=True):
            rotation, position = frames[link]
            placed.append(position.plus(rotation.apply(Vec(*point))))
        columns = zip(*placed, strict=True)
        sides.append(Vec(*(jnp.stack([jnp.broadcast_to(jnp.asarray(c, q.dtype), len(q)) for c in column]) for column in columns)))
    return once(Segments(*sides))


def self_distance(capsules: Capsules, at: Segments) -> Array:
    """Smallest distance `[B]` m between capsules that may not meet, which lie as `capsules_at` says.

    Negative, it is how deep they overlap. It is infinite where there are no two of them.
    """
    distances = pair_distances(capsules, at, capsules.pairs)
    return distances.min(axis=0, initial=np.inf)


def pair_distances(capsules: Capsules, at: Segments, pairs: Sequence[tuple[int, int]]) -> Array:
    """Distances `[P, B]` m between capsules of a `pairs` each."""
    numbers = np.array(pairs, int).reshape(-1, 2).T
    first, second = (Segments(*(Vec(*(x[side] for x in end)) for end in at)) for side in numbers)
    radii = np.array(capsules.radii, np.float32)[numbers].sum(axis=0)
    return segment_distance(first, second) - radii[:, None]


def obstacle_distances(capsules: Capsules, at: Segments, obstacles: Segments, radii: Array) -> Array:
    """Smallest distances `[O, B]` m of an arm's moving capsules from obstacles, which are capsules or balls.

    Their axes have coordinates `[O, 1]`, or `[O, B]` where they differ; of a ball both ends are its middle. Their `radii`
    `[O, 1]` or `[O, B]` are in metres.
    """
    arm, own = _moving(capsules, at)
    there = Segments(*(Vec(*(x[:, None] for x in end)) for end in obstacles))
    return (segment_distance(arm, there) - own - radii[:, None]).min(axis=1)


def lowest_point(capsules: Capsules, at: Segments) -> Array:
    """Height `[B]` m of the lowest point of an arm's moving capsules."""
    arm, own = _moving(capsules, at)
    return (jnp.minimum(arm.start.z, arm.end.z) - own).min(axis=0)


def _moving(capsules: Capsules, at: Segments) -> tuple[Segments, np.ndarray]:
    """Axes of the capsules that joints move, and their radii `[C, 1]` m."""
    moving = np.array(capsules.links) > 0
    radii = np.array(capsules.radii, np.float32)[moving, None]
    return Segments(*(Vec(*(x[moving] for x in end)) for end in at)), radii


def segment_distance(first: Segments, second: Segments) -> Array:
    """Distance [m] between segments, or points, whose coordinates are broadcast against each other.

    Ericson, "Real-Time Collision Detection" (2005), section 5.1.9: the nearest points of the two lines, moved into the
    segments.
    """
    along, across, between = first.end.minus(first.start), second.end.minus(second.start), first.start.minus(second.start)
    a, e, b = along.dot(along), across.dot(across), along.dot(across)
    c, f = along.dot(between), across.dot(between)
    s = ((b * f - c * e) / (a * e - b * b).clip(TINY)).clip(0.0, 1.0)
    t = ((b * s + f) / e.clip(TINY)).clip(0.0, 1.0)
    s = ((b * t - c) / a.clip(TINY)).clip(0.0, 1.0)
    apart = between.plus(along.times(s)).minus(across.times(t))
    return apart.dot(apart) ** 0.5
