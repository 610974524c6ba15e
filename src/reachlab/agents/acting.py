"""An agent at work: it decides, and the environment takes a step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
from jax import Array

from reachlab.agents import AGENTS
from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.gymnasium_shared import checked_actions
from reachlab.settings.validation import InputError, choose
from reachlab.tasks.schema import Field, Observed, Schema

OF_THE_ARM = ("joints", "tool")
"""Parts of an observation whose bounds say which arm it is of."""

Agent = Callable[[Env, Policy | None, EnvState, Array, Array | None], Array]
"""Gives actions `[B, a]` for a state; the key is for agents that sample them, the picture for policies that need it."""

Function = Callable[[Observed], Any]
"""Gives actions `[B, a]` for observations, both in NumPy or what it understands: a policy of any other library."""

Act = Callable[..., tuple[EnvState, Transition, Array]]
"""State, transition and next random key after a step of an agent, of policy, state, key, `mask` and `instead`.

Pictures are drawn for the environments of `mask [B]` alone, for all without it. A joint command `instead [B, n]` that
is a number is taken in place of the agent's, see `Env.step`.
"""


def trained(env: Env, policy: Policy | None, state: EnvState, key: Array, picture: Array | None) -> Array:
    """The trained policy, without noise."""
    del key
    if policy is None:
        raise InputError("agent 'trained' needs a run: name its directory.")
    _check_fits(policy.schema, env)
    return policy.act(env.observe(state, picture))


def _check_fits(schema: Schema, env: Env) -> None:
    """Make sure that a policy which observes what a schema says can act in an environment; asked as it is traced.

    Raises:
        InputError: it observes something else, or another arm.
    """
    known, given = ({field.name: field for field in one.fields} for one in (schema, env.schema))
    mend = "evaluate it in the environment that `reachlab.load` gives of its run"
    if [(one.name, one.shape) for one in schema.fields] != [(one.name, one.shape) for one in env.schema.fields]:
        raise InputError(f"the policy observes {_named(known)}, and the environment gives {_named(given)}: {mend}.")
    for name in known.keys() & OF_THE_ARM:
        if not np.allclose(known[name].bounds, given[name].bounds):
            raise InputError(
                f"the policy is of another arm than {env.setup.robot.name!r}, with other limits of its {name}: {mend}."
            )


def _named(fields: Mapping[str, Field]) -> str:
    return " ".join(f"{name}{list(field.shape)}" for name, field in fields.items())


def name_of(agent: str | Function) -> str:
    """Name of an agent in reports."""
    return agent if isinstance(agent, str) else getattr(agent, "__name__", type(agent).__name__)


def make_act(env: Env, agent: str | Function) -> Act:
    """The step of an agent of `AGENTS`, or of a function.

    Raises:
        InputError: there is none of that name, or it cannot act there.
    """
    if not isinstance(agent, str):
        return _act_by(agent, env)
    entry = AGENTS[choose("agent", agent, AGENTS)]
    if entry.remembers:
        return entry.load()(env)
    decide: Agent = entry.load()

    @env.compile_part
    def decided(policy: Policy | None, state: EnvState, key: Array, picture: Any) -> tuple[Array, Array]:
        key, now = jax.random.split(key)
        return decide(env, policy, state, now, picture), key

    draws = env.pictured and entry.trained

    def act(
        policy: Policy | None, state: EnvState, key: Array, mask: Array | None = None, instead: Array | None = None
    ) -> tuple[EnvState, Transition, Array]:
        picture = env.render_observation(state, None if mask is None else np.asarray(mask)) if draws else None
        action, key = decided(policy, state, key, picture)
        state, transition = env.step(state, action, instead=instead)
        return state, transition, key

    return act


def _act_by(decide: Function, env: Env) -> Act:
    """The step of a function, which is called outside JAX's traces.

    Raises:
        InputError: when it is called, where it gives actions that are misshapen or not finite.
    """
    step = env.compile_whole(env.step)

    def act(
        policy: Policy | None, state: EnvState, key: Array, mask: Array | None = None, instead: Array | None = None
    ) -> tuple[EnvState, Transition, Array]:
        del policy
        seen = jax.tree.map(np.array, env.observe_now(state, None if mask is None else np.asarray(mask)))
        state, transition = step(state, checked_actions(decide(seen), state.last_action.shape), instead=instead)
        return state, transition, key

    return act
