"""Scenes of balls and capsules that cross the arm's way at an even speed, so that it can give way to them."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import Bodies, Shape, absent, beside
from reachlab.control.situation import Goal
from reachlab.robots.shapes.clearance import Segments, capsules_at, free_at, moving
from reachlab.tasks.scenes.balls import LONG, RADIUS, THIN, among, between, first_solved
from reachlab.tasks.task import TaskSetup

NAME = "moving"
"""Of this kind of scene."""

MOST = 3
"""Bodies of an episode at most; each number from 1 is as likely."""

INSTANT = 0.2
"""Time between the instants at which is looked where bodies are [s]."""

ARRIVAL = 0.8
"""Time in which joints that nothing stops are at the goal [s]."""

MEETS = (1.0, 3.0)
"""Times between which a body meets the arm [s]."""

LAST = 1.5
"""Time at the end of an episode in which nothing is near the arm at its goal [s]."""

OFF = 0.04
"""Standard deviation along each axis of where a body meets the arm from the axis of a capsule [m], in proportion to the
arm's workspace."""

LEVEL = 0.5
"""Bodies rise or fall so many times as steeply as in a random direction."""

CLEAR = 0.06
"""Least distance from the arm at start and end, and of an evasive posture from all paths [m], likewise."""

AHEAD = 0.5
"""Time that a body takes at least to the arm as it starts [s]."""

CANDIDATES, ROUNDS = 16, 16
"""Bodies drawn in place of one, and scenes that are drawn until one can be evaded."""

POSTURES, WIDE = 16, 0.8
"""Postures of which one has to be free of all paths, and how far they are from that at the goal at most [rad]."""


def sample_scene(setup: TaskSetup, key: Array, start: Array, goal: Goal) -> Bodies:
    """Bodies for an episode from joints `start [n]` to a goal's, each of which meets an arm that does not give way."""
    robot, nothing = setup.robot, absent(MOST, radius=RADIUS[0])
    times = np.arange(0.0, float(setup.rules.max_steps * setup.period), INSTANT, dtype=np.float32)
    share = np.minimum(times / ARRIVAL, 1.0)[:, None]
    way = capsules_at(robot.chain, robot.capsules, start + share * (goal.joints - start))

    def draw(key: Array) -> tuple[Array, Bodies, Array]:
        key, for_count, for_bodies, for_postures = jax.random.split(key, 4)
        drawn, met = _drawn(setup, for_bodies, way, times)
        there = (jnp.arange(MOST) <= jax.random.randint(for_count, (), 0, MOST)) & met
        bodies = among(there, drawn, nothing)
        evaded = _evaded(setup, for_postures, goal.joints, bodies, times)
        return key, bodies, there[0] & evaded

    return first_solved(draw, key, nothing, ROUNDS)


def _drawn(setup: TaskSetup, key: Array, way: Segments, times: np.ndarray) -> tuple[Bodies, Array]:
    """Bodies `[MOST]` as the episode begins that meet an arm whose capsules go as `way`; and if any were found."""
    robot, scale = setup.robot, setup.robot.scale
    candidates = _candidates(setup, key, way, times)
    paths = _over(candidates, times)
    start, end, radius = moving(robot.capsules, way)
    one, other = (tuple(x[:, None] for x in side) for side in (start, end))
    away = (beside(one, other, paths).distance - radius[:, None]).min(axis=0)  # [MOST * CANDIDATES, T]
    reach = candidates.size[:, 0] + jnp.where(candidates.kind == Shape.CAPSULE, candidates.size[:, 1], 0.0)
    last = times > times[-1] - LAST
    fits = away.min(axis=1) < 0.0
    fits &= away[:, 0] > CLEAR * scale + AHEAD * setup.rules.body_speed
    fits &= jnp.where(last, away, jnp.inf).min(axis=1) > CLEAR * scale
    fits &= (paths.position[..., 2].min(axis=1) - reach) > robot.table_top
    fits = fits.reshape(MOST, CANDIDATES)
    chosen = jnp.arange(MOST) * CANDIDATES + fits.argmax(axis=1)
    return jax.tree.map(lambda x: x[chosen], candidates), fits.any(axis=1)


def _candidates(setup: TaskSetup, key: Array, way: Segments, times: np.ndarray) -> Bodies:
    """Bodies that are on a capsule of the arm, which go as `way`, at a random time."""
    count, scale, speed = MOST * CANDIDATES, setup.robot.scale, setup.rules.body_speed
    keys = jax.random.split(key, 8)
    start, end, _ = moving(setup.robot.capsules, way)
    links = start[0].shape[0]
    which = jax.random.randint(keys[0], (count,), 0, links)
    when = jax.random.uniform(keys[1], (count,), minval=MEETS[0], maxval=MEETS[1])
    instant = jnp.minimum((when / INSTANT).astype(jnp.int32), len(times) - 1)
    along = jax.random.uniform(keys[2], (count, 1))
    a, b = (jnp.stack([x[which, instant] for x in side], axis=-1) for side in (start, end))
    place = a + along * (b - a) + OFF * scale * jax.random.normal(keys[3], (count, 3))
    direction = jax.random.normal(keys[4], (count, 3)) * np.array([1.0, 1.0, LEVEL], np.float32)
    velocity = speed * direction / jnp.linalg.norm(direction, axis=-1, keepdims=True)
    turn, share = jax.random.normal(keys[5], (count, 4)), jax.random.uniform(keys[6], (count, 2))
    ball = jax.random.bernoulli(keys[7], shape=(count,))

    thick = jnp.where(ball, between(RADIUS, share[:, 0], scale), between(THIN, share[:, 0], scale))
    long = jnp.where(ball, 0.0, between(LONG, share[:, 1], scale))
    return Bodies(
        position=place - when[:, None] * velocity,
        quaternion=turn / jnp.linalg.norm(turn, axis=-1, keepdims=True),
        velocity=jnp.concatenate([velocity, jnp.zeros_like(velocity)], axis=-1),
        size=jnp.stack([thick, long, jnp.zeros_like(thick)], axis=-1),
        kind=jnp.where(ball, int(Shape.BALL), int(Shape.CAPSULE)),
    )


def _evaded(setup: TaskSetup, key: Array, goal: Array, bodies: Bodies, times: np.ndarray) -> Array:
    """Whether an arm in some posture near that at the goal is free of the paths of bodies `[K]`."""
    robot, chain = setup.robot, setup.robot.chain
    away = jax.random.uniform(key, (POSTURES, chain.n), minval=-WIDE, maxval=WIDE)
    at = capsules_at(chain, robot.capsules, jnp.clip(goal + away, jnp.array(chain.lower), jnp.array(chain.upper)))
    start, end = (tuple(x[:, :, None, None] for x in side) for side in at)
    radius = np.array(robot.capsules.radii, np.float32)[:, None, None, None]
    away = (beside(start, end, _over(bodies, times)).distance - radius).min(axis=(0, 2, 3))
    return (free_at(robot.capsules, at) & (away > CLEAR * robot.scale)).any()


def _over(bodies: Bodies, times: np.ndarray) -> Bodies:
    """Bodies `[K, T]` at times `[T]` of those `[K]` at the begin."""
    each = jax.tree.map(lambda x: jnp.broadcast_to(x[:, None], (len(x), len(times), *x.shape[1:])), bodies)
    return replace(each, position=each.position + times[:, None] * each.velocity[..., :3])
