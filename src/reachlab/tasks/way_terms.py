"""Terms of observations from which ways among furniture are told: all of them follow from where the joints are."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.situation import Situation
from reachlab.tasks.schema import Term
from reachlab.tasks.task import Bounds, TaskSetup
from reachlab.tasks.terms import ARM, CLEARANCE, GOAL, JOINT_WAY, TOOL, clearance, scene, within

SHARES = (0.25, 0.5, 0.75, 1.0)
"""Shares of the straight way to the goal's joints at which it is looked how near bodies are."""

FINE = 6
"""Points of the grid in a row: boards of a shelf lie between those of a coarser one."""


def _clearance_ahead(setup: TaskSetup, now: Situation) -> Array:
    """The clearance that the arm would have at `SHARES` of the straight way to the goal's joints."""
    way, count = now.goal.joints - now.q, len(SHARES)
    there = now._replace(
        q=jnp.concatenate([now.q + share * way for share in SHARES]),
        bodies=jax.tree.map(lambda x: jnp.concatenate([x] * count), now.bodies),
    )
    return jnp.concatenate(jnp.split(clearance(setup, there), count), axis=-1)


def _ahead_bounds(setup: TaskSetup) -> Bounds:
    return within(np.ones(3 * len(SHARES) * np.count_nonzero(setup.robot.capsules.links)))


AHEAD = Term("clearance_ahead", "1", _clearance_ahead, _ahead_bounds)

SCENE = Term(
    "scene_fine",
    "1",
    lambda setup, now: scene(setup, now, FINE),
    lambda _: (np.zeros(FINE**3, np.float32), np.ones(FINE**3, np.float32)),
)

WAYS = (ARM[0], TOOL, GOAL, JOINT_WAY, CLEARANCE, AHEAD, SCENE)
"""The joints, where they have to be, and the bodies here and on the straight way: without speeds, so that every state
of a planned way is one to learn from."""
