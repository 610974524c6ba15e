"""Where an arm's episodes may start: joint vectors with the tool pointing down in front of the base."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.jax_setup import jit
from reachlab.robots.chain import Chain
from reachlab.robots.kinematics import approach_axis, forward_kinematics, jacobian

SAMPLES = 8192
"""Random joint vectors from which homes are found."""

WIDEST = np.pi
"""Joints that turn further are sampled within this of the middle of their limits [rad]."""

TURNS = 25
"""Steps in which the tool is turned until it points down."""

DAMPING, DOWN = 1e-4, 1e-2
"""Damping of these steps, and the angle within which it does [rad]."""

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

APART = 0.6
"""Homes that are tried differ in a joint by at least this [rad or m]."""

TRIED = 64
"""Best joint vectors that are looked at for it."""


class Candidates:
    """Joint vectors at which the tool points down, of which one will be home.

    Attributes:
        reach: how far from its base the tool comes [m].
    """

    def __init__(self, chain: Chain, base: np.ndarray) -> None:
        """Candidates of an arm that stands at `base [3]` m."""
        lower, upper = np.array(chain.lower), np.array(chain.upper)
        middle = (lower + upper) / 2
        lower, upper = np.maximum(lower, middle - WIDEST), np.minimum(upper, middle + WIDEST)
        sampled = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, chain.n)).astype(np.float32)

        def find(sampled: Array) -> tuple[Array, ...]:
            q = jax.lax.fori_loop(0, TURNS, lambda _, q: _turned_down(chain, q), sampled)
            down = jnp.linalg.norm(_tilt(chain, forward_kinematics(chain, q).quaternion)[0], axis=-1) < DOWN
            q = jnp.where(down.any(), q, sampled)  # of an arm that cannot any orientation will do
            down |= ~down.any()
            pose, columns = forward_kinematics(chain, q), jacobian(chain, q)[..., :3, :]
            gram = jnp.einsum("bij,bkj->bik", columns, columns)
            return q, pose.position, gram, down, forward_kinematics(chain, sampled).position

        q, position, gram, down, anywhere = (np.asarray(x, np.float64) for x in jit(find)(sampled))
        self.reach = float(np.quantile(np.linalg.norm(anywhere - base, axis=1), REACH))
        self._chain, self._base = chain, base
        down = down.astype(bool)
        self._q, self._position, self._middle = q[down], position[down], middle
        half = np.maximum((np.array(chain.upper) - np.array(chain.lower)) / 2, 1e-9)
        to_limit = np.minimum(self._q - chain.lower, chain.upper - self._q) / half
        able = np.sqrt(np.linalg.eigvalsh(gram[down])[:, 0].clip(0)) / self.reach
        able[able < LEAST] = 0.0
        bent = np.square((self._q - middle) / (BENT * np.pi)).mean(axis=1)
        self._worth = np.clip(to_limit.min(axis=1) / COMFORTABLE, 0.0, 1.0) * able / (1 + bent)

    def best(self, turn: float, free: Callable[[np.ndarray], bool], most: int) -> list[np.ndarray]:
        """The best joint vectors `[n]`, unlike each other, with the front turned by an angle about the vertical."""
        cos, sin = np.cos(turn), np.sin(turn)
        x, y, z = (self._position - self._base).T / self.reach
        x, y = cos * x + sin * y, cos * y - sin * x
        worth = self._worth / (1 + np.square((np.stack([x, y, z], axis=1) - PLACE) / SPREAD).sum(axis=1))
        worth[(x < NEAREST) | (z < LOWEST) | (np.abs(y) > ASIDE * x)] = 0.0
        found: list[np.ndarray] = []
        for index in np.argsort(-worth)[:TRIED]:
            q = self._q[index]
            if len(found) < most and worth[index] and all(np.abs(q - one).max() > APART for one in found) and free(q):
                found.append(q)
        return found

    def front(self, q: np.ndarray, turns: Sequence[float]) -> float:
        """Which of the turns brings the front nearest to where the tool is at `q [n]`."""
        position = forward_kinematics(self._chain, jnp.asarray(q, jnp.float32)).position
        x, y = (np.asarray(position) - self._base)[:2]
        return max(turns, key=lambda turn: np.round(x * np.cos(turn) + y * np.sin(turn), 3))

    def any(self, home: tuple[float, ...] | None) -> np.ndarray:
        """The given home, else the most comfortable joint vector, or the middle of the limits if all are singular."""
        if home is not None:
            return np.array(home)
        return self._q[self._worth.argmax()] if self._worth.any() else self._middle


def _tilt(chain: Chain, quaternion: Array) -> tuple[Array, Array]:
    """Turn `[B, 3]` rad that points the tool's axis down, and that axis `[B, 3]` in the world."""
    axis = approach_axis(chain, quaternion)
    down = jnp.array([0.0, 0.0, -1.0])
    across = jnp.cross(axis, jnp.broadcast_to(down, axis.shape))
    sin = jnp.linalg.norm(across, axis=-1, keepdims=True)
    angle = jnp.arctan2(sin, -axis[..., 2:])
    aside = jnp.where(sin > 1e-6, across / jnp.maximum(sin, 1e-6), jnp.array([1.0, 0.0, 0.0]))
    return angle * aside, axis


def _turned_down(chain: Chain, q: Array) -> Array:
    """Joint vectors `[B, n]` one damped least-squares step nearer to a tool that points down."""
    turn, axis = _tilt(chain, forward_kinematics(chain, q).quaternion)
    columns = jacobian(chain, q)[..., 3:, :]
    columns -= axis[..., :, None] * jnp.einsum("bi,bij->bj", axis, columns)[..., None, :]
    gram = jnp.einsum("bij,bkj->bik", columns, columns) + DAMPING * jnp.eye(3)
    step = jnp.einsum("bij,bi->bj", columns, jnp.linalg.solve(gram, turn[..., None])[..., 0])
    step *= jnp.minimum(1.0, 0.5 / jnp.maximum(jnp.abs(step).max(axis=-1, keepdims=True), 1e-6))
    return jnp.clip(q + step, jnp.array(chain.lower), jnp.array(chain.upper))
