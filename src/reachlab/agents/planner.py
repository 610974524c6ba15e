"""Agent `planner`: a motion is planned once an episode, and again when bodies have moved into its way; and followed."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.agents.acting import decide
from reachlab.agents.baselines import ik
from reachlab.agents.policy import Policy
from reachlab.control.bodies import Bodies, absent
from reachlab.control.branches import free_branches, make_solver
from reachlab.control.contact_model import collision_checker, geoms_of
from reachlab.control.planning.planner import Limits, Planner
from reachlab.control.planning.timing import Trajectory
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.jax_setup import jit
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.settings.validation import InputError, installing
from reachlab.tasks import WORDS
from reachlab.tasks.task import TaskSetup

TILTED, TILT = 3, 0.35
"""Poses of the tool beside the goal's own to which is planned where any orientation will do, and how far they are
turned about each axis at random [rad]."""

FOLLOWED = 0.45
"""Largest acceleration of a motion, in full speeds in a time of the servos' lag: more would take too fast commands."""

GAIN = 0.5
"""Share of what an arm lags more than its servos do that its command is corrected by in a time of their lag."""

NUDGE = 0.01
"""Length of a first motion [rad]."""

TINY = 1e-6
"""Divides in place of a smaller time [s]."""


class Plans:
    """Plans for the goals of a task on an arm.

    Attributes:
        seconds: time that the last plan took.
    """

    def __init__(self, setup: TaskSetup) -> None:
        """Of a task that knows joints at its goals.

        Raises:
            InputError: the arm has no shapes, or OMPL is not installed.
        """
        robot, limits, scene = setup.robot, setup.robot.commands, setup.task.scene(setup)
        speed = np.array(robot.speed)
        acceleration = np.minimum(robot.acceleration, FOLLOWED * speed / np.maximum(setup.lag, TINY))
        try:
            self._planner = Planner(
                collision_checker(robot, scene.bodies),
                Limits(limits.lower, limits.upper, speed, acceleration),
                robot.scale,
                setup.period,
            )
        except ModuleNotFoundError:
            raise InputError(f"agent 'planner' needs OMPL: {installing('planner')}.") from None
        self._setup, self._solve = setup, make_solver(robot)
        self._pose = jit(lambda q: forward_kinematics(robot.chain, q), brief=True)
        nothing, home = jax.tree.map(np.asarray, absent(scene.bodies)), np.array(robot.home)
        self.plan(nothing, home, home + NUDGE)  # what it needs is compiled and imported before time counts

    def plan(self, scene: Bodies, start: np.ndarray, goal: np.ndarray) -> Trajectory | None:
        """A motion among bodies `[K]` from joints `start [n]` to where the tool is at joints `goal [n]`."""
        begun, planner = time.perf_counter(), self._planner
        planner.checker.place(geoms_of(scene)._asdict())
        planner.margins(start, goal)
        motion = planner.motion(start, self._goals(start, goal), goal)
        self.seconds = time.perf_counter() - begun
        return motion

    def free(self, joints: np.ndarray, scene: Bodies) -> bool:
        """Whether the arm is free at joints `[T, n]` among bodies `[K]`, by as much as a motion has to be."""
        self._planner.checker.place(geoms_of(scene)._asdict())
        self._planner.margins(joints[0], joints[-1])
        return all(self._planner.checker.free(q) for q in joints)

    def leads(self, motion: Trajectory, first: int, scene: Bodies) -> bool:
        """Whether a motion is still free from its step `first` on, now that bodies `[K]` are elsewhere."""
        self._planner.checker.place(geoms_of(scene)._asdict())
        self._planner.margins(motion.q[min(first, len(motion.q) - 1)], motion.q[-1])
        return self._planner.leads(motion, first)

    def _goals(self, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Free joint vectors `[g, n]` that have the goal: of its pose and, if none is asked for, of poses near it."""
        turns, robot = self._setup.rules.asks_orientation, self._setup.robot
        if turns and not robot.chain.poses:  # so few joints have it in no other way
            return goal[None]
        rng, poses = np.random.default_rng(0), self._pose(goal[None])
        position, quaternion = np.asarray(poses.position), np.asarray(poses.quaternion)
        count = 0 if turns else TILTED
        turned = np.stack([_turned(quaternion[0], rng.normal(0.0, TILT, 3)) for _ in range(count)] or [quaternion[0]])
        quaternion = np.concatenate([quaternion, turned])
        branches = self._solve(np.repeat(position, len(quaternion), axis=0), quaternion, rng)
        return free_branches(self._planner.checker, robot, np.concatenate([goal[None], *branches]), start)


def _turned(quaternion: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """An orientation wxyz turned about the axes of the world by small angles `[3]` rad."""
    (w, v), (a, b) = (quaternion[0], quaternion[1:]), (1.0, turn / 2)
    product = np.array([a * w - b @ v, *(a * v + w * b + np.cross(b, v))])
    return product / np.linalg.norm(product)


class Following:
    """The step of an agent that follows planned motions, each planned when its episode is first seen.

    Where no motion is found the arm stays where it is.
    """

    def __init__(self, env: Env) -> None:
        """Nothing is planned yet.

        Raises:
            InputError: OMPL is not installed, the task does not know joints at its goals, or bodies move.
        """
        if "joints" not in env.setup.rules.gives:
            raise InputError(f"a planner needs {WORDS['joints']}.")
        if env.setup.task.scene(env.setup).moved:
            raise InputError(
                "a planner plans among bodies that stay, and those of this scene move: choose agent ik or trained."
            )
        self.plans = Plans(env.setup)
        self._env, self._episodes = env, [b""] * env.num_envs
        self._begun, self._planned = np.zeros(env.num_envs, int), np.zeros(env.num_envs)
        self._motions: list[Trajectory | None] = [None] * env.num_envs
        self._scenes, self._meanwhile = [b""] * env.num_envs, 0.0
        lag = np.maximum(env.setup.lag, TINY)
        self._lag, self._gain = np.array(env.setup.lag), GAIN * env.setup.period / lag
        self._most = np.array(env.setup.robot.speed) * env.setup.period
        self._situation, self._act = jit(env.situation), jit(partial(decide, ik, env))

    def __call__(
        self,
        policy: Policy | None,
        state: EnvState,
        key: Array,
        mask: Array | None = None,
        instead: Array | None = None,
    ) -> tuple[EnvState, Transition, Array]:
        """Take a step, see `acting.Act`."""
        rows = np.ones(self._env.num_envs, bool) if mask is None else np.asarray(mask)
        commands = self.commands(policy, state, rows)
        if instead is not None:
            commands = np.where(np.isnan(instead), commands, instead)
        action, memory = self._act(policy, state, key, None)
        state, transition = self._env.step(replace(state, memory=memory), action, instead=jnp.asarray(commands))
        return state, transition, key

    def planned(self) -> np.ndarray:
        """Time that arms waited for plans in the episodes `[B]` [s]."""
        return self._planned.copy()

    def commands(self, policy: Policy | None, state: EnvState, mask: np.ndarray) -> np.ndarray:
        """Next joint commands `[B, n]` in the environments of `mask [B]`; without a motion the last ones."""
        del policy
        keys, joints = np.asarray(jax.random.key_data(state.key)), np.asarray(state.goal.joints)
        now = self._situation(state)
        clock, q, given = np.asarray(state.clock), np.asarray(now.q), np.array(state.command)
        bodies = jax.tree.map(np.asarray, now.bodies)
        for row in np.flatnonzero(mask):
            scene = jax.tree.map(lambda x, row=row: x[row], bodies)
            episode, place = keys[row].tobytes() + joints[row].tobytes(), scene.position.tobytes()
            step, motion, new = clock[row] - self._begun[row], self._motions[row], episode != self._episodes[row]
            moved = not new and place != self._scenes[row]
            if new or (moved and (motion is None or not self.plans.leads(motion, step, scene))):
                self._begun[row], step = clock[row], 0
                motion = self._motions[row] = self.plans.plan(scene, given[row].astype(float), joints[row])
                waited = max(self.plans.seconds - self._meanwhile, 0.0)
                self._planned[row] = waited + (0.0 if new else self._planned[row])
            self._episodes[row], self._scenes[row] = episode, place
            if motion is not None:
                given[row] = self._next(motion, step, q[row], given[row])
        return given

    def _next(self, motion: Trajectory, step: int, q: np.ndarray, given: np.ndarray) -> np.ndarray:
        """The command `[n]` that brings joints `q [n]` to a motion's next step: ahead of it by the servos' lag."""
        now, then = min(step, len(motion.q) - 1), min(step + 1, len(motion.q) - 1)
        ahead = self._lag * (motion.qd[then] - motion.qd[now])
        moved = motion.q[then] - motion.q[now] + ahead + self._gain * (motion.q[now] - q)
        return given + np.clip(moved, -self._most, self._most)
