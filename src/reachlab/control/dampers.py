"""Velocity dampers: joint displacements that keep an arm clear of the bodies beside it and of the table."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import Bodies, Nearest, nearest
from reachlab.control.situation import Drive, Situation
from reachlab.robots.kinematics.forward import components, frames_at
from reachlab.robots.kinematics.scalars import Vec
from reachlab.robots.robot import Robot
from reachlab.robots.shapes.clearance import capsules_at, pair_distances

STOP = 0.03
"""Distance at which a capsule may come no nearer [m], in proportion to the arm's workspace."""

CLOSE = 0.012
"""The same for ways among furniture, where half of the goals are nearer than `STOP`: planned ones keep 1.4 cm [m]."""

RATE, RATE_AMONG = 0.08, 0.2
"""Share of its way to that distance that a capsule may go in a step; the same for ways among furniture, whose narrow
parts take too long otherwise."""

OWN = 0.003
"""Distance at which links come no nearer to each other [m], likewise: planned ways keep 3 mm."""

SWEEPS = 6
"""Times that the displacement is made to obey each capsule's limit in turn."""

TINY = 1e-6
"""Added to a square that divides."""


def surroundings(robot: Robot, q: Array, bodies: Bodies) -> Nearest:
    """What is nearest to the arm's capsules at joints `q [B, n]`, of bodies `[B, K]` and the table."""
    return nearest(robot.capsules, capsules_at(robot.chain, robot.capsules, q), bodies)


def damped(drive: Drive, now: Situation, step: Array) -> Array:
    """Joint displacement `[B, n]` that brings no capsule nearer to a body than `RATE` allows.

    Faverjon and Tournassoud, "A local based approach for path planning of manipulators with a high number of degrees of
    freedom", ICRA 1987. The limits, one a capsule, are obeyed in turn by the smallest change (Kaczmarz, 1937).
    """
    robot, commanded = drive.robot, now.command[..., : drive.robot.chain.n]
    around = surroundings(robot, commanded, now.bodies)
    rows = approach(robot, commanded, around)
    return obeyed(step, rows, -RATE * jnp.maximum(around.distance - STOP * robot.scale, -STOP))


def hemmed(drive: Drive, now: Situation, step: Array) -> Array:
    """The same with limits for each body, nearer to them and faster, for ways among furniture.

    Where an arm reaches between boards, another than the nearest may be met next, and links of its own. And an arm that
    is late cuts the corners of its commands: from where it is, all that is left to the next one may bring it no nearer
    either.
    """
    robot, commanded = drive.robot, now.command[..., : drive.robot.chain.n]
    count = now.bodies.kind.shape[1]
    each = jax.tree.map(lambda x: jnp.concatenate([jnp.moveaxis(x[:, :, None], 1, 0)] * 2), now.bodies)
    where = jnp.stack([commanded] * count + [now.q] * count)
    rate, back = (jnp.repeat(jnp.array(both, jnp.float32), count) for both in ((RATE_AMONG, 1.0), (CLOSE, 0.0)))

    def limit(_: None, one: tuple[Array, Bodies, Array, Array]) -> tuple[None, tuple[Array, Array]]:
        q, body, rate, back = one
        around = surroundings(robot, q, body)
        row = approach(robot, q, around)
        left = (row * (commanded - q).T).sum(axis=1)
        return None, (row, -rate * jnp.maximum(around.distance - CLOSE * robot.scale, -back) - left)

    rows, least = jax.lax.scan(limit, None, (where, each, rate, back))[1]
    rows, least = [rows.reshape(-1, *rows.shape[2:])], [least.reshape(-1, least.shape[-1])]
    for q, rate in ((commanded, RATE_AMONG), (now.q, 1.0)) if robot.capsules.pairs else ():
        gap, gradient = apart(robot, q, OWN)
        rows.append(gradient.T[None])
        least.append((-rate * jnp.maximum(gap, 0.0) - (gradient * (commanded - q)).sum(axis=-1))[None])
    return obeyed(step, jnp.concatenate(rows), jnp.concatenate(least))


def apart(robot: Robot, q: Array, least: float) -> tuple[Array, Array]:
    """How much further apart links are than they may be `[B]` m, and how that grows with joints `q [B, n]`.

    They may be at the `least` distance [m], in proportion to the arm's workspace, or half of that at home.
    """
    capsules, chain = robot.capsules, robot.chain
    with jax.ensure_compile_time_eval():
        home = jnp.array(robot.home, jnp.float32)[None]
        usual = np.asarray(pair_distances(capsules, capsules_at(chain, capsules, home), capsules.pairs))
    kept = np.minimum(least * robot.scale, usual / 2)

    def left(q: Array) -> Array:
        return (pair_distances(capsules, capsules_at(chain, capsules, q), capsules.pairs) - kept).min(axis=0)

    gap, pull = jax.vjp(left, q)
    return gap, pull(jnp.ones_like(gap))[0]


def obeyed(step: Array, rows: Array, least: Array) -> Array:
    """Joint displacement `[B, n]`, changed so that its products with `rows [L, n, B]` are at least `least [L, B]`.

    Of limits that contradict each other the last ones are obeyed.
    """
    squares = jnp.square(rows).sum(axis=1) + TINY

    def obey(step: Array, limit: tuple[Array, Array, Array]) -> tuple[Array, None]:
        row, least, square = limit
        missing = jnp.maximum(least - (row * step).sum(axis=0), 0.0)
        return step + missing / square * row, None

    def broken(sweep: tuple[Array, Array]) -> Array:
        turn, step = sweep
        return (turn < SWEEPS) & ((rows * step).sum(axis=1) < least).any()

    def sweep(before: tuple[Array, Array]) -> tuple[Array, Array]:
        turn, step = before
        return turn + 1, jax.lax.scan(obey, step, (rows, least, squares))[0]

    return jax.lax.while_loop(broken, sweep, (jnp.zeros((), jnp.int32), step.T))[1].T


def approach(robot: Robot, q: Array, around: Nearest) -> Array:
    """By how much displacements of the joints move each moving capsule away from what is nearest, `[C, n, B]`."""
    chain, links = robot.chain, np.array([link for link in robot.capsules.links if link])
    frames = frames_at(chain, components(q))
    normal, point = Vec(*around.normal), Vec(*around.point)
    columns = []
    for joint, (slides, axis, origin) in enumerate(zip(chain.slides, frames.axes, frames.origins, strict=True)):
        moves = axis if slides else axis.cross(point.minus(origin))
        columns.append(jnp.where((joint < links)[:, None], normal.dot(moves), 0.0))
    return jnp.stack(columns, axis=1)
