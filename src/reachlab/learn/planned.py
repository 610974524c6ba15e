"""The teacher of an imitation: planned ways, and what is to be learnt from one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from numpy.random import Generator

from reachlab.control.bodies import Bodies
from reachlab.control.contact_model import arm_of
from reachlab.control.planning.collision import CollisionChecker
from reachlab.control.planning.planner import TRIES, Planner
from reachlab.control.planning.search import Search
from reachlab.envs.core import Env
from reachlab.settings.validation import InputError, installing
from reachlab.tasks.actions import AHEAD
from reachlab.tasks.scenes.bank import Bank, drawn_scenes
from reachlab.tasks.scenes.sampling import drawn_anew, room

LESSONS = 24
"""Joint vectors of a way that are learnt from: the first, and random ones."""

ASIDE = 0.03
"""Standard deviation of how far aside of the way half of these are put, to learn to come back to it [rad]."""

ROUNDS = 1000
"""Rounds of a search after which none is found."""


class Lesson(NamedTuple):
    """Joints on a way `[P, n]` and headings there, and the goal that it leads to: its place [m] and joints `[n]`."""

    q: np.ndarray
    heading: np.ndarray
    position: np.ndarray
    joints: np.ndarray


class Teacher:
    """Plans ways to the joints at goals, and tells what headings they have."""

    def __init__(self, env: Env) -> None:
        """Of the arm of an environment.

        Raises:
            InputError: OMPL is not installed, or scenes are drawn as episodes begin.
        """
        setup = env.setup
        scene = setup.task.scene(setup)
        if drawn_anew(setup.rules.scene):
            raise InputError("an action 'heading' is learnt among furniture: choose --scene wall, or another.")
        self._setup, self._arm = setup, arm_of(setup.robot, setup.lag, setup.period)
        checker = CollisionChecker(self._arm, scene.bodies)
        try:
            self._planner = Planner(checker, self._arm)
            self._search = Search(checker, self._arm.lower, self._arm.upper)
        except ModuleNotFoundError:
            raise InputError(f"an action 'heading' is learnt from OMPL's plans: {installing('planner')}.") from None

    def fresh(self, count: int, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray, Bodies]]:
        """So many scenes of the task's kinds that are in no bank: joints at start and goal, and bodies."""
        names = self._setup.rules.scene
        for name in names:
            drawn = drawn_scenes(self._setup.robot, name, count // len(names), seed)
            start, joints, bodies = zip(*drawn, strict=True)
            together: Bodies = jax.tree.map(lambda *rows: np.stack(rows), *bodies)
            bank = Bank(np.array(start), np.array(joints), together).with_room(room(self._setup))
            yield from (jax.tree.map(lambda x, row=row: x[row], tuple(bank)) for row in range(len(start)))

    def lessons(self, bodies: Bodies, start: np.ndarray, goal: np.ndarray, rng: Generator) -> Iterator[Lesson]:
        """Those of a way from `start [n]` to `goal [n]`, and of the way back; none where no way is found."""
        start, goal = start.astype(float), goal.astype(float)
        if np.linalg.norm(goal - start) > AHEAD and (path := self._path(bodies, start, goal, rng)) is not None:
            yield self._lesson(path, rng)
            yield self._lesson(path[::-1], rng)

    def _lesson(self, path: np.ndarray, rng: Generator) -> Lesson:
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
        places = np.append(0.0, rng.uniform(0.0, along[-1], LESSONS - 1))

        def at(places: np.ndarray) -> np.ndarray:
            return np.stack([np.interp(places, along, joint) for joint in path.T], axis=1)

        aside = rng.normal(0.0, ASIDE, (LESSONS, path.shape[1]))
        aside[: LESSONS // 2] = 0.0
        q = at(places) + aside
        return Lesson(q, (at(places + AHEAD) - q) / AHEAD, self._arm.links_at(path[-1])[-1, :3, 3], path[-1])

    def _path(self, bodies: Bodies, start: np.ndarray, goal: np.ndarray, rng: Generator) -> np.ndarray | None:
        """The sooner of two ways `[k, n]`."""
        self._planner.checker.place(bodies)
        self._planner.margins(start, goal)
        paths = []
        for seed in rng.integers(2**30, size=TRIES).tolist():
            rounds = iter(range(ROUNDS))
            path = self._search.path(start, goal[None], lambda rounds=rounds: next(rounds, None) is None, seed=seed)
            paths += [] if path is None else [path]
        return min(paths, key=self._time, default=None)

    def _time(self, path: np.ndarray) -> float:
        """Time that a path takes where one joint is always at its full speed [s]."""
        return float((np.abs(np.diff(path, axis=0)) / self._arm.speed).max(axis=1).sum())
