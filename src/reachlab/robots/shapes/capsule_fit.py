"""Capsules that contain triangles, as tightly as a few capsules can."""

from __future__ import annotations

import functools
import itertools
from typing import NamedTuple

import numpy as np

from reachlab.robots.kinematics.chain import significant

MOST, WORTH = 3, 0.85
"""Most capsules of one link, and the share to which each further one has to bring their volume: it costs as many
distances as there are capsules beside it."""

SLABS = 10
"""A shape may be cut at the borders of so many slabs of equal thickness."""

SAMPLES = 400
"""Random points of a shape by which the place of its cut is chosen."""

DIRECTIONS, MANY = 120, 20_000
"""The points that are outermost in so many directions, of about so many points at most, stand for a shape while the
line of its capsule is chosen. Its ends and radius then contain all points."""

SCALES = (1.0, 1.03, 1.08, 1.15, 1.25, 1.5)
"""Radii that are tried about a line, in those of the thinnest cylinder: a thicker capsule may be so much shorter."""

STEPS = 160
"""Most evaluations of a fit."""

FINE = 9
"""Decimals [m], and significant digits of volumes, to which numbers are rounded before they decide anything: the last
bits depend on the CPU's kernels, and a search that compares them ends elsewhere on another CPU."""

TINY = 1e-18
"""An area that no triangle is smaller than [m²]: one without any is never divided by."""

DECIMALS = 6
"""Decimals of ends and radii [m]."""

ROUNDING = 2e-6
"""What a radius is larger by so that the capsule contains its points after rounding [m]: more than (sqrt(3) + 1) / 2
times the last decimal."""

SHORT = 1e-4
"""A capsule whose ends are nearer to each other is made a ball [m]."""


class Fitted(NamedTuple):
    """A capsule: its ends `[3]` m, its radius [m], and its volume [m³]."""

    start: np.ndarray
    end: np.ndarray
    radius: float
    volume: float


def fit_capsules(triangles: np.ndarray) -> list[Fitted]:
    """One to `MOST` capsules, each of which contains a part of `triangles [F, 3, 3]` m, and together all of them."""
    found, triangles = [], np.round(triangles, FINE)
    for normal, heights in _cuts(_sampled(triangles)):
        parts, rest = [], triangles
        for height in heights:
            below, rest = cut(rest, normal, height)
            parts.append(below)
        capsules = [_fit(part) for part in (*parts, rest) if len(part)]
        found.append((sum(capsule.volume for capsule in capsules) / WORTH ** len(capsules), capsules))
    return min(found, key=lambda one: one[0])[1]


def _cuts(points: np.ndarray) -> list[tuple[np.ndarray, list[float]]]:
    """Parallel planes that cut points `[m, 3]` into one, two, ... parts, so that these lie in small capsules.

    They are `normal · x = height`, from the lowest to the highest.
    """
    best = [(np.inf, (np.zeros(3), list[float]()))] * MOST
    for normal in _axes(points):
        along = points @ normal
        borders = np.linspace(along.min(), along.max(), SLABS + 1)
        volumes = {}
        for low, high in itertools.combinations(range(SLABS + 1), 2):
            inside = points[(along >= borders[low]) & (along <= borders[high])]
            volumes[low, high] = _coarse(inside)[0] if len(inside) else 0.0
        for cuts in range(MOST):
            for inner in itertools.combinations(range(1, SLABS), cuts):
                volume = sum(volumes[pair] for pair in itertools.pairwise((0, *inner, SLABS)))
                if volume < best[cuts][0]:
                    best[cuts] = volume, (normal, [float(borders[i]) for i in inner])
    return [planes for _, planes in best]


def _sampled(triangles: np.ndarray) -> np.ndarray:
    """Random points of triangles, evenly spread."""
    random = np.random.default_rng(0)
    a, b, c = triangles.swapaxes(0, 1)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) + TINY
    chosen = triangles[random.choice(len(triangles), SAMPLES, p=areas / areas.sum())]
    return np.einsum("si,sij->sj", random.dirichlet(np.ones(3), SAMPLES), chosen)


def cut(triangles: np.ndarray, normal: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles `[.., 3, 3]` below and above the plane `normal · x = height`; those that cross it are cut in three."""
    heights = np.round(triangles @ normal - height, FINE)
    above, below = (heights >= 0).all(axis=1), (heights < 0).all(axis=1)
    crossing = ~(above | below)
    heights, corners = heights[crossing], triangles[crossing]
    up = heights >= 0
    tip_up = up.sum(axis=1) == 1
    tip = np.where(tip_up, up.argmax(axis=1), up.argmin(axis=1))  # the corner that is alone on its side
    order = (tip[:, None] + np.arange(3)) % 3
    heights, corners = np.take_along_axis(heights, order, 1), np.take_along_axis(corners, order[:, :, None], 1)
    a, b, c = corners.swapaxes(0, 1)
    ab, ac = (
        a + (heights[:, :1] / (heights[:, :1] - heights[:, [i]])) * (corner - a) for i, corner in ((1, b), (2, c))
    )
    tips = np.stack([a, ab, ac], axis=1)
    rest = np.concatenate([np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)])
    twice = np.tile(tip_up, 2)
    return (
        np.concatenate([triangles[below], tips[~tip_up], rest[twice]]),
        np.concatenate([triangles[above], tips[tip_up], rest[~twice]]),
    )


def _fit(triangles: np.ndarray) -> Fitted:
    """The smallest capsule that contains all corners, and so the triangles too."""
    from scipy.optimize import minimize  # half a second, which who finds the capsules in the cache need not wait

    points = triangles.reshape(-1, 3)
    some = points[:: 1 + len(points) // MANY]
    some = some[np.unique(np.round(_directions() @ some.T, FINE).argmax(axis=1))]
    _, axis = _coarse(some)
    aside = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across = np.array([aside, np.cross(axis, aside)]) / np.linalg.norm(aside)
    middle, size = _middle(some), float(np.ptp(some, axis=0).max())

    def line(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A point of a line and its direction, tilted from the axis by `x[:2]` rad and moved by `x[2:]` sizes."""
        tilted = axis + x[:2] @ across
        return middle + size * (x[2:] @ across), tilted / np.linalg.norm(tilted)

    start = np.vstack([np.zeros(4), 0.1 * np.eye(4)])
    options = {"initial_simplex": start, "maxfev": STEPS, "xatol": 1e-3, "fatol": 1e-9}
    best = minimize(
        lambda x: significant(_about(some, *line(x))[0].min(), FINE), start[0], method="Nelder-Mead", options=options
    )
    point, axis = line(best.x)
    capsules = _about(points, point, axis)
    volume, low, high, radius = (float(values[capsules[0].argmin()]) for values in capsules)
    if high - low < SHORT:
        radius += (high - low) / 2
        low = high = (low + high) / 2
    start, end = (np.round(point + along * axis, DECIMALS) for along in (low, high))
    return Fitted(start, end, round(radius + ROUNDING, DECIMALS), significant(volume, FINE))


def _about(points: np.ndarray, point: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, ...]:
    """Volume, ends along the line and radius of capsules that contain all points, `[..., SCALES]` each.

    A capsule of radius r contains a point at distance d from its line if its segment comes within sqrt(r² - d²) of the
    point's foot. The lines go through a point `[3]`, in directions `[..., 3]`.
    """
    along = axes @ (points - point).T
    off = np.maximum(np.square(points - point).sum(axis=1) - along**2, 0.0)
    radii = np.sqrt(off.max(axis=-1))[..., None] * SCALES
    slack = np.sqrt(np.maximum(np.square(radii)[..., None] - off[..., None, :], 0.0))
    low, high = (along[..., None, :] + slack).min(axis=-1), (along[..., None, :] - slack).max(axis=-1)
    low, high = np.minimum(low, (low + high) / 2), np.maximum(high, (low + high) / 2)  # a ball, where they cross
    return capsule_volume(high - low, radii), low, high, radii


def capsule_volume(length: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Volume [m³] of capsules whose ends are `length` apart [m]."""
    return np.pi * radius**2 * (length + 4 / 3 * radius)


def _coarse(points: np.ndarray) -> tuple[float, np.ndarray]:
    """Volume and axis of the smallest capsule about a line through the middle, along one of `_axes`."""
    axes = _axes(points)
    volumes = [significant(volume, FINE) for volume in _about(points, _middle(points), axes)[0].min(axis=-1)]
    return min(volumes), axes[np.argmin(volumes)]


def _axes(points: np.ndarray) -> np.ndarray:
    """Directions `[6, 3]` in which links are long or are cut: their principal axes, and those of their frame."""
    away = points - points.mean(axis=0)
    gram = away.T @ away
    principal = np.linalg.eigh(np.round(gram / max(gram.max(), TINY), DECIMALS))[1].T
    return np.concatenate([np.round(principal, FINE), np.eye(3)])


def _middle(points: np.ndarray) -> np.ndarray:
    return (points.min(axis=0) + points.max(axis=0)) / 2


@functools.cache
def _directions() -> np.ndarray:
    """Unit vectors `[DIRECTIONS, 3]`, evenly spread (a Fibonacci lattice)."""
    number = np.arange(DIRECTIONS)
    height = 1 - (2 * number + 1) / DIRECTIONS
    turn, across = number * np.pi * (3 - np.sqrt(5)), np.sqrt(1 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
