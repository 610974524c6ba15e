"""Programs around an engine's steps, compiled beside the main thread before they are needed."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.random_streams import env_keys
from reachlab.sims.simulator import Begin, Moved, SimState


def known_ahead(env: Env) -> bool:
    """Whether it is known what a simulator gives before it steps: an engine with dynamics."""
    return not env.traced and max(env.simulator.lag) > 0


def begin_ahead(env: Env) -> EnvState:
    """Shapes of a state; what begins episodes is being compiled."""
    begin = env.sample.ahead(jax.eval_shape(lambda: env_keys(0, env.num_envs)))
    state = env.parts.begin.ahead(_arms(env, begin), begin)
    if not env.pictured:
        env.observed.ahead(state, None)
    return state


def steps_ahead(env: Env) -> None:
    """Begin to compile what episodes begin with and what is before and after the engine's steps."""
    if known_ahead(env):
        state = begin_ahead(env)
        taken, command, motion = env.parts.command.ahead(state, no_actions(env), None)
        env.parts.judge.ahead(state, moved_like(state.arm), command, taken, motion)


def no_actions(env: Env) -> np.ndarray:
    """Actions `[B, a]` of nothing."""
    return np.zeros((env.num_envs, len(env.action_bounds[0])), np.float32)


def moved_like(arm: SimState) -> Moved:
    """What a step gives of such arms, without the engine's own."""
    return Moved(arm.q, arm.qd, arm.bodies, arm.contact, arm.opening, wrench=arm.wrench)


def _arms(env: Env, begin: Begin) -> SimState:
    def rows(*shape: int, kind: type = np.float32) -> Any:
        return jax.ShapeDtypeStruct((env.num_envs, *shape), kind)

    robot, scene = env.setup.robot, env.setup.scene
    q, opening, wrench = rows(robot.chain.n), rows(1 if robot.gripper else 0), rows(6) if scene.wrench else None
    contact = rows(kind=bool) if scene.contacts else rows(0, kind=bool)
    return SimState(q, q, rows(3), rows(4), begin.bodies, contact, opening, wrench=wrench)
