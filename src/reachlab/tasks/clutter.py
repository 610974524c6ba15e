"""Holding a point among obstacles, without touching anything."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.robots.inverse_kinematics import ik_point_step
from reachlab.robots.kinematics import forward_kinematics
from reachlab.settings.rules import Rules
from reachlab.tasks.reach import PRECISE
from reachlab.tasks.scenes import sample_scene
from reachlab.tasks.targets import Drawn, first_reached
from reachlab.tasks.task import Goal, TaskSetup

ITERATIONS, LONGEST_STEP = 40, 0.1
"""Steps of the solver, and largest displacement of the tool in one [m]; those that arrive do so in about fifteen."""

NEAR = 1e-4
"""Distance of the tool from a point at which joints count as having it [m]."""


def joints_at(setup: TaskSetup, point: Array) -> tuple[Array, Array]:
    """Joints `[n]` near home that have a point `[3]` m; and if any were found."""
    chain = setup.robot.chain

    def step(_: int, q: Array) -> Array:
        way = point - forward_kinematics(chain, q).position
        way *= jnp.minimum(LONGEST_STEP / (jnp.linalg.norm(way) + NEAR), 1.0)
        return q + ik_point_step(chain, q, q, way)

    q = jax.lax.fori_loop(0, ITERATIONS, step, jnp.array(setup.robot.home))
    return q, jnp.linalg.norm(forward_kinematics(chain, q).position - point) < NEAR


def _sample_goal(setup: TaskSetup, key: Array) -> Goal:
    """A point of the box, and joints near home that have it, in which the arm touches neither itself nor the table."""

    def draw(key: Array) -> Drawn:
        key, now = jax.random.split(key)
        return Drawn(key, *joints_at(setup, PRECISE.sample_goal(setup, now).position), jnp.zeros((), jnp.int32))

    found = first_reached(draw, setup, key)
    return Goal(found.position, joints=found.joints)


def _asks(rules: Rules, period: float) -> str:
    fewest, most = rules.obstacles
    return f"{PRECISE.asks(rules, period)}; there are {fewest} to {most} obstacles, and nothing may be touched"


def _succeeds(rules: Rules, period: float) -> str:
    return f"{PRECISE.succeeds(rules, period)}, and the arm has touched nothing"


CLUTTER = replace(
    PRECISE,
    sample_goal=_sample_goal,
    sample_obstacles=lambda setup, key, start, goal: sample_scene(setup, key, start, goal.joints),
    asks=_asks,
    succeeds=_succeeds,
)
"""The flange is held at a point among obstacles."""
