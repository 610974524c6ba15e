"""How well a moving goal was followed."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from reachlab.evaluation.episodes import Track
from reachlab.evaluation.intervals import quantiles

BANDS = 4
"""Bands of speed, equally wide, that errors are told of."""

BREAK, SHARP = 0.05, 0.5
"""A velocity that changes by so much in a step [m/s], and by that share of the speeds before and after it, which is a
corner of more than 60 degrees, has changed suddenly; on smooth paths it changes by less."""

JUMP = 0.001
"""A goal that is so far from where its velocity took it has jumped [m]."""

AGAIN = (10, 5)
"""Errors to which it is told how soon the tool came back after that [mm]."""


def followed(track: Track, period: float, settle: int, fastest: float) -> dict[str, Any]:
    """Figures of tracks, of the steps after the first `settle` ones.

    - `rms_mm`, `median_mm`, `p95_mm`: of the distance of tool and goal, and `by_speed` of those at each speed [m/s]
    - `lag_s`: by how much the tool is late, the least-squares fit of its way behind the goal to the goal's velocity [s]
    - `breaks`: how often the goal's velocity changed or its place jumped suddenly, and `again_within`: for distances
      [mm] the median and p99 of the time until the tool was within them up to the next time [s]; None where it was not
    """
    error = (track.goal - track.tool).astype(np.float64)
    distance, speed = np.linalg.norm(error, axis=-1), np.linalg.norm(track.velocity, axis=-1)
    counted, edges = slice(settle, None), np.linspace(0.0, fastest, BANDS + 1)
    late, moved = distance[:, counted], speed[:, counted]
    band = np.clip(np.digitize(moved, edges) - 1, 0, BANDS - 1)
    names = [f"{low:.3g} to {high:.3g}" for low, high in itertools.pairwise(edges)]
    names[-1] = f"{edges[-2]:.3g} and more"
    return {
        **_errors(late),
        "by_speed": {name: _errors(late[band == i]) for i, name in enumerate(names) if (band == i).any()},
        "lag_s": _lag(error[:, counted], track.velocity[:, counted]),
        **_recovery(track, distance, period, settle),
    }


def _errors(distance: np.ndarray) -> dict[str, float]:
    mm = 1000 * distance
    rms, (median, p95) = float(np.sqrt(np.square(mm).mean())), np.quantile(mm, (0.5, 0.95))
    return {"rms_mm": rms, "median_mm": float(median), "p95_mm": float(p95)}


def _lag(error: np.ndarray, velocity: np.ndarray) -> float | None:
    squared = float(np.square(velocity).sum())
    return float((error * velocity).sum()) / squared if squared else None


def _recovery(track: Track, distance: np.ndarray, period: float, settle: int) -> dict[str, Any]:
    moved = np.diff(track.goal, axis=1) - period * (track.velocity[:, 1:] + track.velocity[:, :-1]) / 2
    changed, speed = np.linalg.norm(np.diff(track.velocity, axis=1), axis=-1), np.linalg.norm(track.velocity, axis=-1)
    turned = changed > np.maximum(BREAK, SHARP * (speed[:, 1:] + speed[:, :-1]))
    sudden = turned | (np.linalg.norm(moved, axis=-1) > JUMP + BREAK * period)
    taken: dict[int, list[float]] = {limit: [] for limit in AGAIN}
    for episode, breaks in enumerate(sudden):
        at = np.flatnonzero(breaks) + 1
        # The last break of an episode is left out: nobody knows how long the tool would have taken.
        for begin, end in itertools.pairwise(at):
            if begin < settle:
                continue
            for limit in AGAIN:
                outside = np.flatnonzero(distance[episode, begin:end] > limit / 1000)
                steps = outside[-1] + 1 if len(outside) else 0
                taken[limit].append(period * steps if steps < end - begin else np.inf)
    return {
        "breaks": len(taken[AGAIN[0]]),
        "again_within": {
            str(limit): quantiles(times, {"median": 0.5, "p99": 0.99}) for limit, times in taken.items() if times
        },
    }
