"""How near an arm's capsules are to each other, to the ground and to others, at a batch of joint vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.forward import components, link_frames
from reachlab.robots.kinematics.scalars import Scalar, once

Numbers = Any
"""An array, in JAX or NumPy."""

TINY = 1e-12
"""What is divided by in place of the square of a smaller length [m²], or of the area that segments span [m⁴]."""


APART = 2
"""Links so many joints apart are the nearest that can meet: those that a joint connects touch by design."""


@dataclass(frozen=True)
class Capsules:
    """Capsules around the links of an arm: constants, known while tracing.

    Attributes:
        links: number of the link that carries each capsule, see `Chain.links_at`; that of the base is 0.
        starts, ends: ends of its axis, in the frame of its link [m].
        radii: its radius [m].
        pairs: numbers of the capsules, two by two, that may not meet.
        floors: height above which each capsule that joints move has to stay [m]; minus infinity for those that are in
            the table at home already, and may be anywhere.
    """

    links: tuple[int, ...]
    starts: tuple[tuple[float, ...], ...]
    ends: tuple[tuple[float, ...], ...]
    radii: tuple[float, ...]
    pairs: tuple[tuple[int, int], ...]
    floors: tuple[float, ...] = ()


class Segments(NamedTuple):
    """Segments from `start [3, ...]` to `end [3, ...]` m; of a ball both are its middle.

    Of `capsules_at` they are three arrays each: picking rows of one array of them all takes twice as long.
    """

    start: Numbers
    end: Numbers


def capsules_at(chain: Chain, capsules: Capsules, q: Numbers) -> Segments:
    """Axes, three `[C, B]` m each, of an arm's capsules in the world at joint vectors `q [B, n]`.

    The batch is last: these arrays are long in it. Compute it once for all questions about a `q`.
    """
    frames = link_frames(chain, components(q))
    rotation, position = zip(*(frames[link] for link in capsules.links), strict=True)
    axes = [[_rows(numbers, q) for numbers in zip(*axis, strict=True)] for axis in zip(*rotation, strict=True)]
    origin = [_rows(numbers, q) for numbers in zip(*position, strict=True)]

    def placed(points: Sequence[Sequence[float]]) -> tuple[Array, ...]:
        x, y, z = np.array(points, np.float32).T[:, :, None]
        return tuple(o + a * x + b * y + c * z for o, a, b, c in zip(origin, *axes, strict=True))

    return once(Segments(placed(capsules.starts), placed(capsules.ends)))


def _rows(numbers: Sequence[Scalar], q: Array) -> Array:
    return jnp.stack([jnp.broadcast_to(jnp.asarray(number, q.dtype), len(q)) for number in numbers])


def self_distance(capsules: Capsules, at: Segments) -> Array:
    """Smallest distance `[B]` m between capsules that may not meet, which lie as `capsules_at` says.

    Negative, it is how deep they overlap.
    """
    return pair_distances(capsules, at, capsules.pairs).min(axis=0)


def pair_distances(capsules: Capsules, at: Segments, pairs: Sequence[tuple[int, int]]) -> Numbers:
    """Distances `[P, B]` m between the two capsules of each pair."""
    one, other = np.array(pairs).T
    radii = np.array(capsules.radii, np.float32)[:, None]
    return segment_distance(_picked(at, one), _picked(at, other)) - radii[one] - radii[other]


def table_distance(capsules: Capsules, at: Segments) -> Array:
    """Smallest distance `[B]` m of an arm's moving capsules from the table, see `Capsules.floors`."""
    start, end, own = moving(capsules, at)
    return (jnp.minimum(start[2], end[2]) - own - np.array(capsules.floors, np.float32)[:, None]).min(axis=0)


def free_of_contact(chain: Chain, capsules: Capsules, q: Array) -> Array:
    """Whether an arm at joints `q [B, n]` is above the table, and its links do not meet `[B]`, by its capsules."""
    if not any(capsules.links):
        return jnp.ones(len(q), bool)
    return free_at(capsules, capsules_at(chain, capsules, q))


def free_at(capsules: Capsules, at: Segments) -> Array:
    """The same of an arm with moving capsules, which lie as `capsules_at` says."""
    above = table_distance(capsules, at) > 0
    return above & (self_distance(capsules, at) > 0) if capsules.pairs else above


def moving(capsules: Capsules, at: Segments) -> tuple[tuple[Array, ...], tuple[Array, ...], np.ndarray]:
    """Ends of the axes of the capsules that joints move, three `[C, B]` m each, and their radii `[C, 1]` m."""
    rows = np.flatnonzero(capsules.links)
    return *_picked(at, rows), np.array(capsules.radii, np.float32)[rows, None]


def _picked(segments: Segments, rows: Any) -> Segments:
    return Segments(*(tuple(x[rows] for x in side) for side in segments))


def segment_distance(one: Segments, other: Segments) -> Numbers:
    """Distance [m] between segments, whose shapes are broadcast against each other.

    Ericson, "Real-Time Collision Detection" (2005), section 5.1.9: the nearest points of the two lines, moved into the
    segments.
    """
    along, across, between = _minus(one.end, one.start), _minus(other.end, other.start), _minus(one.start, other.start)
    a, e, b = _dot(along, along), _dot(across, across), _dot(along, across)
    c, f = _dot(along, between), _dot(across, between)
    s = ((b * f - c * e) / (a * e - b * b).clip(TINY)).clip(0.0, 1.0)
    t = ((b * s + f) / e.clip(TINY)).clip(0.0, 1.0)
    s = ((b * t - c) / a.clip(TINY)).clip(0.0, 1.0)
    apart = [x + s * u - t * v for x, u, v in zip(between, along, across, strict=True)]
    return _dot(apart, apart) ** 0.5


def _minus(a: Numbers, b: Numbers) -> list[Numbers]:
    return [x - y for x, y in zip(a, b, strict=True)]


def _dot(a: Numbers, b: Numbers) -> Numbers:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
