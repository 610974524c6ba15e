"""Scenes of obstacles, drawn so that start and goal are free and a way between them exists."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.control.bodies import FAR, Bodies, Shape, absent, beside
from reachlab.control.situation import Goal
from reachlab.robots.kinematics.forward import Pose, forward_kinematics
from reachlab.robots.shapes.clearance import Capsules, Segments, capsules_at, free_at, moving
from reachlab.tasks.given_goals import joints_at
from reachlab.tasks.targets import Drawn, first_reached, of_key, sample_point
from reachlab.tasks.task import TaskSetup

NAME = "balls"
"""Of this kind of scene."""

KINDS = (Shape.BALL, Shape.CAPSULE, Shape.BOX)
"""Of which an obstacle is."""

RADIUS, THIN, LONG, SIDE = (0.04, 0.1), (0.025, 0.06), (0.08, 0.25), (0.03, 0.12)
"""Least and largest radius of a ball, radius and half length of a capsule, and half side of a box [m], in proportion to
the arm's workspace."""

AROUND = 0.12
"""Obstacles lie so far from the way that the tool would take [m], likewise: the standard deviation along each axis."""

CLEAR = 0.03
"""Least distance of the arm at start and goal from obstacles [m], likewise; half of it on the way that is found."""

CANDIDATES = 6
"""Obstacles drawn in place of one, of which the first is taken that leaves start and goal free."""

VIAS, WIDE = 6, 0.8
"""Joint vectors over which a way is looked for beside the straight one, and how far from its middle they are [rad]."""

STEPS = 8
"""Points on a straight part of a way that have to be free."""

ROUNDS = 8
"""Scenes that are drawn until one has a way; if none has, the episode has no obstacles."""


class _Scene(NamedTuple):
    key: Array
    bodies: Bodies
    solved: Array
    rounds: Array


def sample_free_goal(setup: TaskSetup, key: Array) -> Goal:
    """A point of the box, and joints near home that have it, in which the arm touches neither itself nor the table."""

    def draw(key: Array) -> Drawn:
        key, now = jax.random.split(key)
        return Drawn(key, *joints_at(setup, sample_point(setup, now)), jnp.zeros((), jnp.int32))

    found = first_reached(draw, setup, key)
    return goal_of(setup, Pose(found.position, found.quaternion), found.joints)


def goal_of(setup: TaskSetup, pose: Pose, joints: Array) -> Goal:
    """The point of a pose or, where an orientation is asked for, the pose; and joints `[n]` that have it."""
    return Goal.at(pose.position, quaternion=pose.quaternion if setup.rules.asks_orientation else None, joints=joints)


def places(setup: TaskSetup) -> int:
    """Obstacles for which a scene has room: at least one, so that contact is judged where there are none too."""
    return max(setup.rules.obstacles[1], 1)


def sample_scene(setup: TaskSetup, key: Array, start: Array, goal: Goal) -> Bodies:
    """Obstacles for an episode from joints `start [n]` to a goal's, each number that the rules allow as often."""
    count, (fewest, most) = places(setup), setup.rules.obstacles
    robot, nothing, ends = setup.robot, absent(count, radius=RADIUS[0]), jnp.stack([start, goal.joints])

    def draw(key: Array) -> tuple[Array, Bodies, Array]:
        key, for_count, for_shapes, for_way = jax.random.split(key, 4)
        wanted = jax.random.randint(for_count, (), fewest, most + 1)
        joints = jnp.concatenate([ends, _ways(setup, for_way, start, goal.joints)])
        at = capsules_at(robot.chain, robot.capsules, joints)
        at_ends, on_ways = jax.tree.map(lambda x: x[:, :2], at), jax.tree.map(lambda x: x[:, 2:], at)
        drawn = _drawn(setup, for_shapes, ends, at_ends)
        there = jnp.arange(count) < wanted
        bodies = among(there, drawn, nothing)
        return key, bodies, _leads(setup, on_ways, bodies)

    return first_solved(draw, key, nothing, ROUNDS)


def first_solved(
    draw: Callable[[Array], tuple[Array, Bodies, Array]], key: Array, nothing: Bodies, most: int
) -> Bodies:
    """The first scene drawn that is solved, or `nothing`, if none of so many is; `draw` gives the next key too."""

    def again(before: _Scene) -> _Scene:
        return _Scene(*draw(before.key), before.rounds + 1)

    begun = _Scene(key, *of_key(key, (nothing, jnp.zeros((), bool), jnp.zeros((), jnp.int32))))
    found = jax.lax.while_loop(lambda scene: ~scene.solved & (scene.rounds < most), again, begun)
    return jax.tree.map(lambda a, b: jnp.where(found.solved, a, b), found.bodies, nothing)


def among(there: Array, drawn: Bodies, nothing: Bodies) -> Bodies:
    """Those of bodies `[K]` that are `there [K]`, and nothing in place of the others."""
    return jax.tree.map(lambda a, b: jnp.where(there.reshape(-1, *[1] * (a.ndim - 1)), a, b), drawn, nothing)


def between(limits: tuple[float, float], share: Array, scale: float) -> Array:
    """Lengths between limits for the tutorial's arm, at such shares of the way from the one to the other."""
    return scale * (limits[0] + share * (limits[1] - limits[0]))


def _drawn(setup: TaskSetup, key: Array, free: Array, at: Segments) -> Bodies:
    """Obstacles that the arm does not meet at joints `free [2, n]`, near the way of the tool from the one to the other.

    There its capsules lie as `at`. Where none of the candidates is so, there is none.
    """
    count = places(setup)
    for_shapes, for_share = jax.random.split(key)
    shares = jax.random.uniform(for_share, (count * CANDIDATES, 1))
    way = forward_kinematics(setup.robot.chain, free[0] + shares * (free[1] - free[0])).position
    candidates = _shapes(setup, for_shapes, way)
    clear = (clearances(setup.robot.capsules, at, candidates) > CLEAR * setup.robot.scale).all(axis=0)
    clear = clear.reshape(count, CANDIDATES)
    chosen = jnp.arange(count) * CANDIDATES + clear.argmax(axis=1)
    found = jax.tree.map(lambda x: x[chosen], candidates)
    return replace(found, position=jnp.where(clear.any(axis=1)[:, None], found.position, jnp.array(FAR)))


def _shapes(setup: TaskSetup, key: Array, near: Array) -> Bodies:
    """A random obstacle near each of `near [k, 3]` m."""
    scale, count = setup.robot.scale, len(near)
    for_kind, for_place, for_turn, for_size = jax.random.split(key, 4)
    kind = jnp.array(KINDS)[jax.random.randint(for_kind, (count, 1), 0, len(KINDS))]
    place = near + AROUND * scale * jax.random.normal(for_place, (count, 3))
    turn = jax.random.normal(for_turn, (count, 4))
    share = jax.random.uniform(for_size, (count, 3))

    thick = jnp.where(kind == Shape.BALL, between(RADIUS, share[:, :1], scale), between(THIN, share[:, :1], scale))
    long = jnp.where(kind == Shape.CAPSULE, between(LONG, share[:, 1:2], scale), 0.0)
    rounded = jnp.concatenate([thick, long, jnp.zeros_like(thick)], axis=1)
    return Bodies(
        position=place,
        quaternion=turn / jnp.linalg.norm(turn, axis=-1, keepdims=True),
        velocity=jnp.zeros((count, 6)),
        size=jnp.where(kind == Shape.BOX, between(SIDE, share, scale), rounded),
        kind=kind[:, 0],
    )


def clearances(capsules: Capsules, at: Segments, bodies: Bodies) -> Array:
    """Distances `[B, K]` m from bodies `[K]` of an arm whose capsules lie as `capsules_at` says."""
    start, end, radius = moving(capsules, at)
    count, others = start[0].shape[1], len(bodies.kind)
    one, other = (tuple(jnp.repeat(x, others, axis=1) for x in side) for side in (start, end))
    each = jax.tree.map(lambda x: jnp.tile(x, (count, *[1] * (x.ndim - 1))), bodies)
    return (beside(one, other, each).distance - radius).min(axis=0).reshape(count, others)


def _ways(setup: TaskSetup, key: Array, start: Array, goal: Array) -> Array:
    """Joints `[B, n]` on the straight way in joint space, and on ways over random joint vectors near its middle."""
    chain = setup.robot.chain
    away = jax.random.uniform(key, (VIAS, chain.n), minval=-WIDE, maxval=WIDE).at[0].set(0.0)
    vias = jnp.clip((start + goal) / 2 + away, jnp.array(chain.lower), jnp.array(chain.upper))
    shares = jnp.arange(1, STEPS + 1)[:, None] / STEPS
    to, on = (one + shares * (other - one) for one, other in ((start, vias[:, None]), (vias[:, None], goal)))
    return jnp.concatenate([to, on], axis=1).reshape(-1, chain.n)


def _leads(setup: TaskSetup, at: Segments, bodies: Bodies) -> Array:
    """Whether one of those `_ways` is free; its capsules lie as `at`."""
    least = CLEAR * setup.robot.scale / 2
    free = (clearances(setup.robot.capsules, at, bodies) > least).all(axis=1) & free_at(setup.robot.capsules, at)
    return free.reshape(VIAS, -1).all(axis=1).any()
