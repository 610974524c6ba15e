"""Terms of the bodies beside the arm: how near they are, or each by its numbers."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import distance_from
from reachlab.control.dampers import surroundings
from reachlab.control.situation import Situation
from reachlab.tasks.schema import Term
from reachlab.tasks.task import Bounds, TaskSetup
from reachlab.tasks.terms import ARM, GOAL, JOINT_WAY, STATE, TOOL, axes, within

CLOSE, BASIS = 0.1, 4
"""Distance at which a body counts half as near as one that is touched [m], and points of the grid in a row."""

THICK = 0.2
"""Half side or radius that stands for 1, in proportion to the arm's workspace [m]; of a place it is 1 m."""

LARGEST = 100.0
"""No number of a body is larger."""

ROW = 14
"""Numbers of a body: whether it is there, its place, half sides, radius and first two axes."""


def _clearance(setup: TaskSetup, now: Situation) -> Array:
    """Of each moving capsule the direction away from what is nearest, shorter the further away, `[B, 3 C]`."""
    near = CLOSE * setup.robot.scale
    around = surroundings(setup.robot, now.q, now.bodies)
    close = near / (near + jnp.maximum(around.distance, 0.0))
    return jnp.concatenate([(close * x).T for x in around.normal], axis=-1)


def _clearance_bounds(setup: TaskSetup) -> Bounds:
    return within(np.ones(3 * np.count_nonzero(setup.robot.capsules.links)))


def _basis_points(setup: TaskSetup) -> np.ndarray:
    """Points `[BASIS³, 3]` m on a grid in the arm's goal box and around it."""
    low, high = np.array(setup.robot.goal_box)
    lines = [np.linspace(a, b, BASIS) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)


def _scene(setup: TaskSetup, now: Situation) -> Array:
    """Nearness `[B, BASIS³]` of bodies to points about the goals."""
    away = distance_from(now.bodies, _basis_points(setup))
    return CLOSE / (CLOSE + jnp.maximum(away / setup.robot.scale, 0.0))


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


CLEARANCE = Term("clearance", "1", _clearance, _clearance_bounds)

AROUND = (
    CLEARANCE,
    Term("scene", "1", _scene, lambda _: (np.zeros(BASIS**3, np.float32), np.ones(BASIS**3, np.float32))),
)
"""The bodies beside the arm.

These are observed by what is nearest to each capsule of the arm, which is what a policy must not touch, and by how near
they are to the points of a grid (Prokudin et al., "Efficient learning on point clouds with basis point sets", ICCV
2019), which tells ways round apart. Neither depends on their order, number or kind.
"""

CLUTTER = (*STATE, JOINT_WAY, *AROUND)
"""The same as `STATE`, how far the joints are from where they have the goal, and the bodies beside the arm."""

BODIES = Term("bodies", "1", _bodies, _bodies_bounds, row=ROW)

WAYS = (ARM[0], TOOL, GOAL, JOINT_WAY, BODIES)
"""The joints, where they have to be, and the bodies: without speeds, so that every state of a planned way is one to
learn from. How near bodies are to each link follows from these; where that was observed too, the headings learnt were
further off in other scenes."""
