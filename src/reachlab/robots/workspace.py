"""What of an arm follows from its chain where nobody says it: home, how the tool is held, and the boxes it works in."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.jax_setup import jit
from reachlab.robots.chain import Chain
from reachlab.robots.home import Candidates
from reachlab.robots.inverse_kinematics import ik_displace, ik_point_step
from reachlab.robots.kinematics import forward_kinematics, turned
from reachlab.robots.robot import Box

SHARE = 0.999
"""A derived box holds at most one point in a thousand that the tool cannot reach."""

NODES = (15, 10, 13)
"""Points of the grid on which boxes are looked for: forward, to one side (and as many to the other), and up."""

NEAREST, WIDEST, HIGHEST, LOWEST_GOAL = 0.15, 0.8, 0.9, 0.08
"""Where the grid begins in front of the base, and ends at its sides and above it; and the height above which points in
the air lie: shares of the arm's reach."""

STEPS, SETTLING = 64, 16
"""Steps on the straight way from home to a point, and steps in which the arm comes to rest there."""

CLOSE, TURNED = 2e-3, 0.1
"""A point is reached when the tool is this close to it [m], and, where it is held, turned by less than this [rad]."""

TRAVEL = 1.2
"""Points in the air are near enough to home that every joint gets there in this time at its speed limit [s]."""

NOISE = 0.3
"""Starts from which points in the air have to be reached: every joint within this of home [rad or m]."""

PROBES = 4000
"""Random points of which the share is measured."""

SHRINK, SHRINKS = 0.04, 15
"""A box that holds too many points out of reach is made smaller by this share, so many times at most."""

QUARTERS = (0.0, 0.5 * np.pi, -0.5 * np.pi, np.pi)
"""Directions that may be the front, as turns about the vertical from x [rad]; x unless another is far better."""

HOMES = 6
"""Homes that are tried for each of them."""

FAR_BETTER = 1.5
"""Another front, or a home that is not the file's, is taken if its box is so many times as large."""


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

    The workspace is the largest box in front of and above the base that the tool can be displaced to from home on
    straight ways, held as it is at home; the box of goals in the air the largest that it comes to in any orientation.

    Args:
        chain: the arm.
        speed: its joint speed limits `[n]`.
        base: where it stands [m].
        home: the file's.
        free: whether the arm does not touch itself at a joint vector `[n]`.
    """
    candidates = Candidates(chain, base)
    search = _Search(chain, speed, base, candidates.reach)
    best: tuple[float, np.ndarray, float, Box] | None = None
    if home is not None:
        q = np.array(home)
        found = search.workspace(q, turn := candidates.front(q, QUARTERS))
        best = (search.volume(found) * FAR_BETTER, q, turn, found) if found else None
    for turn in QUARTERS:
        for q in candidates.best(turn, free, HOMES):
            found = search.workspace(q, turn)
            if found and (size := search.volume(found) * (FAR_BETTER if turn == 0.0 else 1.0)) > (best or (0.0,))[0]:
                best = size, q, turn, found
    if best is None:
        return _around(chain, base, candidates.any(home))
    _, q, turn, box = best
    workspace, share = search.verified(box, functools.partial(search.held, q), search.tool(q))
    goals = search.goal_box(q, turn) or workspace
    goal_box, goal_share = search.verified(goals, functools.partial(search.anyhow, q), None)
    home, shares = tuple(q.tolist()), {"workspace": share, "goal_box": goal_share}
    return Derived(home, orientation(chain, home), workspace, goal_box, shares)


def orientation(chain: Chain, home: tuple[float, ...]) -> tuple[float, ...]:
    """Orientation wxyz of the tool at home."""
    return tuple(np.asarray(forward_kinematics(chain, jnp.asarray(home, jnp.float32)).quaternion).tolist())


class _Search:
    """Boxes of points that an arm reaches from a home."""

    def __init__(self, chain: Chain, speed: np.ndarray, base: np.ndarray, reach: float) -> None:
        self._chain, self._speed, self._base, self._reach = chain, speed, base, reach
        self._axes = (
            np.linspace(NEAREST, 1.0, NODES[0]) * reach,
            np.linspace(-WIDEST, WIDEST, 2 * NODES[1] - 1) * reach,
            np.linspace(0.0, HIGHEST, NODES[2]) * reach,
        )
        self._held, self._anyhow = jit(functools.partial(_held, chain)), jit(functools.partial(_anyhow, chain))

    def tool(self, q: np.ndarray) -> np.ndarray:
        return np.asarray(forward_kinematics(self._chain, jnp.asarray(q, jnp.float32)).position, np.float64)

    @staticmethod
    def volume(box: Box) -> float:
        return float(np.prod(np.subtract(box[1], box[0])))

    def held(self, q: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Which of `points [m, 3]` the tool reaches from home `q`, held as it is there."""
        return np.asarray(self._held(q.astype(np.float32), points.astype(np.float32)))

    def anyhow(self, q: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Which of them it reaches from starts about home in any orientation, and in time."""
        noise = np.random.default_rng(0).uniform(-NOISE, NOISE, (len(points), self._chain.n))
        starts = np.clip(q + noise, self._chain.lower, self._chain.upper).astype(np.float32)
        reached, ends = self._anyhow(starts, points.astype(np.float32))
        return np.asarray(reached) & (np.abs(np.asarray(ends) - q) <= TRAVEL * self._speed).all(axis=1)

    def workspace(self, q: np.ndarray, turn: float) -> Box | None:
        """Largest box of points that are reached with the tool held, and that holds the tool at home."""
        return self._largest(functools.partial(self.held, q), turn, self.tool(q), 0)

    def goal_box(self, q: np.ndarray, turn: float) -> Box | None:
        """Largest box of points above the ground that are reached in any orientation."""
        lowest = int(np.searchsorted(self._axes[2], LOWEST_GOAL * self._reach))
        return self._largest(functools.partial(self.anyhow, q), turn, None, lowest)

    def _largest(
        self, reached: Callable[[np.ndarray], np.ndarray], turn: float, holds: np.ndarray | None, lowest: int
    ) -> Box | None:
        grid = np.stack(np.meshgrid(*self._axes, indexing="ij"), axis=-1)
        points = grid.reshape(-1, 3) @ _about_z(turn).T + self._base
        inside = reached(points).reshape(grid.shape[:3]).copy()
        inside[:, :, :lowest] = False
        half = NODES[1] - 1
        both = inside[:, half:] & inside[:, half::-1]  # [x, |y|, z]
        home = None if holds is None else (holds - self._base) @ _about_z(turn)
        found = _largest_box(both, self._axes[0], self._axes[1][half:], self._axes[2], home)
        if found is None:
            return None
        corners = np.array(found) @ _about_z(turn).T + self._base
        return tuple(corners.min(axis=0).tolist()), tuple(corners.max(axis=0).tolist())

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


def _held(chain: Chain, home: Array, points: Array) -> Array:
    start = forward_kinematics(chain, home)
    quaternion = jnp.broadcast_to(start.quaternion, (len(points), 4))

    def step(number: Array, q: Array) -> Array:
        share = jnp.minimum((number + 1) / STEPS, 1.0)
        aim = start.position + share * (points - start.position)
        return ik_displace(chain, q, aim - forward_kinematics(chain, q).position, quaternion)

    q = jax.lax.fori_loop(0, STEPS + SETTLING, step, jnp.broadcast_to(home, (len(points), chain.n)))
    pose = forward_kinematics(chain, q)
    apart = jnp.linalg.norm(pose.position - points, axis=-1)
    return (apart < CLOSE) & (turned(chain, pose.quaternion, quaternion) < TURNED)


def _anyhow(chain: Chain, starts: Array, points: Array) -> tuple[Array, Array]:
    begun = forward_kinematics(chain, starts).position

    def step(number: Array, q: Array) -> Array:
        aim = begun + jnp.minimum((number + 1) / STEPS, 1.0) * (points - begun)
        return q + ik_point_step(chain, q, q, aim - forward_kinematics(chain, q).position)

    q = jax.lax.fori_loop(0, STEPS + SETTLING, step, starts)
    return jnp.linalg.norm(forward_kinematics(chain, q).position - points, axis=-1) < CLOSE, q


def _largest_box(
    inside: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray, holds: np.ndarray | None
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Corners of the largest box, even about the plane y = 0, all of whose nodes `[x, |y|, z]` are inside."""
    best, found = 0.0, None
    lows, highs = np.triu_indices(len(x), 1), np.triu_indices(len(z), 1)
    for side in range(1, len(y)):
        sums = np.zeros((len(x) + 1, len(z) + 1), int)
        sums[1:, 1:] = inside[:, : side + 1].all(axis=1).cumsum(axis=0).cumsum(axis=1)
        (x0, x1), (z0, z1) = ((index[:, None] for index in lows), (index[None] for index in highs))
        full = sums[x1 + 1, z1 + 1] - sums[x0, z1 + 1] - sums[x1 + 1, z0] + sums[x0, z0] == (x1 - x0 + 1) * (
            z1 - z0 + 1
        )
        if holds is not None:
            full &= (x[x0] <= holds[0]) & (x[x1] >= holds[0]) & (z[z0] <= holds[2]) & (z[z1] >= holds[2])
            full &= y[side] >= abs(holds[1])
        size = np.where(full, (x[x1] - x[x0]) * (z[z1] - z[z0]) * 2 * y[side], 0.0)
        if size.max() > best:
            best = float(size.max())
            i, k = np.unravel_index(size.argmax(), size.shape)
            found = (
                (float(x[lows[0][i]]), -float(y[side]), float(z[highs[0][k]])),
                (float(x[lows[1][i]]), float(y[side]), float(z[highs[1][k]])),
            )
    return found


def _about_z(angle: float) -> np.ndarray:
    cos, sin = np.round(np.cos(angle), 12), np.round(np.sin(angle), 12)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


MARGIN = 0.01
"""By which such an arm's box is larger: its plane lies inside, not on the box's faces [m]."""

QUANTILES = (0.1, 0.9)
"""Of an arm that moves its tool in a plane or on a line: shares of the points that it reaches below the box's faces."""


def _around(chain: Chain, base: np.ndarray, home: np.ndarray) -> Derived:
    """Of an arm that reaches no box: that around the middle of the points it reaches above its base, and home."""
    q = np.random.default_rng(0).uniform(chain.lower, chain.upper, (PROBES, chain.n)).astype(np.float32)
    points = np.asarray(forward_kinematics(chain, jnp.asarray(q)).position)
    pose = forward_kinematics(chain, jnp.asarray(home, jnp.float32))
    tool = np.asarray(pose.position, np.float64)
    low, high = np.quantile(points, QUANTILES, axis=0)
    low, high = np.minimum(low, tool) - MARGIN, np.maximum(high, tool) + MARGIN
    low[2] = min(max(low[2], base[2]), tool[2] - MARGIN)
    box = tuple(low.tolist()), tuple(high.tolist())
    there = tuple(home.tolist())
    return Derived(there, orientation(chain, there), box, box, {})
