"""How near an arm's capsules are to each other, to the ground and to obstacles, at a batch of joint vectors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.chain import Chain
from reachlab.robots.kinematics import components, link_frames
from reachlab.robots.scalar_algebra import Vec, once

if TYPE_CHECKING:
    from reachlab.robots.capsules import Capsules

Numbers = Any
"""An array, in JAX or NumPy."""

TINY = 1e-12
"""What is divided by in place of the square of a smaller length [m²], or of the area that segments span [m⁴]."""


class Segments(NamedTuple):
    """Segments from `start [3, ...]` to `end [3, ...]` m; of a ball both are its middle."""

    start: Numbers
    end: Numbers


def capsules_at(chain: Chain, capsules: Capsules, q: Numbers) -> Segments:
    """Axes `[3, C, B]` of an arm's capsules in the world at joint vectors `q [B, n]`.

    The batch is last: these arrays are long in it. Compute it once for all questions about a `q`.
    """
    frames = link_frames(chain, components(q))
    sides = []
    for points in (capsules.starts, capsules.ends):
        placed = []
        for link, point in zip(capsules.links, points, strict=True):
            rotation, position = frames[link]
            placed.append(position.plus(rotation.apply(Vec(*point))))
        rows = [jnp.broadcast_to(jnp.asarray(vec[axis], q.dtype), len(q)) for axis in range(3) for vec in placed]
        sides.append(jnp.stack(rows).reshape(3, len(placed), len(q)))
    return once(Segments(*sides))


def self_distance(capsules: Capsules, at: Segments) -> Array:
    """Smallest distance `[B]` m between capsules that may not meet, which lie as `capsules_at` says.

    Negative, it is how deep they overlap.
    """
    return pair_distances(capsules, at, capsules.pairs).min(axis=0)


def pair_distances(capsules: Capsules, at: Segments, pairs: Sequence[tuple[int, int]]) -> Numbers:
    """Distances `[P, B]` m between the two capsules of each pair."""
    one, other = np.array(pairs).T
    radii = np.array(capsules.radii, np.float32)[:, None]
    between = segment_distance(*(Segments(at.start[:, side], at.end[:, side]) for side in (one, other)))
    return between - radii[one] - radii[other]


def obstacle_distances(capsules: Capsules, at: Segments, obstacles: Segments, radii: Numbers) -> Array:
    """Smallest distances `[O, B]` m of an arm's moving capsules from obstacles, which are capsules or balls.

    Args:
        capsules: the arm's.
        at: how they lie.
        obstacles: axes `[3, O, 1]`, or `[3, O, B]` where they differ.
        radii: `[O, 1]` or `[O, B]` [m].
    """
    arm, own = _moving(capsules, at)
    every = Segments(arm.start[:, None], arm.end[:, None])
    beside = segment_distance(every, Segments(obstacles.start[:, :, None], obstacles.end[:, :, None]))
    return (beside - own).min(axis=1) - radii


def lowest_point(capsules: Capsules, at: Segments) -> Array:
    """Height `[B]` m of the lowest point of an arm's moving capsules."""
    arm, own = _moving(capsules, at)
    return (jnp.minimum(arm.start[2], arm.end[2]) - own).min(axis=0)


def _moving(capsules: Capsules, at: Segments) -> tuple[Segments, np.ndarray]:
    """Axes of the capsules that joints move, and their radii `[C, 1]` m."""
    moving = np.flatnonzero(capsules.links)
    return Segments(at.start[:, moving], at.end[:, moving]), np.array(capsules.radii, np.float32)[moving, None]


def segment_distance(one: Segments, other: Segments) -> Numbers:
    """Distance [m] between segments, whose shapes are broadcast against each other.

    Ericson, "Real-Time Collision Detection" (2005), section 5.1.9: the nearest points of the two lines, moved into the
    segments.
    """
    along, across, between = one.end - one.start, other.end - other.start, one.start - other.start
    a, e, b = _dot(along, along), _dot(across, across), _dot(along, across)
    c, f = _dot(along, between), _dot(across, between)
    s = ((b * f - c * e) / (a * e - b * b).clip(TINY)).clip(0.0, 1.0)
    t = ((b * s + f) / e.clip(TINY)).clip(0.0, 1.0)
    s = ((b * t - c) / a.clip(TINY)).clip(0.0, 1.0)
    apart = between + s * along - t * across
    return _dot(apart, apart) ** 0.5


def _dot(a: Numbers, b: Numbers) -> Numbers:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
