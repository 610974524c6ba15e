"""The part of its table over which an arm works with its hand pointing down."""

from __future__ import annotations

import functools
import itertools
from typing import NamedTuple

import jax
import numpy as np

from reachlab.jax_setup import jit
from reachlab.robots.derive.reaching import lead
from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.robot import Box, Robot, front_of
from reachlab.settings.cache import kept
from reachlab.settings.validation import InputError
from reachlab.tasks.task import Bounds

SHARES = (0.5, 0.7, 0.55)
"""Shares of the workspace in x and y, about its middle, and of its height, over which a hand works: behind each object
there has to be room for it."""

MOVES = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25)
"""Shares of the workspace's depth by which that part is moved outward where the arm does not reach all of it, of which
the first one is taken that does, else the best."""

EACH = (4, 4, 3)
"""Points in x, y and z that have to be reached."""

NEAR, UPRIGHT, PLAY = 0.002, 0.05, 0.02
"""Where the tool is there: distance [m], angle [rad], and what is left to each joint's limits [rad or m]."""

VERSION = 3
"""Of this search: what an older one left in the cache is found again."""


SAMPLES, LOW = 200_000, 0.05
"""Random joint vectors whose tools show how far an arm reaches over the table, and how near to it these are [m]."""


class Part(NamedTuple):
    """Corners `[3]` m of a part of the workspace."""

    low: tuple[float, ...]
    high: tuple[float, ...]


def working_box(robot: Robot) -> Bounds:
    """Corners `[3]` m of the part of the table, and of the air above it, over which the hand works."""
    part = _found(robot.chain, robot.home, robot.down, robot.workspace, robot.table_top)
    return np.array(part.low, np.float32), np.array(part.high, np.float32)


@functools.cache
def _found(chain: Chain, home: tuple[float, ...], held: tuple[float, ...], workspace: Box, table: float) -> Part:
    asked = (VERSION, chain, home, held, workspace, table)
    return kept("tables", asked, lambda: _find(chain, home, held, workspace, table), Part, Part._asdict)


def _find(chain: Chain, home: tuple[float, ...], held: tuple[float, ...], workspace: Box, table: float) -> Part:
    low, high = np.array(workspace)
    middle, half = (low + high) / 2, np.array(SHARES) * (high - low) / 2
    front = front_of(chain, workspace)
    outward = (high - low) * np.round([np.cos(front), np.sin(front), 0.0])
    parts = [(middle - half + by * outward, middle + half + by * outward) for by in MOVES]
    parts = [((*a[:2], table), (*b[:2], table + 2 * half[2])) for a, b in parts]
    grids = [list(itertools.product(*map(np.linspace, a, b, EACH))) for a, b in parts]
    there = _there(chain, home, held, np.concatenate(grids)).reshape(len(parts), -1)
    low, high = parts[int(np.argmax(there.mean(axis=1)))]
    return Part(tuple(map(float, low)), tuple(map(float, high)))


@functools.cache
def _reach(chain: Chain, table: float) -> float:
    def find() -> dict[str, float]:
        q = np.random.default_rng(0).uniform(chain.lower, chain.upper, (SAMPLES, chain.n)).astype(np.float32)
        with jax.ensure_compile_time_eval():
            tool = np.asarray(jit(lambda q: forward_kinematics(chain, q).position, brief=True)(q))
        if not (low := np.abs(tool[:, 2] - table) < LOW).any():
            raise InputError(f"the arm's tool never comes within {LOW:g} m of the table, {table:g} m high.")
        return {"reach": float(np.linalg.norm((tool[low] - chain.frames[0][1])[:, :2], axis=1).max())}

    return kept("tables", (VERSION, chain, table), find, dict, dict)["reach"]


def reach_on_table(robot: Robot) -> float:
    """Largest distance along the table from the arm's first joint to the tool, in any orientation [m]."""
    return _reach(robot.chain, robot.table_top)


def _there(chain: Chain, home: tuple[float, ...], held: tuple[float, ...], points: np.ndarray) -> np.ndarray:
    """Which of points `[P, 3]` the tool comes to, held like that, with all joints within their limits.

    Of an arm with fewer than six joints only the tilt counts.
    """
    led = lead(chain, np.array(home), points, np.array(held))
    free = ((led.q > np.array(chain.lower) + PLAY) & (led.q < np.array(chain.upper) - PLAY)).all(axis=1)
    return free & (led.off < NEAR) & (led.turned < UPRIGHT)
