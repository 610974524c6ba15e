"""Held-out episodes: an agent plays each of them to its end, once."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.agents.acting import Function, make_act
from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.random_streams import AGENT_STREAM, episode_keys
from reachlab.evaluation.handled import Handled, begin_handling
from reachlab.evaluation.self_contact import Meets, make_meets
from reachlab.evaluation.straight import make_straight
from reachlab.jax_setup import jit
from reachlab.sims.simulator import chosen
from reachlab.tasks.task import TaskSetup
from reachlab.traced import kept

FEW = 20_000
"""Episodes up to which those of a simulator in JAX take less time than a thorough compiler."""

Carry = tuple[EnvState, "Episodes", Array]
"""States under way, what is known of their episodes, and the agent's key."""


class Step(NamedTuple):
    """A step of `B` episodes: the state before it, the command `[B, m]` [rad or m] and the reward `[B]`."""

    state: EnvState
    command: Array
    reward: Array


Keep = Callable[[Step], None]
"""Called with each step that is taken."""

Watch = Callable[[int], None]
"""Called with the number of episodes that have ended."""

BATCH = 1000
"""Episodes evaluated together where everything is traced; one size, so one compiled program."""


def ignore(ended: int) -> None:
    """Nothing, of whatever number of episodes has ended."""


class Track(NamedTuple):
    """Where the goal was and how fast, and where the tool was, after each step of `B` episodes: `[B, T, 3]` m, m/s."""

    goal: np.ndarray
    velocity: np.ndarray
    tool: np.ndarray


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Episodes:
    """Outcome of `B` episodes.

    Attributes:
        goal: where the tool was asked to be, `[B, 3]` [m].
        done: the episode has ended `[B]`; nothing of it changes any more.
        success: it ended in success `[B]`.
        terminated: the task ended it, rather than the clock `[B]`.
        distance: the error that counts at its end `[B]` [m], see `Task.counted`.
        angle: that of the orientation `[B]` [rad]; zero where any will do.
        steps: its length `[B]`.
        arrival: step from which on the tool stays within the distance of success `[B]`.
        returns: sum of its rewards `[B]`.
        max_speed: largest joint speeds in it `[B, n]` [rad/s].
        squared_jerk: sum over its steps of the squared jerk, mean of the joints `[B]` [rad²/s⁶].
        motion: joint positions, displacement and its change at the last step, three `[B, n]`.
        touched: links of the arm met in it `[B]`, by their exact shapes, see `self_contact.meeting`; None where joints
            are set, rather than moved by dynamics, or where no links could meet.
        track: where goal and tool were after each of its steps; None where the goal does not move.
        contact: the arm touched anything in it `[B]`, where the engine judges contacts.
        straight: nothing was in the way of the arm, had its joints moved straight to those at the goal `[B]`; None
            where nothing is beside it.
        planned: time that planning took `[B]` [s]; None of an agent that does not plan.
        force: largest force at the wrist in it `[B]` [N]; None where it is not measured.
        handled: what became of the object in it; None where there is none.
    """

    goal: Array
    done: Array
    success: Array
    terminated: Array
    distance: Array
    angle: Array
    steps: Array
    arrival: Array
    returns: Array
    max_speed: Array
    squared_jerk: Array
    motion: tuple[Array, Array, Array]
    contact: Array
    touched: Array | None = None
    track: Track | None = None
    straight: Array | None = None
    planned: Array | None = None
    force: Array | None = None
    handled: Handled | None = None


class Beside(NamedTuple):
    """What is found out beside the steps of episodes, where it can be.

    Attributes:
        meets: whether links of the arm meet.
        straight: in which of states `[B]` nothing is in the way.
        planned: time that the agent has planned in each episode `[B]` [s].
        keep: keeps steps.
    """

    meets: Meets | None
    straight: Callable[[EnvState], np.ndarray] | None
    planned: Callable[[], np.ndarray] | None
    keep: Keep | None


@dataclass(frozen=True)
class Runner:
    """`run(policy, keys)` runs one episode for each of `num_envs` keys to its end.

    On the host it takes a `Watch` too, and calls it after every step.
    """

    run: Callable[..., Episodes]
    num_envs: int
    on_host: bool = False


def make_runner(env: Env, agent: str | Function, episodes: int = FEW, keep: Keep | None = None) -> Runner:
    """Runner for an agent of `agents.AGENTS`, or for a function, which is going to run so many episodes.

    Those of which steps are kept are to learn from: they are none of those that are held out, see `Env.init_held_out`.
    """
    moves = env.setup.rules.moves
    traced = env.traced and isinstance(agent, str) and not moves and keep is None
    init = env.init if keep else env.init_held_out
    init = init if traced else env.compile_whole(init)
    meets = None if traced or keep else make_meets(env)

    def unplayed(state: EnvState, keys: Array) -> tuple[Episodes, Array]:
        begun = _unplayed(state, env.setup, judged=meets is not None)
        return begun, jax.random.fold_in(keys[0], AGENT_STREAM)

    first = env.compile_part(unplayed, meets is not None)

    def begin(keys: Array) -> Carry:
        state = init(keys)
        return state, *first(state, keys)

    act = make_act(env, agent)

    def count(episodes: Episodes, state: EnvState, transition: Transition) -> Episodes:
        return _count(episodes, state, transition, setup=env.setup)

    count_step = env.compile_part(count, "episodes")

    def advance(policy: Policy | None, carry: Carry) -> tuple[Carry, Array]:
        state, episodes, key = carry
        state, transition, key = act(policy, state, key, ~episodes.done)
        return (state, count_step(episodes, state, transition), key), transition.reward

    if traced:

        def run(policy: Policy | None, keys: Array) -> Episodes:
            carry = begin(keys)
            return jax.lax.while_loop(lambda c: ~c[1].done.all(), lambda c: advance(policy, c)[0], carry)[1]

        return Runner(jit(kept(run, f"episodes of {agent}", env.identity), brief=episodes <= FEW), BATCH)

    if env.traced and isinstance(agent, str):
        advance = jit(advance)
    elif env.traced:
        count_step = jit(count_step, brief=True)
    beside = Beside(meets, None if keep else make_straight(env), getattr(act, "planned", None), keep)
    return Runner(functools.partial(_run_on_host, begin, advance, beside, moves=moves), env.num_envs, on_host=True)


def _run_on_host(
    begin: Callable[[Array], Carry],
    advance: Callable[[Policy | None, Carry], tuple[Carry, Array]],
    beside: Beside,
    policy: Policy | None,
    keys: Array,
    watch: Watch = ignore,
    *,
    moves: bool,
) -> Episodes:
    carry, tracks, meets = begin(keys), [], beside.meets
    found: dict[str, Any] = {} if beside.straight is None else {"straight": beside.straight(carry[0])}
    while (ended := int(np.asarray(carry[1].done).sum())) < len(keys):
        watch(ended)
        started, before = carry[:2]
        carry, reward = advance(policy, carry)
        if beside.keep:
            beside.keep(Step(started, carry[0].command, reward))
        if meets:  # which episodes have ended or met before is known
            state, now, key = carry
            touched = np.asarray(now.touched)
            touched = touched | meets(now.motion[0], ~(np.asarray(before.done) | touched))
            carry = state, replace(now, touched=touched), key
        if moves:
            goal = carry[0].goal
            tracks.append((goal.position, goal.velocity, carry[0].arm.tool_position))
    found |= {"track": Track(*np.stack(tracks, axis=2))} if moves else {}
    found |= {} if beside.planned is None else {"planned": beside.planned()}
    return replace(carry[1], **found)


def _unplayed(state: EnvState, setup: TaskSetup, *, judged: bool) -> Episodes:
    """Episodes before their first step; whether links meet in them may be `judged`."""
    count, still = len(state.clock), jnp.zeros_like(state.arm.q)
    return Episodes(
        goal=state.goal.position,
        done=jnp.zeros(count, bool),
        success=jnp.zeros(count, bool),
        terminated=jnp.zeros(count, bool),
        distance=state.distance,
        angle=setup.task.counted(state.errors, state.progress).angle,
        steps=jnp.zeros(count, jnp.int32),
        arrival=(~setup.task.near(setup.rules, state.errors)).astype(jnp.int32),
        returns=jnp.zeros(count),
        max_speed=still,
        squared_jerk=jnp.zeros(count),
        motion=(state.arm.q, still, still),
        touched=jnp.zeros(count, bool) if judged else None,
        contact=state.arm.contact,
        force=state.arm.force,
        handled=begin_handling(state.arm, setup),
    )


def _count(episodes: Episodes, state: EnvState, transition: Transition, setup: TaskSetup) -> Episodes:
    """Episodes after a step; those that have ended stay as they are."""
    q, moved, change = episodes.motion
    moved_now = state.arm.q - q
    change_now = moved_now - moved
    jerk = jnp.square((change_now - change) / setup.period**3).mean(-1)
    new = replace(
        episodes,
        done=transition.done,
        success=transition.terms["success"],
        terminated=transition.terminated,
        distance=transition.counted.distance,
        angle=transition.counted.angle,
        steps=episodes.steps + 1,
        arrival=jnp.where(setup.task.near(setup.rules, state.errors), episodes.arrival, episodes.steps + 2),
        returns=episodes.returns + transition.reward,
        max_speed=jnp.maximum(episodes.max_speed, jnp.abs(state.arm.qd)),
        squared_jerk=episodes.squared_jerk + jerk,
        motion=(state.arm.q, moved_now, change_now),
        contact=episodes.contact | state.arm.contact,
        force=None if episodes.force is None else jnp.maximum(episodes.force, state.arm.force),
        handled=episodes.handled and episodes.handled.after(state.arm, setup),
    )
    return chosen(episodes.done, episodes, new)


def run_episodes(
    runner: Runner, policy: Policy | None, seed: int, stream: int, episodes: int, first: int = 0, watch: Watch = ignore
) -> Episodes:
    """Exactly `episodes` episodes of a seed's stream from number `first` on, as NumPy arrays."""
    parts = []
    for done in range(0, episodes, runner.num_envs):

        def watch_all(ended: int, before: int = done) -> None:
            watch(min(before + ended, episodes))

        keys = episode_keys(seed, stream, first + done, runner.num_envs)
        part = runner.run(policy, keys, watch_all) if runner.on_host else runner.run(policy, keys)
        watch_all(runner.num_envs)
        # Episodes beyond the last one asked for ran too; they do not count.
        parts.append(jax.tree.map(lambda x, left=episodes - done: np.asarray(x)[:left], part))
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)
