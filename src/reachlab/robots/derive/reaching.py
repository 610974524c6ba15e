"""Where the tool of an arm comes to from joints of its own: one program, compiled once for all tools of an arm."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from reachlab.jax_setup import beside, jit, refuse_fork
from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.inverse import DAMPING, POINT_DAMPING, ik_approach
from reachlab.robots.kinematics.scalars import Rotation, Vec

NODES = (15, 10, 13)
"""Points of the grid on which boxes are looked for: forward, to one side (and as many to the other), and up."""

PROBES = NODES[0] * (2 * NODES[1] - 1) * NODES[2]
"""Points to which an arm is led at once: as many as the grid has, so that nothing is compiled twice."""

STEPS, SETTLING = 64, 16
"""Steps on the straight way to a point, and steps in which the arm comes to rest there."""


class Led(NamedTuple):
    """What became of an arm that was led to points.

    Attributes:
        q: its joints `[m, n]`.
        off: how far its tool is from the points `[m]` m.
        turned: how far it is turned from how it was to be held `[m]` rad, of an arm with fewer than six joints tilted.
    """

    q: np.ndarray
    off: np.ndarray
    turned: np.ndarray


def lead(chain: Chain, q: np.ndarray, points: np.ndarray, held: np.ndarray | None) -> Led:
    """Lead an arm from joints `q [n]` or `[m, n]` to at most `PROBES` points `[m, 3]` m, on straight ways.

    Its tool is `held` in an orientation, wxyz, where there is one, by the steps that tasks take.
    """
    filled = np.arange(PROBES) % len(points)
    starts = np.broadcast_to(q, (len(points), chain.n))[filled]
    rotation, offset = chain.frames[-1]
    tool, quaternion = np.array([*rotation, offset]), (1.0, 0.0, 0.0, 0.0) if held is None else held
    begun = chain.tools_at(starts)[:, :3, 3]
    given = (tool, chain.approach, starts, begun, points[filled], quaternion, held is not None)
    ends = np.asarray(program(chain)(*(np.asarray(part, np.float32) for part in given)), float)[: len(points)]
    there = chain.tools_at(ends)
    off = np.linalg.norm(there[:, :3, 3] - points, axis=1)
    return Led(ends, off, np.zeros(len(off)) if held is None else _turned(chain, there[:, :3, :3], held))


def program(chain: Chain) -> Callable[..., Array]:
    """What leads an arm; it is compiled beside the main thread from the first call on.

    Raises:
        InputError: JAX cannot compute in this process.
    """
    refuse_fork()
    return _compiled(replace(chain, frames=chain.frames[:-1], approach=()))


@functools.cache
def _compiled(arm: Chain) -> Callable[..., Any]:
    def lead_all(
        tool: Array, approach: Array, starts: Array, begun: Array, aims: Array, quaternion: Array, holding: Array
    ) -> Array:
        *rotation, offset = (Vec(*column) for column in tool)
        chain = replace(arm, frames=(*arm.frames, (Rotation(*rotation), offset)), approach=tuple(approach))
        damping = jnp.where(holding > 0, DAMPING, POINT_DAMPING)

        def step(number: Array, q: Array) -> Array:
            aim = begun + jnp.minimum((number + 1) / STEPS, 1.0) * (aims - begun)
            return ik_approach(chain, q, aim, quaternion, damping, holding)

        return jax.lax.fori_loop(0, STEPS + SETTLING, step, starts)

    shapes = (4, 3), (3,), (PROBES, arm.n), (PROBES, 3), (PROBES, 3), (4,), ()
    given = [jax.ShapeDtypeStruct(shape, np.float32) for shape in shapes]

    def compiled() -> Callable[..., Array]:
        with jax.enable_x64(False):  # whatever holds in this thread
            return jit(lead_all, brief=True).lower(*given).compile()

    return beside(compiled)


def _turned(chain: Chain, rotations: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Angles `[m]` rad of the tool's `rotations [m, 3, 3]` from an orientation, or of their tilts from its own."""
    wanted = np.zeros(9)
    mujoco.mju_quat2Mat(wanted, held)
    if chain.poses:
        return np.arccos(np.clip((rotations.reshape(-1, 9) @ wanted - 1.0) / 2.0, -1.0, 1.0))
    tilts = np.arccos(np.clip(-np.vstack([rotations, wanted.reshape(1, 3, 3)])[:, 2] @ chain.approach, -1.0, 1.0))
    return np.abs(tilts[:-1] - tilts[-1])
