"""Terms of the observation from which ways among furniture are told: all of them follow from where the joints are."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.situation import Situation
from reachlab.tasks.schema import Term
from reachlab.tasks.task import Bounds, TaskSetup
from reachlab.tasks.terms import ARM, GOAL, JOINT_WAY, TOOL, axes, within

THICK = 0.2
"""Half side or radius that stands for 1, in proportion to the arm's workspace [m]; of a place it is 1 m."""

LARGEST = 100.0
"""No number of a body is larger."""

ROW = 14
"""Numbers of a body: whether it is there, its place, half sides, radius and first two axes."""


def _bodies(setup: TaskSetup, now: Situation) -> Array:
    """Each body in a row, `[B, K · ROW]`; zeros of one that is not there."""
    there, scale = now.bodies.present[..., None], setup.robot.scale
    parts = (
        jnp.ones_like(now.bodies.position[..., :1]),
        now.bodies.position / scale,
        now.bodies.half / (THICK * scale),
        now.bodies.radius[..., None] / (THICK * scale),
        axes(now.bodies.quaternion),
    )
    row = jnp.where(there, jnp.concatenate(parts, axis=-1), 0.0)
    return jnp.clip(row, -LARGEST, LARGEST).reshape(len(now.q), -1)


def _bodies_bounds(setup: TaskSetup) -> Bounds:
    return within(np.full(ROW * setup.task.scene(setup).bodies, LARGEST))


BODIES = Term("bodies", "1", _bodies, _bodies_bounds, row=ROW)

WAYS = (ARM[0], TOOL, GOAL, JOINT_WAY, BODIES)
"""The joints, where they have to be, and the bodies: without speeds, so that every state of a planned way is one to
learn from. How near bodies are to each link follows from these; where that was observed too, the headings learnt were
further off in other scenes."""
