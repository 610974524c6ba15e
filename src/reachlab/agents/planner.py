"""Agent `planner`: a path among bodies is planned once an episode by random sampling, and followed."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.agents.acting import Act
from reachlab.agents.baselines import ik
from reachlab.agents.policy import Policy
from reachlab.control.bodies import Bodies, nearest
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.jax_setup import jit
from reachlab.robots.shapes.clearance import capsules_at, self_distance
from reachlab.settings.validation import InputError, installing
from reachlab.tasks import WORDS
from reachlab.tasks.scenes import CLEAR
from reachlab.tasks.task import TaskSetup

Clearances = Callable[[np.ndarray, Bodies], Array]
"""Distances `[2, B]` m of an arm at joints `[B, n]` among one scene's bodies `[1, K]`: from them and the table, and
of its links from each other."""

LIMIT = 1.0
"""Time in which a path has to be found [s]; it is made shorter in as much at most."""

RESOLUTION = 0.03
"""Distance between the points of a path that have to be free [rad]."""

TOGETHER = 32
"""Points that are checked in one call."""

ROUNDING = 1e-4
"""Distance by which the same point may seem nearer when it is computed again [m]."""

GAIN = 0.5
"""Share of what an arm lags more than its servos do that its command is corrected by in a time of their lag."""

TINY = 1e-6
"""Divides in place of a smaller time [s]."""


def make_clearances(setup: TaskSetup) -> Clearances:
    """Function that gives the distances within which a path has to stay."""
    robot = setup.robot

    def clearances(q: Array, bodies: Bodies) -> Array:
        at = capsules_at(robot.chain, robot.capsules, q)
        outside = nearest(robot.capsules, at, bodies).distance.min(axis=0)
        return jnp.stack([outside, self_distance(robot.capsules, at) if robot.capsules.pairs else outside])

    return jit(clearances)


def plan(
    setup: TaskSetup, clearances: Clearances, bodies: Bodies, start: np.ndarray, goal: np.ndarray
) -> np.ndarray | None:
    """Joint vectors `[k, n]` on a path from `start [n]` to `goal [n]`, straight between them; None if none is found.

    By RRT-Connect (Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000),
    then made shorter and smoother. It keeps half the distance that scenes leave at start and goal, or what there is.

    Args:
        setup: the task on the arm.
        clearances: of `make_clearances`.
        bodies: of the scene `[1, K]`.
        start: joints that the arm is at, float32.
        goal: joints that are asked for, float32.
    """
    base, geometric, util = _ompl()
    # Their generators are made anew for each plan: its numbers do not depend on those before.
    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(1)
    # As many as there will be in every call, which is compiled now: the limit is not spent on that.
    ends = np.asarray(clearances(np.resize(np.stack([start, goal]), (TOGETHER, len(start))), bodies))[:, :2]
    if (ends[:, 1] < np.minimum(ends[:, 0], 0.0)).any():
        return None
    least = np.minimum(CLEAR * setup.robot.scale / 2, ends.min(axis=1) - ROUNDING)[:, None]

    def free(q: np.ndarray) -> bool:
        return bool((np.asarray(clearances(q.astype(np.float32), bodies)) >= least).all())

    chain = setup.robot.chain
    space = base.RealVectorStateSpace(chain.n)
    bounds = base.RealVectorBounds(chain.n)
    for joint, (low, high) in enumerate(zip(chain.lower, chain.upper, strict=True)):
        bounds.setLow(joint, min(low, start[joint], goal[joint]))
        bounds.setHigh(joint, max(high, start[joint], goal[joint]))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    task = geometric.SimpleSetup(information)
    task.setStateValidityChecker(lambda state: free(np.tile(_joints(state, chain.n), (TOGETHER, 1))))
    information.setMotionValidator(_motions(base, information, free, chain.n))
    task.setStartAndGoalStates(_state(space, start), _state(space, goal))
    task.setPlanner(geometric.RRTConnect(information))
    task.solve(LIMIT)
    if not task.haveExactSolutionPath():
        return None
    task.simplifySolution(LIMIT)
    return np.stack([_joints(state, chain.n) for state in task.getSolutionPath().getStates()])


def _ompl() -> tuple[Any, Any, Any]:
    try:
        from ompl import base, geometric, util
    except ModuleNotFoundError:
        raise InputError(f"agent 'planner' needs OMPL: {installing('planner')}.") from None
    return base, geometric, util


def _motions(base: Any, information: Any, free: Callable[[np.ndarray], bool], n: int) -> Any:
    """OMPL's judge of straight motions, which looks at many points in one call."""

    class Motions(base.MotionValidator):
        def checkMotion(self, one: Any, other: Any, *_: Any) -> bool:  # noqa: N802 (OMPL's name)
            start, end = _joints(one, n), _joints(other, n)
            calls = int(np.linalg.norm(end - start) / RESOLUTION / TOGETHER) + 1
            points = start + np.linspace(0.0, 1.0, calls * TOGETHER)[:, None] * (end - start)
            return all(free(points[call::calls]) for call in range(calls))

    return Motions(information)


def _joints(state: Any, n: int) -> np.ndarray:
    return np.array([state[joint] for joint in range(n)])


def _state(space: Any, q: np.ndarray) -> Any:
    state = space.allocState()
    for joint, value in enumerate(q):
        state[joint] = float(value)
    return state


class Motion(NamedTuple):
    """How a path is followed: joint displacements commanded in `T` steps, and the joints expected before each `[T, n]`.

    One joint is always at its full speed, and each follows its command as a first-order lag.
    """

    steps: np.ndarray
    expected: np.ndarray


def motion_along(setup: TaskSetup, path: np.ndarray) -> Motion:
    """Motion along a path `[k, n]`."""
    times = np.abs(np.diff(path, axis=0)) / np.array(setup.robot.speed)
    clock = np.concatenate([[0.0], np.cumsum(times.max(axis=1))])
    moments = np.arange(0.0, clock[-1] + setup.period, setup.period)
    commands = np.stack([np.interp(moments, clock, joint) for joint in path.T], axis=1)
    keeps, expected = np.exp(-setup.period / np.maximum(setup.lag, TINY)), [path[0]]
    for command in commands[1:-1]:
        expected.append(command + keeps * (expected[-1] - command))
    return Motion(np.diff(commands, axis=0), np.stack(expected))


class _Plans:
    """Plans for the episodes of a batch, each when it is first seen."""

    def __init__(self, env: Env) -> None:
        self._setup, self._clearances = env.setup, make_clearances(env.setup)
        self._episodes: list[bytes] = [b""] * env.num_envs
        self._begun = np.zeros(env.num_envs, int)
        self._motions: list[Motion | None] = [None] * env.num_envs
        self._gain = GAIN * env.setup.period / np.maximum(env.setup.lag, TINY)
        self._most = np.array(env.setup.robot.speed) * env.setup.period
        self._situation = jit(env.situation)

    def commands(self, state: EnvState, mask: np.ndarray) -> np.ndarray:
        """Next joint commands `[B, n]` in the environments of `mask [B]`; not a number where a path is at its end."""
        keys, joints = np.asarray(jax.random.key_data(state.key)), np.asarray(state.goal.joints)
        clock, q, given = np.asarray(state.clock), np.asarray(self._situation(state).q), np.array(state.command)
        for row in np.flatnonzero(mask):
            episode = keys[row].tobytes() + joints[row].tobytes()
            if episode != self._episodes[row]:
                self._episodes[row], self._begun[row] = episode, clock[row]
                scene = jax.tree.map(lambda x, row=row: x[row : row + 1], state.arm.bodies)
                path = plan(self._setup, self._clearances, scene, given[row], joints[row])
                self._motions[row] = None if path is None else motion_along(self._setup, path)
            if (motion := self._motions[row]) is not None:
                step = clock[row] - self._begun[row]
                given[row] += self._step(motion, step, q[row]) if step < len(motion.steps) else np.nan
        return given

    def _step(self, motion: Motion, step: int, q: np.ndarray) -> np.ndarray:
        missing = motion.expected[step] - q
        return np.clip(motion.steps[step] + self._gain * missing, -self._most, self._most)


def planner(env: Env) -> Act:
    """The step of an agent that follows a planned path; where none is found the arm stays where it is.

    Raises:
        InputError: OMPL is not installed, or the task has no bodies.
    """
    _ompl()
    if "bodies" not in env.setup.rules.gives:
        raise InputError(f"agent 'planner' needs {WORDS['bodies']}.")
    plans, hold = _Plans(env), jit(partial(ik, env))

    def act(
        policy: Policy | None, state: EnvState, key: Array, mask: Array | None = None, instead: Array | None = None
    ) -> tuple[EnvState, Transition, Array]:
        del policy
        commands = plans.commands(state, np.ones(env.num_envs, bool) if mask is None else np.asarray(mask))
        if instead is not None:
            commands = np.where(np.isnan(instead), commands, instead)
        state, transition = env.step(state, hold(None, state, key, None), instead=jnp.asarray(commands))
        return state, transition, key

    return act
