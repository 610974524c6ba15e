"""Programs of a page: what is decided and judged in its episodes, traced from the functions of the environment."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, ShapeDtypeStruct

from reachlab.agents.policy import Policy
from reachlab.emit.behaviour import (
    BODIES,
    GOAL,
    MEMORY,
    as_measured,
    bodies_of,
    decision_inputs,
    example_state,
    goal_of,
    measured_state,
    motion_parts,
    remembered_as,
)
from reachlab.emit.program import Program
from reachlab.emit.tracing import trace
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvFunctions, EnvState
from reachlab.envs.random_streams import REPORT_STREAM, stream_key
from reachlab.jax_setup import jit
from reachlab.robots.kinematics.forward import components, forward_kinematics, link_frames
from reachlab.robots.kinematics.scalars import Vec, rotation_from_quaternion
from reachlab.sims.simulator import Begin, Moved
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.task import TaskSetup

DRAWN = 200
"""Held-out episodes that a page plays one after the other, at most."""

PROGRESS, MOVED = "progress_", "moved_"
"""Begins of the names of what a task remembers, and of what a simulator has moved."""

PLAYED = ("trained", "ik")
"""Agents that a page computes."""


@dataclass(frozen=True)
class Episodes:
    """Functions of a policy, its task and its arm in a page.

    Attributes:
        functions: those of the environment, as it measures the arm.
        policy: the policy.
        like: a state that shows what others are made of.
    """

    functions: EnvFunctions
    policy: Policy
    like: EnvState


def programs(env: Env, policy: Policy, begin: Begin) -> list[Program]:
    """Programs of a policy in an environment whose episodes begin like those that are given.

    What either agent commands, what a step led to, a goal that is asked for anew, one that is put somewhere, and the
    links.

    Raises:
        InputError: one of them computes what cannot be printed.
    """
    functions, chain = replace(as_measured(env.functions), limits=env.functions.limits), env.setup.robot.chain
    page = Episodes(functions, policy, example_state(functions, begin))
    like, asked = page.like, decision_inputs(env, page.like)
    goal = {GOAL + field.name: getattr(like.goal, field.name) for field in fields(like.goal)}
    goal = {name: ShapeDtypeStruct(part.shape[1:], part.dtype) for name, part in goal.items() if part.size}
    asked |= goal
    stepped = asked | {"clock": ShapeDtypeStruct((1,), jnp.int32), "wanted": asked["command"]}
    leaves = enumerate(jax.tree.leaves(like.progress))
    stepped |= {f"{PROGRESS}{i}": ShapeDtypeStruct(leaf.shape[1:], leaf.dtype) for i, leaf in leaves}
    moved = {name: shape for name, shape in asked.items() if name in ("q", "qd") or name.startswith(BODIES)}
    stepped |= {MOVED + name: shape for name, shape in moved.items()} | {"action": asked["last_action"]}
    stepped |= {"contact": ShapeDtypeStruct((1,), jnp.bool_)} if env.setup.task.scene(env.setup).contacts else {}
    placed = goal | {"q": asked["q"], "position": goal[GOAL + "position"]}
    decided = asked | {"instead": asked["command"]}
    return [
        *(trace(agent, lambda agent=agent, **given: _decide(page, agent, given), decided) for agent in PLAYED),
        trace("judge", lambda **given: _judge(page, given), stepped),
        trace("ask", lambda **given: _ask(page, given), asked),
        trace("place", lambda **given: _place(page, given), placed),
        trace("links", lambda q: links_of(chain, q[: chain.n]), {"q": asked["q"]}),
    ]


def _decide(page: Episodes, agent: str, given: Mapping[str, Array]) -> dict[str, Array]:
    """Action and command of an agent; a joint command `instead` is taken where it is a number."""
    functions, setup = page.functions, page.functions.setup
    state = measured_state(functions, page.like, given)
    now = functions.situation(state)
    if agent == "trained":
        action, memory = page.policy.decide(functions.observe(state), state.memory)
    else:
        action, memory = ACTIONS[setup.rules.action].towards(setup, now, now), state.memory
    action, command, _ = replace(functions, limits=None).command(state, action, None)
    wanted, motion = functions.shaped(state, jnp.where(jnp.isnan(given["instead"]), command, given["instead"]))
    parts = {"action": action, "wanted": wanted} | motion_parts(motion)
    return {name: part[0] for name, part in parts.items()} | remembered_as(MEMORY, memory)


def _judge(page: Episodes, given: Mapping[str, Array]) -> dict[str, Array]:
    """State after a control step, and what it led to."""
    functions, n = page.functions, page.functions.setup.robot.chain.n
    leaves = [given[f"{PROGRESS}{i}"][None] for i in range(len(jax.tree.leaves(page.like.progress)))]
    progress = jax.tree.unflatten(jax.tree.structure(page.like.progress), leaves)
    state = replace(measured_state(functions, page.like, given), clock=given["clock"], progress=progress)
    bodies = bodies_of(page.like, {name.removeprefix(MOVED): part for name, part in given.items() if MOVED in name})
    q, qd = given[f"{MOVED}q"][None], given[f"{MOVED}qd"][None]
    moved = Moved(q[:, :n], qd[:, :n], bodies, given.get("contact", state.arm.contact), q[:, n:])
    after, transition = functions.judge(state, moved, given["wanted"][None], given["action"][None], state.motion)
    ended = {"success": transition.terms["success"], "terminated": transition.terminated, "done": transition.done}
    return arrays_of(functions.setup, after) | ended | {"counted": transition.counted.distance}


def _ask(page: Episodes, given: Mapping[str, Array]) -> dict[str, Array]:
    """State of an arm that is asked for a goal from now on, and has all the time of an episode."""
    state = measured_state(page.functions, page.like, given)
    state = replace(state, progress=page.functions.setup.task.begin(page.functions.setup, state.errors))
    return arrays_of(page.functions.setup, state)


def _place(page: Episodes, given: Mapping[str, Array]) -> dict[str, Array]:
    """The goal put at a position, turned as it was, and whether the arm can be there."""
    setup, goal = page.functions.setup, goal_of(page.like, given)
    turned = goal.quaternion[0] if goal.quaternion.size else jnp.array(setup.robot.held_quaternion)
    placed, reached = setup.task.place(setup, goal, given["position"], turned, given["q"])
    parts = {GOAL + field.name: getattr(placed, field.name)[0] for field in fields(placed)}
    return {name: part for name, part in parts.items() if part.size} | {"reached": reached[None]}


def links_of(chain: Any, q: Array) -> dict[str, Array]:
    """Axes `[n, 3, 3]`, a row each, and positions `[n, 3]` m of the links and of the tool after them."""
    tool = forward_kinematics(chain, q)
    frames = [*link_frames(chain, components(q))[1:]]
    frames.append((rotation_from_quaternion(*components(tool.quaternion)), Vec(*components(tool.position))))
    rotations = [
        jnp.stack([jnp.asarray(number, q.dtype) for axis in rotation for number in axis]) for rotation, _ in frames
    ]
    positions = [jnp.stack([jnp.asarray(number, q.dtype) for number in position]) for _, position in frames]
    return {"axes": jnp.concatenate(rotations), "positions": jnp.concatenate(positions)}


def arrays_of(setup: TaskSetup, state: EnvState) -> dict[str, Array]:
    """A state as arrays by name, what is empty left out; and where the tool is, and whether it is at the goal."""
    errors = state.errors
    speeds = jnp.concatenate([state.arm.qd, jnp.zeros_like(state.arm.opening)], axis=-1)
    named = {"q": state.arm.actuated, "qd": speeds, "command": state.command, "last_action": state.last_action}
    named |= {"tool": state.arm.tool_position, "angle": errors.angle[:, None]}
    named |= {GOAL + field.name: getattr(state.goal, field.name) for field in fields(state.goal)}
    named |= {BODIES + field.name: getattr(state.arm.bodies, field.name) for field in fields(state.arm.bodies)}
    named |= {f"{PROGRESS}{i}": leaf for i, leaf in enumerate(jax.tree.leaves(state.progress))}
    named |= motion_parts(state.motion)
    single = {"clock": state.clock, "distance": errors.distance, "near": setup.task.near(setup.rules, errors)}
    return {name: part[0] for name, part in named.items() if part.size} | single | remembered_as(MEMORY, state.memory)


@functools.lru_cache(maxsize=1)
def _sampler(env: Env) -> Callable[[np.ndarray, np.ndarray], Begin]:
    """Program that samples the begins of episodes of seeds and numbers, `DRAWN` of each."""

    def sample(seeds: Array, numbers: Array) -> Begin:
        keys = jax.vmap(lambda seed, number: jax.random.fold_in(stream_key(seed, REPORT_STREAM), number))
        return env.functions.sample_episode(keys(seeds, numbers), held_out=True)

    return jit(sample, brief=True)


def sampled(env: Env, episodes: Sequence[tuple[int, int]]) -> Begin:
    """Begins of held-out episodes given by seed and number, one after the other until there are `DRAWN`."""
    return _sampler(env)(*np.resize(np.array(episodes, np.uint32), (DRAWN, 2)).T)


def drawn(env: Env, begin: Begin) -> dict[str, np.ndarray]:
    """Joints, goals and bodies `[B, …]` by name in which episodes begin; a gripper is wide open."""
    gripper, count = env.setup.robot.gripper, len(begin.q)
    openings = np.full((count, 1), gripper.widest) if gripper else np.zeros((count, 0))
    parts = {"q": np.concatenate([begin.q, openings], axis=1)}
    parts |= {GOAL + field.name: getattr(begin.goal, field.name) for field in fields(begin.goal)}
    parts |= {BODIES + field.name: getattr(begin.bodies, field.name) for field in fields(begin.bodies)}
    limits = env.functions.limits
    parts |= motion_parts(limits.at_rest(parts["q"], jnp) if limits else None)
    return {
        name: np.asarray(part, part.dtype if part.dtype.kind == "i" else np.float32)
        for name, part in parts.items()
        if part.size
    }
