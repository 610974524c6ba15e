"""An agent at work: it decides, and the environment takes a step."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
from jax import Array

from reachlab.agents import AGENTS
from reachlab.agents.policy import Memory, Policy
from reachlab.envs.ahead import steps_ahead
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.gymnasium_shared import checked_actions
from reachlab.settings.validation import InputError, choose
from reachlab.tasks.schema import Field, Schema

OF_THE_ARM = ("joints", "tool")
"""Parts of an observation whose bounds say which arm it is of."""

Agent = Callable[[Env, Policy | None, EnvState, Array, Array | None], Array | tuple[Array, Memory]]
"""Gives actions `[B, a]` for a state, or these and what is remembered then; the key is for agents that sample them, the
picture for policies that need it."""

Function = Callable[..., Any]
"""Gives actions `[B, a]` for observations, both in NumPy or what it understands: a policy of any other library.

Where it has a second argument without a default, or one that is called `begins`, it is given where episodes begin,
`[B]` truths: a policy that remembers needs that.
"""

Act = Callable[..., tuple[EnvState, Transition, Array]]
"""State, transition and next random key after a step of an agent, of policy, state, key, `mask` and `instead`.

Pictures are drawn for the environments of `mask [B]` alone, for all without it. A joint command `instead [B, n]` that
is a number is taken in place of the agent's, see `Env.step`.
"""


@dataclass(frozen=True)
class Driver:
    """An agent beside those of `AGENTS` that commands joints itself, rather than giving actions.

    Attributes:
        name: of it in reports.
        make_act: gives its step in an environment.
    """

    name: str
    make_act: Callable[[Env], Act]

    def __call__(self, env: Env) -> Act:
        """Its step in an environment."""
        return self.make_act(env)


def trained(
    env: Env, policy: Policy | None, state: EnvState, _key: Array, picture: Array | None
) -> tuple[Array, Memory]:
    """The trained policy, without noise."""
    if policy is None:
        raise InputError("agent 'trained' needs a run: name its directory, or from Python give its policy.")
    _check_fits(policy.schema, env)
    return policy.decide(env.observe(state, picture), state.memory)


def decide(
    agent: Agent, env: Env, policy: Policy | None, state: EnvState, key: Array, picture: Array | None
) -> tuple[Array, Memory]:
    """Actions `[B, a]` of an agent, and what is remembered then: by baselines what was."""
    given = agent(env, policy, state, key, picture)
    return given if isinstance(given, tuple) else (given, state.memory)


def _check_fits(schema: Schema, env: Env) -> None:
    """Make sure that a policy which observes what a schema says can act in an environment; asked as it is traced.

    Raises:
        InputError: it observes something else, or another arm.
    """
    known, given = ({field.name: field for field in one.fields} for one in (schema, env.schema))
    mend = "evaluate it in the environment that `reachlab.load` gives of its run"
    if [(one.name, one.row or one.shape) for one in schema.fields] != [
        (one.name, one.row or one.shape) for one in env.schema.fields
    ]:
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
    if isinstance(agent, Driver):
        return agent.name
    return agent if isinstance(agent, str) else getattr(agent, "__name__", type(agent).__name__)


def make_act(env: Env, agent: str | Function) -> Act:
    """The step of an agent of `AGENTS`, of a driver, or of a function.

    Raises:
        InputError: there is none of that name, or it cannot act there.
    """
    if isinstance(agent, Driver):
        return agent(env)
    if not isinstance(agent, str):
        return _act_by(agent, env)
    entry = AGENTS[choose("agent", agent, AGENTS)]
    if entry.remembers:
        return entry.load()(env)
    chosen: Agent = entry.load()
    steps_ahead(env)

    def decided(policy: Policy | None, state: EnvState, key: Array, picture: Any) -> tuple[Array, Memory, Array]:
        key, now = jax.random.split(key)
        return *decide(chosen, env, policy, state, now, picture), key

    decision = env.compile_part(decided, agent)
    draws = env.pictured and entry.trained

    def act(
        policy: Policy | None, state: EnvState, key: Array, mask: Array | None = None, instead: Array | None = None
    ) -> tuple[EnvState, Transition, Array]:
        picture = env.render_observation(state, None if mask is None else np.asarray(mask)) if draws else None
        action, memory, key = decision(policy, state, key, picture)
        state, transition = env.step(replace(state, memory=memory), action, instead=instead)
        return state, transition, key

    return act


def _is_told(function: Function) -> bool:
    """Whether a function is given where episodes begin; not where its arguments are not known."""
    try:
        known = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return False
    places = [one for one in known if one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)]
    return any(one.name == "begins" or one.default is one.empty for one in places[1:2])


def _act_by(decide: Function, env: Env) -> Act:
    """The step of a function, which is called outside JAX's traces.

    Raises:
        InputError: when it is called, where it gives actions that are misshapen or not finite.
    """
    step, told = env.compile_whole(env.step), _is_told(decide)

    def act(
        _policy: Policy | None, state: EnvState, key: Array, mask: Array | None = None, instead: Array | None = None
    ) -> tuple[EnvState, Transition, Array]:
        seen = jax.tree.map(np.array, env.observe_now(state, None if mask is None else np.asarray(mask)))
        begins = (np.asarray(state.clock) == 0,) if told else ()
        actions = checked_actions(decide(seen, *begins), state.last_action.shape)
        state, transition = step(state, actions, instead=instead)
        return state, transition, key

    return act
