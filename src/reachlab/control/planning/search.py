"""A path for an arm among bodies, by random sampling."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from reachlab.control.planning.collision import RESOLUTION, CollisionChecker


class Search:
    """Looks for paths that a checker calls free.

    By RRT-Connect (Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000).

    Attributes:
        checker: it says where the arm is free.
    """

    def __init__(
        self, checker: CollisionChecker, lower: np.ndarray, upper: np.ndarray, resolution: float = RESOLUTION
    ) -> None:
        """Of an arm whose joints have these limits `[n]`, looked at in points so far apart [rad].

        Raises:
            ModuleNotFoundError: OMPL is not installed.
        """
        from ompl import base, geometric, util

        util.setLogLevel(util.LogLevel.LOG_NONE)
        self._base, self._geometric, self._util = base, geometric, util
        self.checker, self._limits, self._resolution = checker, np.array([lower, upper]), resolution

    def path(
        self, start: np.ndarray, goals: np.ndarray, given_up: Callable[[], bool], *, short: bool = True, seed: int = 0
    ) -> np.ndarray | None:
        """Joint vectors `[k, n]` from `start [n]` to one of `goals [g, n]`, straight in between; None if none is found.

        The first goal to which the way is straight is taken. Otherwise it is looked for until it is `given_up` and, if
        it is to be, made `short`; its random numbers are those of a `seed`, whatever was before.
        """
        goals = np.array([goal for goal in goals if self.checker.free(goal)])
        if not len(goals) or not self.checker.free(start):
            return None
        for goal in goals:
            if self.checker.straight(start, goal, self._resolution):
                return np.stack([start, goal]).astype(float)
        base, n = self._base, len(start)
        self._util.RNG.setSeed(seed + 1)
        space, bounds, ends = base.RealVectorStateSpace(n), base.RealVectorBounds(n), np.vstack([start, goals])
        low, high = np.minimum(self._limits[0], ends.min(axis=0)), np.maximum(self._limits[1], ends.max(axis=0))
        for joint in range(n):
            bounds.setLow(joint, float(low[joint]))
            bounds.setHigh(joint, float(high[joint]))
        space.setBounds(bounds)
        information = base.SpaceInformation(space)
        task = self._geometric.SimpleSetup(information)
        task.setStateValidityChecker(lambda state: self.checker.free(_joints(state, n)))
        information.setMotionValidator(self._motions(information, n))
        task.setStartState(_state(space, start))
        targets = base.GoalStates(information)
        for goal in goals:
            targets.addState(_state(space, goal))
        task.setGoal(targets)
        task.setPlanner(self._geometric.RRTConnect(information))
        task.solve(base.PlannerTerminationCondition(given_up))
        if not task.haveExactSolutionPath():
            return None
        path = task.getSolutionPath()
        if short:  # in half the time, and a tenth shorter, than by `simplifySolution`
            shortcuts = self._geometric.PathSimplifier(information)
            shortcuts.ropeShortcutPath(path)
            shortcuts.partialShortcutPath(path)
        return np.stack([_joints(state, n) for state in path.getStates()])

    def _motions(self, information: Any, n: int) -> Any:
        straight, resolution = self.checker.straight, self._resolution

        class Motions(self._base.MotionValidator):
            def checkMotion(self, one: Any, other: Any, *_: Any) -> bool:  # noqa: N802 (OMPL's name)
                return straight(_joints(one, n), _joints(other, n), resolution)

        return Motions(information)


def _joints(state: Any, n: int) -> np.ndarray:
    return np.array([state[joint] for joint in range(n)])


def _state(space: Any, q: np.ndarray) -> Any:
    state = space.allocState()
    for joint, value in enumerate(q):
        state[joint] = float(value)
    return state
