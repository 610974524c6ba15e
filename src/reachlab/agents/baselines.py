"""Agents that need no training: what a trained policy has to beat. See `acting.Agent`."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.tasks.actions import ACTIONS


def random(env: Env, _policy: Policy | None, state: EnvState, key: Array, _picture: Array | None) -> Array:
    """Actions sampled uniformly from their box."""
    low, high = env.action_bounds
    return jax.random.uniform(key, state.last_action.shape, minval=low, maxval=high)


def zero(_env: Env, _policy: Policy | None, state: EnvState, _key: Array, _picture: Array | None) -> Array:
    """Actions of zero."""
    return jnp.zeros_like(state.last_action)


def ik(env: Env, _policy: Policy | None, state: EnvState, _key: Array, _picture: Array | None) -> Array:
    """Inverse kinematics in a closed loop: to the goal from where the tool is measured, at every step."""
    now = env.situation(state)
    return ACTIONS[env.config.rules.action].towards(env.setup, now, now)


def ik_open(env: Env, _policy: Policy | None, state: EnvState, _key: Array, _picture: Array | None) -> Array:
    """Inverse kinematics without feedback: to the goal from where the tool was commanded, whatever is measured."""
    now = env.situation(state)
    q = now.command[:, : env.setup.robot.chain.n]
    commanded = forward_kinematics(env.setup.robot.chain, q).position
    believed = now._replace(q=q, qd=jnp.zeros_like(now.qd), tool_position=commanded)
    return ACTIONS[env.config.rules.action].towards(env.setup, now, believed)
