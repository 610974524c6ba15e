"""Where an arm's episodes may start: joint vectors with the tool pointing down in front of the base."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.transforms import motions

SAMPLES = 8192
"""Random joint vectors from which homes are found."""

WIDEST = np.pi
"""Joints that turn further are sampled within this of the middle of their limits [rad]."""

TURNS = 25
"""Steps in which the tool is turned until it points as it should."""

DAMPING, LONGEST_STEP, TURNED = 1e-4, 0.5, 1e-2
"""Damping of these steps, their largest joint displacement [rad], and the angle within which they are done [rad]."""

TINY = 1e-6
"""A vector shorter than this has no direction."""

REACH = 0.98
"""The arm's reach is exceeded by the rest of the sampled points."""

PLACE, SPREAD = (0.5, 0.0, 0.3), 0.3
"""Where the tool is best at home, in front of the base and above it, and how far from there it is half as good: in
shares of the reach."""

BELOW = (0.5, 0.0, 0.6)
"""The same of an arm that hangs, whose hand points away from its base there; of 0.3 to 0.75 below it, those from 0.5 on
gave four arms the largest boxes."""

NEAREST, LOWEST, ASIDE = 0.2, 0.05, 0.5
"""Where it has to be: so far in front of the base and above it, and aside by no more than this share of the way."""

LEAST = 1e-2
"""Where a joint speed of 1 rad/s moves the tool slower than this in some direction, it is singular [reach/s]."""

COMFORTABLE = 0.3
"""Share of half a joint's range from its limit that is far enough."""

BENT = 0.5
"""Joints this far from the middle of their limits, in root mean square, make a home half as good [share of pi]."""

HANGING = 0.05
"""Joints may be so far below the second one, which is the shoulder of most arms [share of the reach]."""

DOWNWARD = 0.2
"""An arm whose tool is below its base by more than this share of the reach, in the median of the sampled joint vectors,
hangs from a ceiling: what is said of above the base holds below it. Of arms that stand or are on a wall it is -0.05 to
0.55, and of these upside down -0.3 to -0.45."""

APART = 0.6
"""Homes that are tried differ in a joint by at least this [rad or m]."""

TRIED = 64
"""Best joint vectors that are looked at for it."""


def rounded(chain: Chain, q: np.ndarray) -> np.ndarray:
    """Joint vector `[n]` to thousandths [rad or m]: single precision finds it, whose last digits depend on the CPU."""
    return np.clip(np.round(q, 3) + 0.0, chain.lower, chain.upper)


class Candidates:
    """Joint vectors at which the tool points down, or tilted outward, of which one will be home.

    Attributes:
        reach: how far from its base the tool comes [m].
        up: 1 of an arm that stands, -1 of one that hangs.
    """

    def __init__(self, chain: Chain, base: np.ndarray, tilts: Sequence[float]) -> None:
        """Candidates of an arm that stands at `base [3]` m, with the tool tilted by one of some angles [rad]."""
        self._base = base
        lower, upper = np.array(chain.lower), np.array(chain.upper)
        middle = (lower + upper) / 2
        lower, upper = np.maximum(lower, middle - WIDEST), np.minimum(upper, middle + WIDEST)
        sampled = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, chain.n))
        away = _posture(chain, sampled)[1] - base
        self.reach = max(float(np.quantile(np.linalg.norm(away, axis=1), REACH)), TINY)
        self.up = -1.0 if np.median(away[:, 2]) < -DOWNWARD * self.reach else 1.0
        self._tilt = np.repeat(tilts, SAMPLES)
        q, off = map(np.concatenate, zip(*(_turned(chain, base, sampled, tilt) for tilt in tilts), strict=True))
        if not (off < TURNED).any():  # an arm that cannot turn its tool so stays off its limits
            q, off = np.tile(sampled, (len(tilts), 1)), np.zeros(len(off))  # and any orientation will do
        links, self._position, _ = _posture(chain, q)
        columns, _ = motions(links[:, 1:], chain.slides, self._position)
        gram = np.swapaxes(columns, 1, 2) @ columns
        heights = self.up * links[:, 1:, 2, 3]
        hangs = heights[:, min(1, chain.n - 1)] - heights[:, min(1, chain.n - 1) :].min(axis=1)
        half = np.maximum((np.array(chain.upper) - np.array(chain.lower)) / 2, TINY)
        to_limit = np.minimum(q - chain.lower, chain.upper - q) / half
        able = np.sqrt(np.linalg.eigvalsh(gram)[:, 0].clip(0)) / self.reach
        bent = np.square((q - middle) / (BENT * np.pi)).mean(axis=1)
        able[able < LEAST] = 0.0
        self._q, self._middle = q, middle
        self._worth = np.clip(to_limit.min(axis=1) / COMFORTABLE, 0.0, 1.0) * able / (1 + bent)
        self._worth[off >= TURNED] = 0.0
        if self._worth[upright := hangs < HANGING * self.reach].any():
            self._worth[~upright] = 0.0

    def best(self, turn: float, tilt: float, free: Callable[[np.ndarray], bool], most: int) -> list[np.ndarray]:
        """The best joint vectors `[n]`, unlike each other, with the front turned by an angle about the vertical."""
        cos, sin = np.cos(turn), np.sin(turn)
        x, y, z = (self._position - self._base).T / self.reach * [[1.0], [1.0], [self.up]]
        x, y = cos * x + sin * y, cos * y - sin * x
        place = PLACE if self.up > 0 else BELOW
        worth = self._worth / (1 + np.square((np.stack([x, y, z], axis=1) - place) / SPREAD).sum(axis=1))
        worth[(self._tilt != tilt) | (x < NEAREST) | (z < LOWEST) | (np.abs(y) > ASIDE * x)] = 0.0
        found: list[np.ndarray] = []
        for index in np.argsort(-worth)[:TRIED]:
            q = self._q[index]
            if len(found) < most and worth[index] and all(np.abs(q - one).max() > APART for one in found) and free(q):
                found.append(q)
        return found

    def any(self) -> np.ndarray:
        """The most comfortable joint vector, or the middle of the limits if all are singular."""
        return self._q[self._worth.argmax()] if self._worth.any() else self._middle


def _posture(chain: Chain, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Links `[B, n + 1, 4, 4]` of an arm at joint vectors `[B, n]`, and its tool's position and axis `[B, 3]`."""
    links = chain.links_at(q)
    tool = links[:, -1] @ chain.between[-1]
    return links, tool[:, :3, 3], tool[:, :3, :3] @ np.array(chain.approach)


def _turned(chain: Chain, base: np.ndarray, q: np.ndarray, tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """Joint vectors `[B, n]` with the tool turned to a tilt, away from the base; and what is left of the turn `[B]`.

    By damped least-squares steps.
    """
    links, position, axis = _posture(chain, q)
    turn = _turn(position - base, axis, tilt)
    hinges = ~np.array(chain.slides)[:, None]
    for _ in range(TURNS):
        columns = hinges * links[:, 1:, :3, 2]
        columns -= (columns @ axis[..., None]) * axis[:, None]
        gram = np.swapaxes(columns, 1, 2) @ columns + DAMPING * np.eye(3)
        step = (columns @ np.linalg.solve(gram, turn[..., None]))[..., 0]
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(np.abs(step).max(axis=1, keepdims=True), TINY))
        q = np.clip(q + step, chain.lower, chain.upper)
        links, position, axis = _posture(chain, q)
        turn = _turn(position - base, axis, tilt)
    return q, np.linalg.norm(turn, axis=1)


def _turn(away: np.ndarray, axis: np.ndarray, tilt: float) -> np.ndarray:
    """Turn `[B, 3]` rad that brings the tool's axis to its tilt, outward where the tool is `away` from the base [m]."""
    out = away[:, :2] / (np.linalg.norm(away[:, :2], axis=1, keepdims=True) + TINY)
    wanted = np.column_stack([np.sin(tilt) * out, np.full(len(out), -np.cos(tilt))])
    across = np.cross(axis, wanted)
    sin = np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.arctan2(sin, (axis * wanted).sum(axis=1, keepdims=True))
    return angle * np.where(sin > TINY, across / np.maximum(sin, TINY), (1.0, 0.0, 0.0))
