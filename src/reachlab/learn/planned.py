"""The teacher of an imitation: planned ways, and what is to be learnt from one."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import numpy as np
from numpy.random import Generator

from reachlab.control.bodies import Bodies
from reachlab.control.contact_model import arm_of
from reachlab.control.planning.arm import Arm
from reachlab.control.planning.collision import CollisionChecker
from reachlab.control.planning.planner import CLEAR, ROUNDING, STRAIGHT, TRIES, duration
from reachlab.control.planning.search import Search
from reachlab.control.planning.workers import Workers
from reachlab.envs.core import Env
from reachlab.robots.robot import Robot
from reachlab.tasks.actions import AHEAD
from reachlab.tasks.scenes.bank import Bank, Finder

LESSONS = 24
"""Joint vectors of a way that are learnt from: the first, and random ones."""

FIRST = 1.0
"""Length of the beginning of a way from which half of these are [rad]."""

BESIDE, DRAWN = (0.1, 0.9), 24
"""How far from a goal joints are from which it cannot be reached straight [rad], and how many are drawn to find some.

Without ways from there a policy learns that the way to a goal that is near is straight, and stands where it is not.
"""

APART = 0.005
"""Least distance of links from each other on a way [m]: dampers keep 3 mm, and where they act an arm is slow."""

BACK, ROUND = (0.05, 0.1, 0.2, 0.4), 48
"""How far back joints are looked for that are as free as a way has to be [rad], and in how many directions."""

ASIDE = 0.03
"""Standard deviation of how far aside of the way half of these are put, to learn to come back to it [rad]."""

TEACHERS = 8
"""Processes that plan, at most."""

ROUNDS = 1000
"""Rounds of a search after which none is found."""


class Lesson(NamedTuple):
    """Joints on a way `[P, n]` and headings there, and the goal that it leads to: its place [m] and joints `[n]`."""

    q: np.ndarray
    heading: np.ndarray
    position: np.ndarray
    joints: np.ndarray


def teachers(env: Env) -> Workers:
    """Teachers for the arm of an environment, one a core."""
    setup = env.setup
    arm = arm_of(setup.robot, setup.lag, setup.period)
    return Workers(Teacher, setup.robot, arm, setup.task.scene(setup).bodies, most=TEACHERS)


class Asked(NamedTuple):
    """What is to be planned: scenes of a kind that are drawn, so many, and beside them ways from where arms are.

    Attributes:
        seed: from which all of it follows.
        kind: of scenes that are in no bank.
        scenes: how many of it, at least.
        arms: start `[n]`, goal `[n]` and bodies of each of the others.
    """

    seed: int
    kind: str
    scenes: int
    arms: Sequence[tuple[np.ndarray, np.ndarray, Bodies]]


class Teacher:
    """Plans ways to the joints at goals, and tells what headings they have."""

    def __init__(self, robot: Robot, arm: Arm, bodies: int) -> None:
        """Of an arm, and with room for so many bodies.

        Raises:
            ModuleNotFoundError: OMPL is not installed.
        """
        self._robot, self._arm, self._room = robot, arm, bodies
        self._checker = CollisionChecker(self._arm, bodies)
        self._search = Search(self._checker, self._arm.lower, self._arm.upper)

    def __call__(self, asked: Asked) -> list[tuple[Lesson, Bodies]]:
        """The lessons of all that is asked for, and the bodies of each."""
        rng = np.random.default_rng(asked.seed)
        scenes = [*self.fresh(asked.kind, asked.scenes, asked.seed)]
        beside = [(self.beside(bodies, goal, rng), goal, bodies) for _, goal, bodies in scenes[::2]]
        return [
            (lesson, bodies)
            for start, goal, bodies in (*scenes, *beside, *asked.arms)
            if start is not None
            for lesson in self.lessons(bodies, start, goal, rng)
        ]

    def fresh(self, kind: str, count: int, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray, Bodies]]:
        """So many scenes of a kind that are in no bank, or some more: joints at start and goal, and bodies."""
        found, finder, batches = [], Finder(self._robot, kind, seed), itertools.count()
        while len(found) < count:
            found += finder(next(batches))
        start, joints, bodies = zip(*found, strict=True)
        together: Bodies = jax.tree.map(lambda *rows: np.stack(rows), *bodies)
        bank = Bank(np.array(start), np.array(joints), together).with_room(self._room)
        yield from (jax.tree.map(lambda x, row=row: x[row], tuple(bank)) for row in range(len(found)))

    def beside(self, bodies: Bodies, goal: np.ndarray, rng: Generator) -> np.ndarray | None:
        """Joints `[n]` near those at a `goal [n]`, to which they have no straight way; None where none are found."""
        goal = goal.astype(float)
        self._place(bodies, goal)
        for way in rng.normal(size=(DRAWN, len(goal))):
            q = goal + rng.uniform(*BESIDE) / np.linalg.norm(way) * way
            if self._free(q) and not self._checker.straight(q, goal):
                return q
        return None

    def lessons(self, bodies: Bodies, start: np.ndarray, goal: np.ndarray, rng: Generator) -> Iterator[Lesson]:
        """Those of a way from `start [n]` to `goal [n]`, and of the way back; none where no way is found.

        None is needed where the goal is near and the way straight.
        """
        start, goal = start.astype(float), goal.astype(float)
        paths = self._paths(bodies, start, goal, rng)
        for path in sorted(paths, key=lambda path: duration(path, self._arm.speed))[:1]:  # the sooner one
            if len(path) > STRAIGHT or np.linalg.norm(goal - start) > AHEAD:
                yield self._lesson(path, rng)
                yield self._lesson(path[::-1], rng)

    def _lesson(self, path: np.ndarray, rng: Generator) -> Lesson:
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
        places = np.append(0.0, rng.uniform(0.0, along[-1], LESSONS - 1))
        places[::2] *= min(1.0, FIRST / along[-1])

        def at(places: np.ndarray) -> np.ndarray:
            return np.stack([np.interp(places, along, joint) for joint in path.T], axis=1)

        aside = rng.normal(0.0, ASIDE, (LESSONS, path.shape[1]))
        aside[: LESSONS // 2] = 0.0
        q = at(places) + aside
        return Lesson(q, (at(places + AHEAD) - q) / AHEAD, self._arm.links_at(path[-1])[-1, :3, 3], path[-1])

    def _paths(self, bodies: Bodies, start: np.ndarray, goal: np.ndarray, rng: Generator) -> list[np.ndarray]:
        """Two ways `[k, n]` or fewer, which keep their distances all along, but for where they begin.

        An arm that stands nearer to something than a way may be is one that dampers have stopped: it is told to go back
        first. Did all of its way keep no more than is left there, it would lead on through what stops the arm.
        """
        kept = self._place(bodies, goal)
        begun = start if self._checker.free(start) else self._backed(start, kept, rng)
        if begun is None:
            return []
        paths = []
        for seed in rng.integers(2**30, size=TRIES).tolist():
            rounds = iter(range(ROUNDS))
            path = self._search.path(begun, goal[None], lambda rounds=rounds: next(rounds, None) is None, seed=seed)
            paths += [] if path is None else [path if begun is start else np.vstack([start, path])]
        return paths

    def _backed(self, start: np.ndarray, kept: np.ndarray, rng: Generator) -> np.ndarray | None:
        """Joints `[n]` beside `start [n]` that keep the distances, to which it can go; None where none are found."""
        left = np.minimum(np.array(self._checker.distances(start)) - ROUNDING, kept)
        for far, way in itertools.product(BACK, rng.normal(size=(ROUND, len(start)))):
            q = start + far / np.linalg.norm(way) * way
            if self._free(q):
                self._checker.keep(*left)
                there = self._checker.straight(start, q)
                self._checker.keep(*kept)
                if there:
                    return q
        return None

    def _place(self, bodies: Bodies, goal: np.ndarray) -> np.ndarray:
        """Least distances [m] on ways to a `goal [n]` among bodies, which are asked for from here on."""
        self._checker.place(bodies)
        there = np.array(self._checker.distances(goal)) - ROUNDING
        kept = np.clip(there, 0.0, (CLEAR * self._arm.scale, APART))
        self._checker.keep(*kept)
        return kept

    def _free(self, q: np.ndarray) -> bool:
        """Whether joints `[n]` are within their limits, and keep the distances."""
        within = (self._arm.lower <= q).all() and (q <= self._arm.upper).all()
        return bool(within and self._checker.free(q))
