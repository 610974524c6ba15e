"""The goal of a controller: taken as it is given, refused where it cannot be one, and the joints that it needs."""

from __future__ import annotations

from typing import Any

import numpy as np

from reachlab.deploy.onboard.arm import Arm, quaternion_of
from reachlab.deploy.onboard.deciding import Goal
from reachlab.deploy.onboard.reading import in_words
from reachlab.deploy.onboard.scene import UNIT
from reachlab.deploy.onboard.solving import Solver

SOLVED_A_STEP = 4
"""Steps that the solver of a goal's joints takes in a control step."""

NEARBY = 0.1
"""How far outside the box of the goals that were trained a goal may be [m]."""


class Aim:
    """What the tool is asked to do.

    Attributes:
        goal: the goal; None where there is none, or its joints are still looked for.
        box: lower and upper corner `[2, 3]` of the goals that were trained [m].
        poses: goals are poses.
    """

    def __init__(self, arm: Arm, facts: dict[str, Any]) -> None:
        """Of an arm, and a policy's facts about its goals."""
        self._arm, self._facts, self.poses = arm, facts, bool(facts["orientation"])
        self.box = np.array([facts["low"], facts["high"]], float)
        self.clear()

    def clear(self) -> None:
        """Have no goal."""
        self.goal: Goal | None = None
        self._asked: tuple[Any, ...] | None = None
        self._solver: Solver | None = None
        self._time = 0.0

    def take(self, goal: Any, time: float, velocity: Any, joints: Any, near: np.ndarray) -> str:
        """Take a goal, and give why it is refused, if it is.

        Args:
            goal: numbers as `read_numbers` gives them, or None.
            time: of this control step [s].
            velocity: of the goal, likewise.
            joints: at which the tool is there, likewise.
            near: joints `[n]` next to which others are looked for.
        """
        if goal is None:
            self.goal = self._asked = None
            return ""
        joints = joints if self._facts["joints"] else None
        if wrong := self._wrong(goal, velocity, joints):
            return wrong
        if self._facts["moves"]:
            known = self._seen_velocity(goal[:3], time) if velocity is None else velocity
            self.goal, self._time = Goal(goal[:3], velocity=known), time
            return ""
        asked = (*goal.tolist(), None if joints is None else tuple(joints.tolist()))
        if asked != self._asked:
            self._asked, self._solver = asked, None
            self.goal = self._set(goal, joints, near)
        return self._look_for_joints()

    def _wrong(self, goal: Any, velocity: Any, joints: Any) -> str:
        wanted = {
            "goal": (goal, 7 if self.poses else 3),
            "goal's velocity": (velocity, 3),
            "goal's joints": (joints, self._arm.n),
        }
        for name, (numbers, size) in wanted.items():
            if isinstance(numbers, str):
                return f"the {name} must be {size} finite numbers, and is {numbers}"
            if numbers is not None and (numbers.shape != (size,) or not np.isfinite(numbers).all()):
                return f"the {name} must be {size} finite numbers, got {in_words(numbers)}"
        low, high = self.box
        if (goal[:3] < low - NEARBY).any() or (goal[:3] > high + NEARBY).any():
            return f"the goal {in_words(goal[:3])} is out of the workspace, {in_words(low)} to {in_words(high)} m"
        if self.poses and abs(np.linalg.norm(goal[3:]) - 1) > UNIT:
            return f"the goal's quaternion must have length 1, got {in_words(goal[3:])}"
        return ""

    def _set(self, goal: np.ndarray, joints: np.ndarray | None, near: np.ndarray) -> Goal | None:
        """The goal, or None where its joints have to be looked for."""
        if not self._facts["joints"]:
            return Goal(goal[:3])
        if joints is not None:
            return self._goal_at(joints)
        turned = Goal(goal[:3], goal[3:] / np.linalg.norm(goal[3:])).rotation if self.poses else None
        self._solver = Solver(self._arm, goal[:3], turned, near.copy())
        return None

    def _seen_velocity(self, place: np.ndarray, time: float) -> np.ndarray:
        """Velocity `[3]` m/s of a goal that is now at `[3]` m; nothing of one that has jumped."""
        last, passed = self.goal, time - self._time
        if last is None or passed <= 0:
            return np.zeros(3)
        velocity = (place - last.position) / passed
        return velocity if np.sqrt(velocity @ velocity) <= self._facts["fastest"] else np.zeros(3)

    def _look_for_joints(self) -> str:
        solver = self._solver
        if solver is None or self.goal is not None:
            return ""
        solver.advance(SOLVED_A_STEP)
        if not solver.ended:
            return ""
        if solver.joints is None:
            return "the goal is out of reach: no joints are found at which the tool is there"
        self.goal = self._goal_at(solver.joints)
        return ""

    def _goal_at(self, joints: np.ndarray) -> Goal:
        """The goal that the tool is at with joints `[n]`."""
        frames = self._arm.frames(joints)
        turned = quaternion_of(frames.rotation) if self.poses else None
        return Goal(frames.position, turned, joints=joints)
