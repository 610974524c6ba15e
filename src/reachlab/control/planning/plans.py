"""Plans for the goals of an arm among bodies, and the commands that follow them."""

from __future__ import annotations

import time
from typing import Any

import mujoco
import numpy as np

from reachlab.control.planning.arm import Arm
from reachlab.control.planning.branches import branches, free_branches
from reachlab.control.planning.collision import CollisionChecker
from reachlab.control.planning.following import Trajectory
from reachlab.control.planning.planner import Planner

TILTED = (3, 0.35), (24, 2.0)
"""Where any orientation of the tool will do, poses beside the goal's own to which is planned, and how far they are
turned about each axis at random [rad]; and the same again where there is no way to them."""

BRIEF = 18
"""Steps in which the joints of a goal are looked for: with more of them a few are found, and motions get no shorter."""

NUDGE = 0.01
"""Length of a first motion [rad]."""


class Plans:
    """Plans motions for an arm.

    Attributes:
        seconds: time that the last plan took.
    """

    def __init__(self, arm: Arm, count: int, *, turns: bool) -> None:
        """Of an arm among `count` bodies at most, whose goals ask for an orientation, or do not.

        Raises:
            ModuleNotFoundError: OMPL or TOPP-RA is not installed.
        """
        self._arm, self._turns, self.checker = arm, turns, CollisionChecker(arm, count)
        self._planner = Planner(self.checker, arm)
        self._motion(arm.home, arm.home + NUDGE)  # what it needs is imported before time counts

    def plan(self, bodies: Any, start: np.ndarray, goal: np.ndarray) -> Trajectory | None:
        """A motion among bodies `[K]` from joints `start [n]` to where the tool is at joints `goal [n]`."""
        begun = time.perf_counter()
        self.checker.place(bodies)
        motion = self._motion(start, goal)
        self.seconds = time.perf_counter() - begun
        return motion

    def _motion(self, start: np.ndarray, goal: np.ndarray) -> Trajectory | None:
        for count, tilt in ((0, 0.0),) if self._turns else TILTED:
            self._planner.margins(start, goal)
            goals, known = self._goals(start, goal, count, tilt), goal
            if len(goals) and not self.checker.free(goal):  # another has to be, by as much as it can
                known = max(goals, key=lambda q: min(self.checker.distances(q)))
                self._planner.margins(start, known)
            if (motion := self._planner.motion(start, goals, known)) is not None:
                return motion
        return None

    def free(self, joints: np.ndarray, bodies: Any) -> bool:
        """Whether the arm is free at joints `[T, n]` among bodies `[K]`, by as much as a motion has to be."""
        self.checker.place(bodies)
        self._planner.margins(joints[0], joints[-1])
        return all(self.checker.free(q) for q in joints)

    def leads(self, motion: Trajectory, first: int, bodies: Any) -> bool:
        """Whether a motion is still free from its step `first` on, now that bodies `[K]` are elsewhere."""
        self.checker.place(bodies)
        self._planner.margins(motion.q[min(first, len(motion.q) - 1)], motion.q[-1])
        return self._planner.leads(motion, first)

    def _goals(self, start: np.ndarray, goal: np.ndarray, count: int, tilt: float) -> np.ndarray:
        """Free joint vectors `[g, n]` that have the goal: of its pose, and of so many that are turned."""
        if self._turns and not self._arm.poses:  # so few joints have it in no other way
            return goal[None]
        rng, tool = np.random.default_rng(0), self._arm.links_at(goal)[-1]
        turns = rng.normal(0.0, tilt, (count, 3))
        rotation = np.stack([tool[:3, :3], *(_turned(turn) @ tool[:3, :3] for turn in turns)])
        found = branches(self._arm, np.tile(tool[:3, 3], (len(rotation), 1)), rotation, rng, BRIEF)
        return free_branches(self.checker, self._arm, np.concatenate([goal[None], *found]), start)


def _turned(angles: np.ndarray) -> np.ndarray:
    """The rotation `[3, 3]` about the axes of the world by angles `[3]` rad, less where they are large."""
    quaternion, rotation = np.array([1.0, *(angles / 2)]), np.zeros(9)
    mujoco.mju_quat2Mat(rotation, quaternion / np.linalg.norm(quaternion))
    return rotation.reshape(3, 3)
