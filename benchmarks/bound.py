"""How fast a tool can be at its target at all: the least joint motion that brings it there, at full speed."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from scipy.optimize import linprog

from reachlab.envs.core import Env
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.jax_setup import jit
from reachlab.robots.kinematics.forward import forward_kinematics, jacobian
from reachlab.settings.config import RunConfig
from reachlab.tasks.actions import joint_scale

EPISODES, ITERATIONS = 200, 25
"""Episodes of the estimate, and linearisations of each."""

TRUST, PRICE = 0.2, 100.0
"""Largest joint displacement of a linearisation [rad], and what a metre off the target costs in radians."""

LONGEST, INSTANTS = 5.0, 50_001
"""Times among which the time of a displacement is looked for [s], and their number."""


def least_time(config: RunConfig, seed: int) -> float:
    """Mean time in which the tool could come within the distance of success [s], on a seed's first held-out targets.

    Every joint would move at the action's full speed from the first step on, its servo following `lag` later, by the
    smallest largest displacement found by successive linear programmes from the start; stopping is not counted.
    """
    env = Env(config, EPISODES)
    state, setup = env.init(episode_keys(seed, REPORT_STREAM, 0, EPISODES)), env.setup
    start, target = np.asarray(state.arm.q, float), np.asarray(state.goal.position, float)
    linear = jit(
        lambda q: (forward_kinematics(setup.robot.chain, q).position, jacobian(setup.robot.chain, q)[..., :3, :])
    )
    moved = np.zeros_like(start)
    for _ in range(ITERATIONS):
        tool, rows = (np.asarray(x, float) for x in linear(jnp.asarray(start + moved, jnp.float32)))
        for episode in range(EPISODES):
            way = target[episode] - tool[episode]
            moved[episode] += _smaller(moved[episode], rows[episode], way, setup.rules.success_distance)
    env.close()
    times, lag = np.linspace(0.0, LONGEST, INSTANTS), max(setup.lag)
    travelled = (times - lag * (1 - np.exp(-times / lag))) / setup.period
    return float(np.interp(np.abs(moved / joint_scale(setup)).max(axis=1), travelled, times).mean())


def _smaller(moved: np.ndarray, rows: np.ndarray, way: np.ndarray, slack: float) -> np.ndarray:
    """Change `[n]` after which the largest displacement is smallest, and the tool within a cube about its target.

    The programme's variables are the change, the largest displacement, and how far the tool stays off in x, y and z.
    """
    n, one = len(moved), np.eye(len(moved))
    none, off = np.zeros((n, 3)), -np.eye(3)
    largest = [np.hstack([sign * one, -np.ones((n, 1)), none]) for sign in (1, -1)]
    within = [np.hstack([sign * rows, np.zeros((3, 1)), off]) for sign in (1, -1)]
    limits = np.concatenate([-moved, moved, way + slack, slack - way])
    bounds = [(-TRUST, TRUST)] * n + [(0, None)] * 4
    cost = np.concatenate([np.zeros(n), [1.0], np.full(3, PRICE)])
    return linprog(cost, A_ub=np.vstack([*largest, *within]), b_ub=limits, bounds=bounds).x[:n]
