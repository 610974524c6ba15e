"""What became of an object in an episode: whether it was moved at all, and whether it fell from the hand."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.kinematics.forward import norm
from reachlab.sims.simulator import SimState
from reachlab.tasks.task import TaskSetup

MOVED = 0.01
"""An object that has been so far from where it began was moved [m]."""

RAISED, LOOSE = 0.02, 0.01
"""An object that is so much above where it began, and whose middle is so much more than its size away from the tool, is
no longer held [m]: what is gripped keeps within 12 mm of it."""


class Handled(NamedTuple):
    """Of `B` episodes with an object: where it began `[B, 3]` [m], whether it was `moved` and `dropped` `[B]`."""

    begun: Array
    moved: Array
    dropped: Array

    def after(self, arm: SimState, setup: TaskSetup) -> Handled:
        """The same after a step, with the arm and the object as they are now."""
        place = arm.bodies.position[:, -1]
        raised = place[:, 2] > self.begun[:, 2] + RAISED
        loose = norm(place - arm.tool_position) > max(setup.task.scene(setup).size) + LOOSE
        return Handled(self.begun, self.moved | (norm(place - self.begun) > MOVED), self.dropped | (raised & loose))

    def shares(self) -> dict[str, float]:
        """Shares of the episodes, as NumPy arrays, in which the object was left alone and dropped."""
        return {"untouched": float(1 - np.mean(self.moved)), "dropped": float(np.mean(self.dropped))}


def begin_handling(arm: SimState, setup: TaskSetup) -> Handled | None:
    """Episodes in which nothing has happened to the object yet; None where there is none."""
    if not setup.task.scene(setup).objects:
        return None
    place = arm.bodies.position[:, -1]
    return Handled(place, jnp.zeros(len(place), bool), jnp.zeros(len(place), bool))
