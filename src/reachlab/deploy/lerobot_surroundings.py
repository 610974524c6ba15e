"""What LeRobot is told of an episode beside the arm, as numbers: the goal, and the bodies that are there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from reachlab.control.bodies import FAR, Bodies
from reachlab.control.situation import Goal
from reachlab.settings.validation import InputError

BODY = {"position": 3, "quaternion": 4, "half": 3, "radius": 1, "velocity": 3}
"""What is told of each body beside the arm, and in how many numbers."""

ENDS = np.cumsum(list(BODY.values()))
"""Where the parts end in the numbers of a body."""


def surroundings(goal: Goal, bodies: Bodies) -> np.ndarray:
    """Numbers `[B, l]` of goals and of bodies `[B, K]`.

    The goal's position [m], its quaternion wxyz and its velocity [m/s] where the task has them, and `BODY` of each body
    beside the arm, the object last.
    """
    known: list[Any] = [goal.position, goal.quaternion, goal.velocity]
    if bodies.kind.size:  # what JAX computes of nothing takes time too
        velocity = bodies.velocity[..., :3]
        parts = [bodies.position, bodies.quaternion, bodies.half, bodies.radius[..., None], velocity]
        known.append(np.concatenate(parts, axis=-1).reshape(len(bodies.kind), -1))
    return np.concatenate(known, axis=1).astype(np.float32)


def told(facts: Mapping[str, Any], numbers: np.ndarray) -> dict[str, Any]:
    """What a controller is asked, by the names of `Controller.step`, of an `environment_state [k]`.

    Args:
        facts: what the `policy.json` of its folder says.
        numbers: the environment's.

    Raises:
        InputError: the environment is not one of the policy's task.
    """
    goal = facts["goal"]
    place, velocity, rest = np.split(numbers, np.cumsum([7 if goal["orientation"] else 3, 3 * goal["moves"]]))
    if rest.size % ENDS[-1]:
        raise InputError("the environment asks for other goals than the policy's: give it the exported folder as task.")
    rows = [np.split(row, ENDS[:-1]) for row in rest.reshape(-1, ENDS[-1]) if row[2] > FAR[2] / 2]
    bodies = [dict(zip(BODY, (*row[:3], row[3][0], row[4]), strict=True)) for row in rows]
    fixed = len(bodies) - len(facts["objects"])
    asked = {"goal": place, "obstacles": bodies[:fixed], "objects": bodies[fixed:]}
    return asked | ({"velocity": velocity} if goal["moves"] else {})
