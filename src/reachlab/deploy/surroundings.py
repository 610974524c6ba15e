"""What is known of an episode beside the arm, as numbers and as a controller is told: the goal, and the bodies."""

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

ASIDE = {"obstacles": [{"position": [0.0, 0.6, 0.1], "half": [0.05, 0.05, 0.1]}]}
"""A small body at the arm's side, as a controller is told of it."""


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


def step_arguments(facts: Mapping[str, Any], numbers: np.ndarray) -> dict[str, Any]:
    """What a controller is told and asked, by the names of `Controller.step`, of what `surroundings` gives `[l]`.

    Args:
        facts: what the `policy.json` of its folder says of its `goal` and its `objects`.
        numbers: the environment's.

    Raises:
        InputError: the environment is not one of the policy's task.
    """
    goal = facts["goal"]
    place, velocity, rest = np.split(numbers, np.cumsum([7 if goal["orientation"] else 3, 3 * goal["moves"]]))
    if rest.size % ENDS[-1]:
        raise InputError("the environment asks for other goals than the policy's: give it the exported folder as task.")
    rows = [np.split(row, ENDS[:-1]) for row in rest.reshape(-1, ENDS[-1]) if row[2] > FAR[2] / 2]
    bodies = [dict(zip(BODY, (part.tolist() for part in row), strict=True)) for row in rows]
    bodies = [body | {"radius": body["radius"][0]} for body in bodies]
    fixed = len(bodies) - len(facts["objects"])
    known = {"goal": place.tolist(), "obstacles": bodies[:fixed]}
    if bodies[fixed:]:  # of which controllers of earlier exports know nothing
        known["objects"] = bodies[fixed:]
    return known | ({"velocity": velocity.tolist()} if goal["moves"] else {})
