"""A motion for an arm among bodies: to any branch of its goal, by a short path, as fast as its joints may."""

from __future__ import annotations

import time

import numpy as np

from reachlab.control.planning.arm import Arm
from reachlab.control.planning.collision import CollisionChecker
from reachlab.control.planning.following import Trajectory
from reachlab.control.planning.search import Search
from reachlab.control.planning.timing import ahead, smoothed, timed

NEAREST = 4
"""Branches that are reached soonest: to them a path is looked for first."""

SECONDS = 0.1, 0.3, 0.3, 0.6
"""Times in which a path has to be found [s]: to those and the goal whose joints are known, to any, to that one alone,
and to any again."""

TRIES = 2
"""Paths of which the shorter is taken: the second costs 15 ms, and saves 0.1 to 0.6 s of motion."""

CLEAR, OWN = 0.014, 0.003
"""Least distances on a path from bodies and the table, in proportion to the arm's workspace, and of links from each
other [m]; or what there is at its ends."""

KEPT = 0.9
"""Share of them that is kept on the smooth motion along it."""

COARSE = 0.05
"""Distance between the points of a path that have to be free [rad]: the motion along it is looked at in every step."""

TOUCHING = 1e-3
"""Distance by which an arm that touches a body may be in it at its start [m]; from deeper there is no way."""

ROUNDING = 1e-4
"""Distance by which the same point may seem nearer when it is computed again [m]."""

SPEED, ACCELERATION = 0.95, 0.9
"""Shares of the joints' limits that a motion uses: servos need the rest to follow it."""

STRAIGHT = 2
"""Joint vectors on a straight path."""

HALVINGS = 3
"""Times that the parts of a path are halved until the smooth motion along it is free."""

SLOWER = 0.75
"""Share of the speed that is kept each time, where an arm that follows late leaves its path the further the faster."""


class Planner:
    """Plans motions of an arm.

    Attributes:
        checker: it says where the arm is free; bodies are placed by it.
    """

    def __init__(self, checker: CollisionChecker, arm: Arm) -> None:
        """Of an arm.

        Raises:
            ModuleNotFoundError: OMPL is not installed.
        """
        self.checker, self._arm = checker, arm
        self._search = Search(checker, arm.lower, arm.upper, COARSE)
        self._clear = CLEAR * arm.scale
        self._speed, self._acceleration = SPEED * arm.speed, ACCELERATION * arm.acceleration

    def margins(self, start: np.ndarray, goal: np.ndarray) -> None:
        """Ask for the distances that a path keeps from joints `start [n]` to `goal [n]`, if that can be free at all."""
        begun, ended = (np.array(self.checker.distances(q)) - ROUNDING for q in (start, goal))
        # From deeper one body about the arm would open the way through every other.
        begun[0] = max(begun[0], -TOUCHING)
        outside, own = np.minimum(np.minimum((self._clear, OWN), begun), np.maximum(ended, 0.0))
        self._least = float(outside), float(own)
        self.checker.keep(*self._least)

    def motion(self, start: np.ndarray, goals: np.ndarray, known: np.ndarray) -> Trajectory | None:
        """A motion from `start [n]` to one of `goals [g, n]`, after `margins`; None if none is found.

        The goals that are reached soonest come first; one of them may be `known [n]` to have a way.
        """
        first = np.vstack([goals[:NEAREST], known])
        for attempt, (some, limit) in enumerate(zip((first, goals, known[None], goals), SECONDS, strict=True)):
            paths: list[np.ndarray] = []
            while len(paths) < TRIES and not any(len(one) == STRAIGHT for one in paths):
                ends, seed = time.monotonic() + limit, TRIES * attempt + len(paths)
                path = self._search.path(start, some, lambda ends=ends: time.monotonic() > ends, seed=seed)
                if path is None:
                    break
                paths.append(path)
            for path in sorted(paths, key=lambda path: duration(path, self._speed)):
                if (motion := self._along(path)) is not None:
                    return motion
        return None

    def _along(self, path: np.ndarray) -> Trajectory | None:
        """The motion along a path, which it follows the closer until it is free; None if it does not come to be."""
        pace = 1.0
        for _ in range(HALVINGS + 1):
            motion = self._timed(path, pace)
            if motion is not None and self.leads(motion):
                return motion
            middle = (path[:-1] + path[1:]) / 2
            path = np.insert(path, np.arange(1, len(path)), middle, axis=0)
            pace *= SLOWER if self._arm.smooth else 1.0
        return None

    def _timed(self, path: np.ndarray, pace: float) -> Trajectory | None:
        """The motion along a path at a share of the joints' speeds, as they follow it."""
        arm = self._arm
        found = timed(path, pace * self._speed, self._acceleration, arm.period)
        if found is None or not arm.smooth:
            return found and ahead(*found, arm.lag)
        steps = max(round(arm.smooth / arm.period), 1)
        return smoothed(found[0], steps, arm.share)

    def leads(self, motion: Trajectory, first: int = 0) -> bool:
        """Whether a motion is free from its step `first` on."""
        self.checker.keep(*(KEPT * least for least in self._least))
        free = all(self.checker.free(q) for q in motion.q[first:])
        self.checker.keep(*self._least)
        return free


def duration(path: np.ndarray, speed: np.ndarray) -> float:
    """Time that a path `[k, n]` takes where one joint is always at its full speed, of `[n]` [s]."""
    return float((np.abs(np.diff(path, axis=0)) / speed).max(axis=1).sum())
