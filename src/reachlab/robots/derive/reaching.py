"""Which points the tool of an arm reaches from a home: programs, compiled once for all tools of an arm."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.jax_setup import compile_together
from reachlab.robots.derive.home import SAMPLES, turned_candidates
from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.forward import forward_kinematics, turned
from reachlab.robots.kinematics.inverse import ik_approach, ik_point_step
from reachlab.robots.kinematics.scalars import Rotation, Vec

NODES = (15, 10, 13)
"""Points of the grid on which boxes are looked for: forward, to one side (and as many to the other), and up."""

STEPS, SETTLING = 64, 16
"""Steps on the straight way from home to a point, and steps in which the arm comes to rest there."""

CLOSE, TURNED = 2e-3, 0.1
"""A point is reached when the tool is this close to it [m], and, where it is held, turned by less than this [rad]."""

PROBES = NODES[0] * (2 * NODES[1] - 1) * NODES[2]
"""Random points of which the share is measured: as many as the grid has, so that nothing is compiled twice."""


@functools.cache
def programs_of(arm: Chain) -> list[Callable[..., Any]]:
    """`_held`, `_anyhow` and `turned_candidates`, compiled for an arm with any tool: its frame `[4, 3]`, and approach.

    An arm is looked at with the tool of its file and with a gripper.
    """
    tool, (vectors, points) = np.zeros((4, 3), np.float32), (np.zeros((PROBES, n), np.float32) for n in (arm.n, 3))

    def with_tool(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(tool: Array, approach: Array, *arguments: Any) -> Any:
            *rotation, offset = (Vec(*column) for column in tool)
            frames = (*arm.frames, (Rotation(*rotation), offset))
            return function(replace(arm, frames=frames, approach=tuple(approach)), *arguments)

        return call

    sampled, given = np.zeros((SAMPLES, arm.n), np.float32), (tool, points[0])
    return compile_together(
        (with_tool(_held), (*given, vectors[0], points)),
        (with_tool(_anyhow), (*given, vectors, points)),
        (with_tool(turned_candidates), (*given, points[0], sampled, np.float32(0))),
    )


def _held(chain: Chain, home: Array, points: Array) -> tuple[Array, Array]:
    start = forward_kinematics(chain, home)
    quaternion = jnp.broadcast_to(start.quaternion, (len(points), 4))

    def step(number: Array, q: Array) -> Array:
        share = jnp.minimum((number + 1) / STEPS, 1.0)
        aim = start.position + share * (points - start.position)
        return ik_approach(chain, q, aim, quaternion)

    q = jax.lax.fori_loop(0, STEPS + SETTLING, step, jnp.broadcast_to(home, (len(points), chain.n)))
    pose = forward_kinematics(chain, q)
    apart = jnp.linalg.norm(pose.position - points, axis=-1)
    return (apart < CLOSE) & (turned(chain, pose.quaternion, quaternion) < TURNED), q


def _anyhow(chain: Chain, starts: Array, points: Array) -> tuple[Array, Array]:
    begun = forward_kinematics(chain, starts).position

    def step(number: Array, q: Array) -> Array:
        aim = begun + jnp.minimum((number + 1) / STEPS, 1.0) * (points - begun)
        return q + ik_point_step(chain, q, q, aim - forward_kinematics(chain, q).position)

    q = jax.lax.fori_loop(0, STEPS + SETTLING, step, starts)
    return jnp.linalg.norm(forward_kinematics(chain, q).position - points, axis=-1) < CLOSE, q
