"""Evading: velocity dampers that go by how bodies move, and by where they will be."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.control.bodies import Bodies, Nearest, absent, beside, nearest
from reachlab.control.dampers import RATE, STOP, apart, approach, obeyed
from reachlab.control.situation import Drive, Situation
from reachlab.robots.robot import Robot
from reachlab.robots.shapes.clearance import Segments, capsules_at, moving

AHEAD = (0.2, 0.4, 0.6)
"""Times at which is looked where bodies will be [s]: the one at which each would be nearest is the one that counts."""

PASS = 0.04
"""Distance at which a body is let pass [m], in proportion to the arm's workspace."""

OWN, OWN_RATE = 0.02, 0.15
"""Distance at which links come no nearer to each other [m], likewise, half of that at home at most; and the share of
their way to it that they may go in a step."""


def after(bodies: Bodies, time: float) -> Bodies:
    """Bodies `[..., K]` a time later [s], if none changes its velocity; they do not turn."""
    return replace(bodies, position=bodies.position + time * bodies.velocity[..., :3])


def evaded(drive: Drive, now: Situation, step: Array) -> Array:
    """Joint displacement `[B, n]` that gives way to bodies `[B, K]` that move.

    Each capsule has two limits a body. It may come nearer to where the body is by as much as `damped` allows, of what
    the body's own velocity leaves (Faverjon and Tournassoud, 1987). And by the time at which the body will be nearest
    it has to be out of its way, to the side to which that is shorter: a body that comes straight at an arm would
    otherwise push it along. The limits of the table and of the arm's own links come last, and hold where others
    contradict them. The arm will be where it is commanded after its servos' lag: bodies are looked at then.
    """
    robot, lag = drive.robot, max(drive.lag)
    commanded = now.command[..., : robot.chain.n]
    at = capsules_at(robot.chain, robot.capsules, commanded)
    soon, when = _nearest_pass(robot, at, now.bodies, lag)
    here = _beside(robot, at, after(now.bodies, lag))
    table = nearest(robot.capsules, at, absent(0))
    comes = sum(speed[:, None] * way for speed, way in zip(_speeds(now.bodies), here.normal, strict=True))
    stop = STOP * robot.scale
    passed = -drive.period / when * (soon.distance - PASS * robot.scale)
    kept = -RATE * jnp.maximum(here.distance - stop, -3 * stop) + drive.period * comes
    near = [jax.tree.map(lambda x, k=k: x[k], each) for each in (soon, here) for k in range(len(here.distance))]
    rows = [approach(robot, commanded, one) for one in (*near, table)]
    least = [*passed, *kept, -RATE * jnp.maximum(table.distance - stop, -stop)]
    if robot.capsules.pairs:
        gap, gradient = apart(robot, commanded, OWN)
        rows, least = [*rows, gradient.T[None]], [*least, -OWN_RATE * gap[None]]
    return obeyed(step, jnp.concatenate(rows), jnp.concatenate(least))


def _speeds(bodies: Bodies) -> list[Array]:
    """Linear velocities of bodies `[B, K]`, three `[K, B]` [m/s]."""
    return [bodies.velocity[..., i].T for i in range(3)]


def _beside(robot: Robot, at: Segments, bodies: Bodies) -> Nearest:
    """From bodies `[B, K]` to the capsules that joints move, `[K, C, B]`."""
    start, end, radius = moving(robot.capsules, at)
    found = beside(start, end, jax.tree.map(lambda x: jnp.moveaxis(x, 1, 0)[:, None], bodies))
    return found._replace(distance=found.distance - radius)


def _nearest_pass(robot: Robot, at: Segments, bodies: Bodies, lag: float) -> tuple[Nearest, Array]:
    """The same at the time from `AHEAD` at which they are nearest, and that time `[K, C, B]` [s]."""
    each = [_beside(robot, at, after(bodies, lag + time)) for time in AHEAD]
    found, when = each[0], jnp.full_like(each[0].distance, AHEAD[0])
    for one, time in zip(each[1:], AHEAD[1:], strict=True):
        nearer = one.distance < found.distance
        found = jax.tree.map(lambda a, b, nearer=nearer: jnp.where(nearer, a, b), one, found)
        when = jnp.where(nearer, time, when)
    return found, when
