"""In which episodes nothing is in the way: a figure over those alone tells little of avoiding."""

from __future__ import annotations

from collections.abc import Callable

import jax
import numpy as np

from reachlab.control.contact_model import arm_of
from reachlab.control.planning.collision import CollisionChecker
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState


def make_straight(env: Env) -> Callable[[EnvState], np.ndarray] | None:
    """Function that tells in which of states nothing is in the way of joints that move straight to the goal's `[B]`.

    None where nothing is beside the arm, or joints at the goal are not known.
    """
    scene = env.setup.task.scene(env.setup)
    if not (scene.fixed and scene.contacts and "joints" in env.setup.rules.gives):
        return None
    checker = CollisionChecker(arm_of(env.setup.robot), scene.bodies)

    def straight(state: EnvState) -> np.ndarray:
        bodies, start, goal = jax.tree.map(np.asarray, (state.arm.bodies, state.arm.q, state.goal.joints))
        found = []
        for row in range(len(start)):
            checker.place(jax.tree.map(lambda x, row=row: x[row], bodies))
            found.append(checker.straight(start[row], goal[row]))
        return np.array(found)

    return straight
