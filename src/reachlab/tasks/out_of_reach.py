"""Goals on the table that the arm does not reach, and what slides to them."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.situation import Goal
from reachlab.tasks import objects
from reachlab.tasks.tabletop import reach_on_table
from reachlab.tasks.task import Bounds, Scene, TaskSetup

ASIDE = 0.3
"""Goals lie so far either way of the arm's front [rad]."""

GRIP = 0.6
"""Friction of the puck at the finger tips: it is the table that is smooth."""

SPREAD = 0.1
"""Where objects vary: relative spread of the friction, of which the controller knows the middle."""


def scene(setup: TaskSetup) -> Scene:
    """A puck that slides, and does not slip from the hand."""
    return replace(objects.scene(setup), grip=GRIP, friction_spread=(1 - SPREAD, 1 + SPREAD))


def goal_box(setup: TaskSetup) -> Bounds:
    """Corners `[3]` m of the box around all goals."""
    low, high = objects.goal_box(setup)
    far, front = reach_on_table(setup.robot) + setup.rules.beyond[1], setup.robot.front
    base, near = np.array(setup.robot.chain.frames[0][1], np.float32)[:2], far - np.ptp(setup.rules.beyond)
    ends = [(near, -ASIDE), (near, ASIDE), (far, -ASIDE), (far, 0.0), (far, ASIDE)]
    corners = np.array([(away * np.cos(front + angle), away * np.sin(front + angle)) for away, angle in ends])
    low[:2], high[:2] = base + corners.min(axis=0), base + corners.max(axis=0)
    return low, high


def sample_goal(setup: TaskSetup, key: Array) -> Goal:
    """A place on the table that the arm does not reach."""
    for_angle, for_distance = jax.random.split(key)
    low, high = setup.rules.beyond
    angle = setup.robot.front + jax.random.uniform(for_angle, minval=-ASIDE, maxval=ASIDE)
    away = reach_on_table(setup.robot) + jax.random.uniform(for_distance, minval=low, maxval=high)
    base, box = jnp.array(setup.robot.chain.frames[0][1]), objects.goal_box(setup)[0]
    return Goal.at(jnp.stack([base[0] + away * jnp.cos(angle), base[1] + away * jnp.sin(angle), jnp.array(box[2])]))
