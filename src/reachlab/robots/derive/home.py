"""Where an arm's episodes may start: joint vectors with the tool pointing down in front of the base."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.forward import (
    approach_axis,
    components,
    forward_kinematics,
    frames_at,
    jacobian,
    stack,
)
from reachlab.robots.kinematics.scalars import solve_positive

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

APART = 0.6
"""Homes that are tried differ in a joint by at least this [rad or m]."""

TRIED = 64
"""Best joint vectors that are looked at for it."""


def turned_candidates(chain: Chain, base: np.ndarray, sampled: Array, tilt: Array) -> tuple[Array, ...]:
    """Joint vectors `sampled [B, n]` with the tool turned to a tilt, for `Candidates`.

    With them come the tool's position, the Gram matrix of its Jacobian, what is left of the turn, how far the arm hangs
    below its second joint, and where the tool was.
    """
    q = jax.lax.fori_loop(0, TURNS, lambda _, q: _turned(chain, base, q, tilt), sampled)
    off = jnp.linalg.norm(_turn(chain, base, q, tilt)[0], axis=-1)
    q = jnp.where((off < TURNED).any(), q, sampled)  # an arm that cannot turn its tool so stays off its limits
    pose, columns = forward_kinematics(chain, q), jacobian(chain, q)[..., :3, :]
    gram = jnp.einsum("bij,bkj->bik", columns, columns)
    heights = [jnp.broadcast_to(origin.z, off.shape) for origin in frames_at(chain, components(q)).origins]
    hangs = heights[min(1, chain.n - 1)] - jnp.stack(heights[1:] or heights).min(axis=0)
    return q, pose.position, gram, off, hangs, forward_kinematics(chain, sampled).position


def rounded(chain: Chain, q: np.ndarray) -> np.ndarray:
    """Joint vector `[n]` to thousandths [rad or m]: single precision finds it, whose last digits depend on the CPU."""
    return np.clip(np.round(q, 3) + 0.0, chain.lower, chain.upper)


class Candidates:
    """Joint vectors at which the tool points down, or tilted outward, of which one will be home.

    Attributes:
        reach: how far from its base the tool comes [m].
    """

    def __init__(
        self, chain: Chain, base: np.ndarray, tilts: Sequence[float], find: Callable[..., tuple[Array, ...]]
    ) -> None:
        """Candidates of an arm that stands at `base [3]` m, with the tool tilted by one of some angles [rad].

        `find` is `turned_candidates` of this arm, compiled.
        """
        self._base = base
        lower, upper = np.array(chain.lower), np.array(chain.upper)
        middle = (lower + upper) / 2
        lower, upper = np.maximum(lower, middle - WIDEST), np.minimum(upper, middle + WIDEST)
        sampled = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, chain.n)).astype(np.float32)
        found = [[np.asarray(part, np.float64) for part in find(sampled, np.float32(tilt))] for tilt in tilts]
        q, self._position, gram, off, hangs, anywhere = map(np.concatenate, zip(*found, strict=True))
        self._tilt = np.repeat(tilts, SAMPLES)
        self.reach = float(np.quantile(np.linalg.norm(anywhere - base, axis=1), REACH))
        half = np.maximum((np.array(chain.upper) - np.array(chain.lower)) / 2, TINY)
        to_limit = np.minimum(q - chain.lower, chain.upper - q) / half
        able = np.sqrt(np.linalg.eigvalsh(gram)[:, 0].clip(0)) / self.reach
        bent = np.square((q - middle) / (BENT * np.pi)).mean(axis=1)
        able[able < LEAST] = 0.0
        self._q, self._middle = q, middle
        self._worth = np.clip(to_limit.min(axis=1) / COMFORTABLE, 0.0, 1.0) * able / (1 + bent)
        if (off < TURNED).any():  # else an arm that cannot turn its tool so: any orientation will do
            self._worth[off >= TURNED] = 0.0
        if self._worth[upright := hangs < HANGING * self.reach].any():
            self._worth[~upright] = 0.0

    def best(self, turn: float, tilt: float, free: Callable[[np.ndarray], bool], most: int) -> list[np.ndarray]:
        """The best joint vectors `[n]`, unlike each other, with the front turned by an angle about the vertical."""
        cos, sin = np.cos(turn), np.sin(turn)
        x, y, z = (self._position - self._base).T / self.reach
        x, y = cos * x + sin * y, cos * y - sin * x
        worth = self._worth / (1 + np.square((np.stack([x, y, z], axis=1) - PLACE) / SPREAD).sum(axis=1))
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


def _turn(chain: Chain, base: np.ndarray, q: Array, tilt: Array) -> tuple[Array, Array]:
    """Turn `[B, 3]` rad that brings the tool's axis to its tilt, away from the base; and that axis `[B, 3]`."""
    pose = forward_kinematics(chain, q)
    axis, out = approach_axis(chain, pose.quaternion), (pose.position - base)[..., :2]
    out /= jnp.linalg.norm(out, axis=-1, keepdims=True) + TINY
    wanted = jnp.concatenate([jnp.sin(tilt) * out, jnp.full_like(out[..., :1], -jnp.cos(tilt))], axis=-1)
    across = jnp.cross(axis, wanted)
    sin = jnp.linalg.norm(across, axis=-1, keepdims=True)
    angle = jnp.arctan2(sin, (axis * wanted).sum(axis=-1, keepdims=True))
    return angle * jnp.where(sin > TINY, across / jnp.maximum(sin, TINY), jnp.array([1.0, 0.0, 0.0])), axis


def _turned(chain: Chain, base: np.ndarray, q: Array, tilt: Array) -> Array:
    """Joint vectors `[B, n]` one damped least-squares step nearer to a tool that is tilted so."""
    turn, axis = _turn(chain, base, q, tilt)
    columns = jacobian(chain, q)[..., 3:, :]
    columns -= axis[..., :, None] * jnp.einsum("bi,bij->bj", axis, columns)[..., None, :]
    gram = jnp.einsum("bij,bkj->bik", columns, columns) + DAMPING * jnp.eye(3)
    weights = solve_positive([[gram[:, i, j] for j in range(i + 1)] for i in range(3)], components(turn))
    step = jnp.einsum("bij,bi->bj", columns, stack(weights, turn))
    step *= jnp.minimum(1.0, LONGEST_STEP / jnp.maximum(jnp.abs(step).max(axis=-1, keepdims=True), TINY))
    return jnp.clip(q + step, jnp.array(chain.lower), jnp.array(chain.upper))
