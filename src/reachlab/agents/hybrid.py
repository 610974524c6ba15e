"""Agent `hybrid`: the policy where it will get through, and the planner where it will not, or does not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.agents.acting import decide, trained
from reachlab.agents.planner import Following
from reachlab.agents.policy import Policy
from reachlab.control.planning.following import PATIENCE, PROGRESS, SHORTEST, longest_way
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.jax_setup import jit
from reachlab.sims.simulator import Moved

Ahead = Callable[[Policy | None, EnvState], tuple[Array, Array]]
"""Joints `[T, B, n]` of arms under a policy, and whether their episodes have ended in success by then `[T, B]`."""


def make_ahead(env: Env) -> Ahead:
    """Function that looks ahead: servos lag behind commands by their time, and nothing is in the way."""
    functions, setup, n = replace(env.functions, randomise=()), env.setup, env.setup.robot.chain.n
    share = 1.0 - jnp.exp(-setup.period / jnp.maximum(jnp.array(setup.lag), SHORTEST))

    def ahead(policy: Policy | None, state: EnvState) -> tuple[Array, Array]:
        def step(state: EnvState, _: None) -> tuple[EnvState, tuple[Array, Array]]:
            arm = state.arm
            action, memory = trained(env, policy, state, state.key, None)
            action, command, motion = functions.command(state, action, None)
            way = share * (command[:, :n] - arm.q)
            moved = Moved(arm.q + way, way / setup.period, arm.bodies, arm.contact, arm.opening, wrench=arm.wrench)
            state, transition = functions.judge(replace(state, memory=memory), moved, command, action, motion)
            return state, (moved.q, transition.terms["success"])

        begun = replace(state.apart, sensed=None, sight=None)
        return jax.lax.scan(step, begun, length=setup.rules.max_steps)[1]

    return ahead


class Hybrid(Following):
    """The step of an agent whose policy moves first, and whose planner takes over where that leads nowhere."""

    def __init__(self, env: Env) -> None:
        """No episode is known yet."""
        super().__init__(env)
        self._act, self._ahead = jit(partial(decide, trained, env)), jit(make_ahead(env))
        self._meanwhile = env.setup.period  # a plan begins where the last command leads, while the arm goes there
        self._leads = np.zeros(env.num_envs, bool)
        self._nearest, self._since = np.zeros(env.num_envs), np.zeros(env.num_envs, int)
        self._patience = round(PATIENCE / env.setup.period)

    def commands(self, policy: Policy | None, state: EnvState, mask: np.ndarray) -> np.ndarray:
        """Next joint commands `[B, n]` of the planner, where it has taken over; not numbers where the policy acts."""
        task, rules, clock = self._env.setup.task, self._env.setup.rules, np.asarray(state.clock)
        distance = np.asarray(task.gap(rules, state.errors))
        first = mask & (clock == 0)
        if first.any():
            self._leads[first] = self._soon(policy, state, first)
            self._planned[first] = 0.0
        near = np.asarray(task.near(rules, state.errors))
        came = first | near | (distance < self._nearest - PROGRESS)
        self._nearest[came], self._since[came] = distance[came], clock[came]
        self._leads &= clock - self._since <= self._patience
        planned = mask & ~first & ~self._leads
        given = super().commands(policy, state, planned)
        return np.where(planned[:, None], given, np.nan)

    def _soon(self, policy: Policy | None, state: EnvState, rows: np.ndarray) -> list[bool]:
        """In which of the environments `rows [B]` the policy will get through, and soon."""
        joints, success = map(np.asarray, self._ahead(policy, state))
        bodies, goal = jax.tree.map(np.asarray, (state.arm.bodies, state.goal.joints))
        ends, longest = success.argmax(axis=0) + 1, longest_way(joints[0], goal, self._env.setup.robot.speed)
        soon = success.any(axis=0) & (ends * self._env.setup.period < longest)
        return [
            soon[row] and self.plans.free(joints[: ends[row], row], jax.tree.map(lambda x, row=row: x[row], bodies))
            for row in np.flatnonzero(rows)
        ]
