"""Programs of a page: episodes in the kinematic simulator, traced from the functions of the environment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, ShapeDtypeStruct

from reachlab.agents.policy import Policy
from reachlab.deploy.behaviour import GOAL, as_measured, decision_inputs, example_state, goal_of, measured_state
from reachlab.emit.program import Program
from reachlab.emit.tracing import trace
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvFunctions, EnvState
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.robots.kinematics.forward import components, forward_kinematics, link_frames
from reachlab.robots.kinematics.scalars import Vec, rotation_from_quaternion
from reachlab.sims.simulator import Moved
from reachlab.tasks.actions import ACTIONS

DRAWN, DRAW_SEED = 200, 7
"""Held-out episodes that a page begins with one after the other, and their seed."""

PROGRESS = "progress_"
"""Begin of the names of what a task remembers."""


@dataclass(frozen=True)
class Episodes:
    """Functions of a policy, its task and its arm in a page.

    Attributes:
        functions: those of the environment, for joints that follow commands after their lag.
        policy: the policy.
        like: a state that shows what others are made of.
    """

    functions: EnvFunctions
    policy: Policy
    like: EnvState


def programs(env: Env, policy: Policy, lag: tuple[float, ...]) -> list[Program]:
    """Programs of a policy on an arm whose joints follow their commands by `lag [n]` s late.

    A step with either agent, a goal that is asked for anew, one that is put somewhere, and the links.

    Raises:
        InputError: one of them computes what cannot be printed.
    """
    functions = replace(as_measured(env.functions), setup=replace(env.setup, lag=lag), real_time=max(lag) > 0)
    page, chain = Episodes(functions, policy, example_state(env)), env.setup.robot.chain
    like, asked = page.like, decision_inputs(env, page.like)
    goal = {GOAL + field.name: getattr(like.goal, field.name) for field in fields(like.goal)}
    goal = {name: ShapeDtypeStruct(part.shape[1:], part.dtype) for name, part in goal.items() if part.size}
    asked |= goal
    stepped = asked | {"clock": ShapeDtypeStruct((1,), jnp.int32), "instead": asked["command"]}
    leaves = enumerate(jax.tree.leaves(like.progress))
    stepped |= {f"{PROGRESS}{i}": ShapeDtypeStruct(leaf.shape[1:], leaf.dtype) for i, leaf in leaves}
    placed = goal | {"q": asked["q"], "position": goal[GOAL + "position"]}
    return [
        *(trace(agent, lambda agent=agent, **given: _step(page, agent, given), stepped) for agent in ("trained", "ik")),
        trace("ask", lambda **given: _ask(page, given), asked),
        trace("place", lambda **given: _place(page, given), placed),
        trace("links", lambda q: _links(chain, q), {"q": asked["q"]}),
    ]


def _step(page: Episodes, agent: str, given: Mapping[str, Array]) -> dict[str, Array]:
    """State after a control step, and what it led to; a joint command `instead` is taken where it is a number."""
    functions, setup = page.functions, page.functions.setup
    leaves = [given[f"{PROGRESS}{i}"][None] for i in range(len(jax.tree.leaves(page.like.progress)))]
    progress = jax.tree.unflatten(jax.tree.structure(page.like.progress), leaves)
    state = replace(measured_state(functions, page.like, given), clock=given["clock"], progress=progress)
    now = functions.situation(state)
    towards = ACTIONS[setup.rules.action].towards
    action = page.policy.act(functions.observe(state)) if agent == "trained" else towards(setup, now, now)
    action, command, _ = functions.command(state, action, None)
    command = jnp.where(jnp.isnan(given["instead"]), command, given["instead"])
    after, transition = functions.judge(state, _followed(page, state, command), command, action, None)
    ended = {"success": transition.terms["success"], "terminated": transition.terminated, "done": transition.done}
    return _arrays(page, after) | ended | {"counted": transition.counted.distance}


def _followed(page: Episodes, state: EnvState, command: Array) -> Moved:
    """Joints after a control period: at their command or, where they lag, nearer to it."""
    lag, period = np.array(page.functions.setup.lag, np.float32), page.functions.setup.period
    q = command[:, : len(lag)]
    late = q + (state.arm.q - q) * np.exp(-period / np.maximum(lag, 1e-9)).astype(np.float32)
    speed = jnp.where(lag > 0, (q - late) / np.maximum(lag, 1e-9), (late - state.arm.q) / period)
    return Moved(late, speed, state.arm.bodies, state.arm.contact, state.arm.opening)


def _ask(page: Episodes, given: Mapping[str, Array]) -> dict[str, Array]:
    """State of an arm that is asked for a goal from now on, and has all the time of an episode."""
    state = measured_state(page.functions, page.like, given)
    state = replace(state, progress=page.functions.setup.task.begin(page.functions.setup, state.errors))
    return _arrays(page, state)


def _place(page: Episodes, given: Mapping[str, Array]) -> dict[str, Array]:
    """The goal put at a position, turned as it was, and whether the arm can be there."""
    setup, goal = page.functions.setup, goal_of(page.like, given)
    turned = goal.quaternion[0] if goal.quaternion.size else jnp.array(setup.robot.held_quaternion)
    placed, reached = setup.task.place(setup, goal, given["position"], turned, given["q"])
    parts = {GOAL + field.name: getattr(placed, field.name)[0] for field in fields(placed)}
    return {name: part for name, part in parts.items() if part.size} | {"reached": reached[None]}


def _links(chain: Any, q: Array) -> dict[str, Array]:
    """Axes `[n, 3, 3]`, a row each, and positions `[n, 3]` m of the links and of the tool after them."""
    tool = forward_kinematics(chain, q)
    frames = [*link_frames(chain, components(q))[1:]]
    frames.append((rotation_from_quaternion(*components(tool.quaternion)), Vec(*components(tool.position))))
    rotations = [
        jnp.stack([jnp.asarray(number, q.dtype) for axis in rotation for number in axis]) for rotation, _ in frames
    ]
    positions = [jnp.stack([jnp.asarray(number, q.dtype) for number in position]) for _, position in frames]
    return {"axes": jnp.concatenate(rotations), "positions": jnp.concatenate(positions)}


def _arrays(page: Episodes, state: EnvState) -> dict[str, Array]:
    """A state as arrays by name, what is empty left out; and where the tool is, and whether it is at the goal."""
    setup, errors = page.functions.setup, state.errors
    named = {"q": state.arm.q, "qd": state.arm.qd, "command": state.command, "last_action": state.last_action}
    named |= {"tool": state.arm.tool_position, "angle": errors.angle[:, None]}
    named |= {GOAL + field.name: getattr(state.goal, field.name) for field in fields(state.goal)}
    named |= {f"{PROGRESS}{i}": leaf for i, leaf in enumerate(jax.tree.leaves(state.progress))}
    single = {"clock": state.clock, "distance": errors.distance, "near": setup.task.near(setup.rules, errors)}
    return {name: part[0] for name, part in named.items() if part.size} | single


def drawn(env: Env) -> dict[str, np.ndarray]:
    """Joints and goals `[DRAWN, …]` by name in which episodes begin."""
    begin = env.compile_whole(env.functions.sample_episode)(episode_keys(DRAW_SEED, REPORT_STREAM, 0, DRAWN))
    parts = {"q": begin.q} | {GOAL + field.name: getattr(begin.goal, field.name) for field in fields(begin.goal)}
    return {name: np.asarray(part, np.float32) for name, part in parts.items() if part.size}
