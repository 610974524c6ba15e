"""What of an arm follows from its chain where nobody says it: home, how the tool is held, and the boxes it works in."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from reachlab.robots.derive.home import Candidates, rounded
from reachlab.robots.derive.reaching import NODES, PROBES, lead, program
from reachlab.robots.kinematics.chain import Chain, significant
from reachlab.robots.robot import TUTORIAL_WORKSPACE, Box
from reachlab.settings.validation import InputError

SHARE = 0.999
"""A derived box holds at most one point in a thousand that the tool cannot reach."""

NEAREST, WIDEST, HIGHEST, LOWEST_GOAL = 0.15, 0.8, 0.9, 0.08
"""Where the grid begins in front of the base, and ends at its sides and above it; and the height above which points in
the air lie: shares of the arm's reach."""

CLOSE, TURNED = 2e-3, 0.1
"""A point is reached when the tool is this close to it [m], and, where it is held, turned by less than this [rad]."""

TRAVEL = 1.2
"""Points in the air are near enough to home that every joint gets there in this time at its speed limit [s]."""

NOISE = 0.3
"""Starts from which points in the air have to be reached: every joint within this of home [rad or m]."""

SHRINK, SHRINKS = 0.04, 15
"""A box that holds too many points out of reach is made smaller by this share, so many times at most."""

QUARTERS = (0.0, 0.5 * np.pi, -0.5 * np.pi, np.pi)
"""Directions that may be the front, as turns about the vertical from x [rad]; x unless another is far better."""

TILTS = (0.0, np.pi / 6, np.pi / 3)
"""How the tool of an arm with fewer than six joints may be held: angles from straight down, outward [rad]."""

HOMES, HOMES_ASIDE = 6, 2
"""Homes that are tried with the front in x, and in each other direction; fewer where there are several tilts."""

FAR_BETTER = 1.3
"""Another front or tilt, or a home that is not the file's, is taken if its box is so many times as large."""

START = (0.65, 0.5, 0.88)
"""Where in the workspace the tool is at home, in shares of its sides: about where the tutorial's is."""


class Derived(NamedTuple):
    """What was derived: joint vector `[n]`, the tool's orientation there wxyz, two boxes, and how much is reached."""

    home: tuple[float, ...]
    held_quaternion: tuple[float, ...]
    workspace: Box
    goal_box: Box
    shares: Mapping[str, float]


def derive(
    chain: Chain,
    speed: np.ndarray,
    base: np.ndarray,
    home: tuple[float, ...] | None,
    free: Callable[[np.ndarray], bool],
) -> Derived:
    """Home and boxes of an arm.

    The workspace is the largest box of the tutorial's proportions, in front of the base and above it, or below it where
    the arm hangs, that the tool can be displaced to from home on straight ways, held as it is at home. The box of goals
    in the air is the largest that it comes to in any orientation.

    Args:
        chain: the arm.
        speed: its joint speed limits `[n]`.
        base: where it stands [m].
        home: the file's.
        free: whether the arm does not touch itself at a joint vector `[n]`.
    """
    program(chain)  # is compiled meanwhile
    tilts = TILTS[:1] if chain.poses else TILTS
    candidates = Candidates(chain, base, tilts)
    search = _Search(chain, speed, base, candidates.reach, candidates.up)
    tried = [(np.array(home), turn, FAR_BETTER**2) for turn in QUARTERS] if home else []
    for turn, tilt in itertools.product(QUARTERS, tilts):
        favour = FAR_BETTER ** ((turn == 0.0) + (tilt == 0.0))
        most = -(-(HOMES_ASIDE if turn else HOMES) // len(tilts))
        tried += [(q, turn, favour) for q in candidates.best(turn, tilt, free, most)]
    with ThreadPoolExecutor() as pool:
        boxes = pool.map(lambda one: search.about(*one[:2]), tried)
        found = [(favour * box[1], q, turn, box[0]) for (q, turn, favour), box in zip(tried, boxes, strict=True) if box]
    if not found:
        return _around(chain, base, candidates.up, np.array(home) if home else rounded(chain, candidates.any()))
    _, q, turn, box = max(found, key=lambda one: one[0])
    if home is None or not np.array_equal(q, home):
        moved = rounded(chain, search.start(q, box, turn))
        q = moved if free(moved) else rounded(chain, q)
    workspace, share = search.verified(box, functools.partial(search.held, q), chain.tool_at(q)[0])
    anyhow_from_home = functools.partial(search.anyhow, q)
    goals = search.largest(anyhow_from_home, turn, None, LOWEST_GOAL)
    goal_box, goal_share = search.verified(goals[0] if goals else workspace, anyhow_from_home, None)
    there, shares = tuple(q.tolist()), {"workspace": share, "goal_box": goal_share}
    return Derived(there, orientation(chain, there), workspace, goal_box, shares)


def orientation(chain: Chain, home: tuple[float, ...]) -> tuple[float, ...]:
    """Orientation wxyz of the tool at home, to nine decimals."""
    return tuple((np.round(chain.tool_at(home)[1], 9) + 0.0).tolist())


@dataclass
class _Search:
    """Boxes of points that an arm reaches from a home."""

    chain: Chain
    speed: np.ndarray
    base: np.ndarray
    reach: float
    up: float

    def held(self, q: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Which of `points [m, 3]` the tool reaches from home `q`, held as it is there."""
        led = lead(self.chain, q, points, self.chain.tool_at(q)[1])
        return (led.off < CLOSE) & (led.turned < TURNED)

    def start(self, q: np.ndarray, box: Box, turn: float) -> np.ndarray:
        """Home `[n]` from which the tool starts in its place in the box."""
        low, high = np.sort((np.array(box) - self.base) @ _about_z(turn), axis=0)
        point = self.base + (low + np.array(START) * (high - low)) @ _about_z(turn).T
        return lead(self.chain, q, point[None], self.chain.tool_at(q)[1]).q[0]

    def anyhow(self, q: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Which of them it reaches from starts about home in any orientation, and in time."""
        noise = self.chain.noise(NOISE) * np.random.default_rng(0).uniform(-1.0, 1.0, (len(points), self.chain.n))
        led = lead(self.chain, np.clip(q + noise, self.chain.lower, self.chain.upper), points, None)
        return (led.off < CLOSE) & (np.abs(led.q - q) <= TRAVEL * self.speed).all(axis=1)

    def about(self, q: np.ndarray, turn: float) -> tuple[Box, float] | None:
        """The largest box about home `q`, in which the tool is held as it is there, and its size."""
        return self.largest(functools.partial(self.held, q), turn, self.chain.tool_at(q)[0], 0.0)

    def largest(
        self, reached: Callable[[np.ndarray], np.ndarray], turn: float, holds: np.ndarray | None, lowest: float
    ) -> tuple[Box, float] | None:
        """Largest box of points that are reached, in shares of the reach no lower than `lowest`, and its size.

        One that `holds` a point has the tutorial's proportions, see `largest_box`.
        """
        x, y, z = (
            np.linspace(NEAREST, 1.0, NODES[0]) * self.reach,
            np.linspace(-WIDEST, WIDEST, 2 * NODES[1] - 1) * self.reach,
            np.sort(self.up * np.linspace(0.0, HIGHEST, NODES[2])) * self.reach,
        )
        grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
        inside = reached(grid.reshape(-1, 3) @ _about_z(turn).T + self.base).reshape(grid.shape[:3]).copy()
        inside[:, :, self.up * z < lowest * self.reach] = False
        half = NODES[1] - 1
        both = inside[:, half:] & inside[:, half::-1]  # [x, |y|, z]
        home = None if holds is None else (holds - self.base) @ _about_z(turn)
        found = largest_box(both, x, y[half:], z, home)
        if found is None:
            return None
        corners, size = found
        corners = corners @ _about_z(turn).T + self.base
        return (tuple(corners.min(axis=0).tolist()), tuple(corners.max(axis=0).tolist())), size

    def verified(
        self, box: Box, reached: Callable[[np.ndarray], np.ndarray], holds: np.ndarray | None
    ) -> tuple[Box, float]:
        """The box, made smaller until enough random points in it are reached, and their share."""
        low, high = np.array(box)
        random, share = np.random.default_rng(1), 0.0
        for _ in range(SHRINKS):
            share = float(reached(random.uniform(low, high, (PROBES, 3))).mean())
            if share >= SHARE:
                break
            less = SHRINK / 2 * (high - low)
            low, high = low + less, high - less
            if holds is not None:
                low, high = np.minimum(low, holds), np.maximum(high, holds)
        low, high = np.round(low, 3), np.round(high, 3)
        return (tuple(low.tolist()), tuple(high.tolist())), share


def largest_box(
    inside: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, holds: np.ndarray | None
) -> tuple[np.ndarray, float] | None:
    """Corners `[2, 3]` and size of the largest box, even about the plane y = 0, all of whose nodes are `inside`.

    `inside [x, |y|, z]` are nodes on the axes. The size is the volume; of a box that `holds` a point it is the
    shortest side, in proportion to those of the tutorial's workspace, to which the others are cut.
    """
    sides = np.subtract(TUTORIAL_WORKSPACE[1], TUTORIAL_WORKSPACE[0])
    (i0, i1), (k0, k1) = np.triu_indices(len(x), 1), np.triu_indices(len(z), 1)
    i0, i1, k0, k1 = i0[:, None], i1[:, None], k0[None], k1[None]
    best, found = 0.0, None
    for side in range(1, len(y)):
        sums = np.zeros((len(x) + 1, len(z) + 1), int)
        sums[1:, 1:] = inside[:, : side + 1].all(axis=1).cumsum(axis=0).cumsum(axis=1)
        nodes = sums[i1 + 1, k1 + 1] - sums[i0, k1 + 1] - sums[i1 + 1, k0] + sums[i0, k0]
        full = nodes == (i1 - i0 + 1) * (k1 - k0 + 1)
        deep, wide, high = x[i1] - x[i0], 2 * y[side], z[k1] - z[k0]
        if holds is None:
            size = deep * wide * high
        else:
            size = np.minimum(np.minimum(deep / sides[0], wide / sides[1]), high / sides[2])
            full &= (x[i0] <= holds[0]) & (x[i1] >= holds[0]) & (z[k0] <= holds[2]) & (z[k1] >= holds[2])
            full &= y[side] >= abs(holds[1])
        size = np.where(full, size, 0.0)
        if size.max() > best * (1 + 1e-9):
            best = float(size.max())
            i, k = np.unravel_index(size.argmax(), size.shape)
            found = np.array([[x[i0[i, 0]], -y[side], z[k0[0, k]]], [x[i1[i, 0]], y[side], z[k1[0, k]]]])
    if found is None or holds is None:
        return None if found is None else (found, best)
    extra = (found[1] - found[0] - best * sides).clip(0)
    low, high = found[0] + extra * (0.5, 0.5, 0.0), found[1] - extra * (0.5, 0.5, 1.0)
    return np.array([low, high]) + (holds - high).clip(0) + (holds - low).clip(None, 0), best


def _about_z(angle: float) -> np.ndarray:
    cos, sin = np.round(np.cos(angle), 12), np.round(np.sin(angle), 12)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


QUANTILES, MARGIN = (0.1, 0.9), 0.01
"""Of an arm that moves its tool in a plane or on a line: shares of the points that it reaches below its faces, and
how much larger the box is, so that the plane is not a face [m]."""


def _around(chain: Chain, base: np.ndarray, up: float, home: np.ndarray) -> Derived:
    """Of an arm that reaches no box: that around the middle of the points it reaches above its base, and home.

    Raises:
        InputError: hardly any two of them differ.
    """
    random = np.random.default_rng(0).uniform(chain.lower, chain.upper, (PROBES, chain.n))
    low, high = np.quantile([chain.tool_at(q)[0] for q in random], QUANTILES, axis=0)
    if (high - low).max() < MARGIN:
        raise InputError(
            "the arm's tool stays within a centimetre, however its joints move: choose another frame as --tool."
        )
    there = chain.tool_at(home)[0]
    low, high = np.minimum(low, there) - MARGIN, np.maximum(high, there) + MARGIN
    if up > 0:
        low[2] = min(max(low[2], base[2]), there[2] - MARGIN)
    else:
        high[2] = max(min(high[2], base[2]), there[2] + MARGIN)
    box = tuple(map(significant, low.tolist())), tuple(map(significant, high.tolist()))
    start = tuple(home.tolist())
    return Derived(start, orientation(chain, start), box, box, {})
