"""Agent `planner`: a motion is planned once an episode, and again when bodies have moved into its way; and followed."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.agents.acting import decide
from reachlab.agents.baselines import ik
from reachlab.agents.policy import Policy
from reachlab.control.contact_model import arm_of
from reachlab.control.planning.following import Follower, Trajectory
from reachlab.control.planning.plans import Plans
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.jax_setup import jit
from reachlab.settings.validation import InputError, needing
from reachlab.tasks import WORDS


def plans_for(env: Env) -> Plans:
    """Plans for the goals of an environment that knows joints at them.

    Raises:
        InputError: the arm has no shapes, or OMPL is not installed.
    """
    setup = env.setup
    with needing("agent 'planner' needs OMPL: {}.", "planner"):
        arm, limits = arm_of(setup.robot, setup.lag, setup.period), env.functions.limits
        arm = arm.within(limits) if limits else arm
        return Plans(arm, setup.task.scene(setup).bodies, turns=setup.rules.asks_orientation)


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
        self.plans = plans_for(env)
        self._env, self._episodes = env, [b""] * env.num_envs
        self._begun, self._planned = np.zeros(env.num_envs, int), np.zeros(env.num_envs)
        self._motions: list[Trajectory | None] = [None] * env.num_envs
        self._scenes, self._meanwhile = [b""] * env.num_envs, 0.0
        self._follower = Follower(env.setup.lag, env.setup.robot.speed, env.setup.period)
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

    def commands(self, _policy: Policy | None, state: EnvState, mask: np.ndarray) -> np.ndarray:
        """Next joint commands `[B, n]` in the environments of `mask [B]`; without a motion the last ones."""
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
                given[row] = self._follower.command(motion, step, q[row], given[row])
        return given
