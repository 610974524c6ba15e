"""Imitation of planned ways: a policy acts, and learns the heading that a planner would have taken where it has come.

As DAgger (Ross, Gordon, Bagnell, arXiv:1011.0686), and from all of the way that was planned there.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from reachlab.agents.policy import Inputs, Parameters, distribution
from reachlab.control.bodies import Bodies
from reachlab.control.planning.workers import Workers
from reachlab.control.situation import Goal, Situation
from reachlab.envs.core import Env
from reachlab.jax_setup import jit
from reachlab.learn.learner import Learner, make_learner, make_optimiser
from reachlab.learn.method import Finite, Method, Watched, all_finite
from reachlab.learn.planned import LESSONS, Asked, teachers
from reachlab.learn.ppo_method import TrainState, initial_state
from reachlab.learn.rollout import episode_statistics, host_collector
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError, installing
from reachlab.tasks.observations import observe
from reachlab.tasks.scenes.sampling import drawn_anew
from reachlab.tasks.task import TaskSetup

PLANS = 24_000
"""Planned ways that are kept to learn from."""

FRESH = 128
"""Scenes in an iteration that are drawn to plan in, at least: what is learnt of few of them fails in others."""

PARTS = 8
"""Parts of what is planned in an iteration, which processes share: each draws scenes of one kind."""

UPDATES, BATCH = 200, 512
"""Gradient steps of an iteration, and joint vectors of a step."""

DECAY = 0.5
"""Share of the weights that is taken off in a step, in proportion to the learning rate: else what is learnt of few
thousand ways is learnt by heart."""

SMOOTH = 1e-4
"""Added to the square of how far a heading is off. Its length is learnt from, not the square: of two ways the more
frequent is taken rather than their mean."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Lessons:
    """The last `N` planned ways, each known by `P` joint vectors, the oldest overwritten first.

    Attributes:
        q: joints on the way `[N, P, n]`.
        heading: the action to be taken there `[N, P, n]`.
        goal: where the way leads `[N, ...]`.
        bodies: what it leads among `[N, K]`.
        count: ways so far `[]`.
    """

    q: Array
    heading: Array
    goal: Goal
    bodies: Bodies
    count: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ImitationState(TrainState):
    """All that training changes, and what it learns from: enough to continue from."""

    lessons: Lessons


def _initial_state(env: Env, config: RunConfig, seed: int | Array, _given: Any) -> ImitationState:
    """State before the first iteration."""
    begun = initial_state(env, config, seed)
    empty = partial(jax.tree.map, lambda x: np.zeros((PLANS, *x.shape[1:]), x.dtype))
    q: Any = np.zeros((PLANS, LESSONS, env.setup.robot.chain.n), np.float32)
    lessons = Lessons(q, q.copy(), empty(begun.env.goal), empty(begun.env.arm.bodies), jnp.zeros((), jnp.int32))
    learner = make_learner(make_optimiser(config, UPDATES, DECAY), begun.learner.policy)
    return ImitationState(learner, begun.env, begun.key, lessons)


def _compile_iteration(env: Env, config: RunConfig, *_: Any) -> Callable[[ImitationState], tuple[Any, Watched]]:
    """See `Method.compile_iteration`: the policy acts, ways are planned from where it has come, and it learns them."""
    asked, act, learn = teachers(env), host_collector(), jit(partial(_learn, env))

    def iterate(state: ImitationState) -> tuple[ImitationState, Watched]:
        key, for_acting, for_planning, for_learning = jax.random.split(state.key, 4)
        lessons, known = _planned(asked, env.setup.rules.scene, state, for_planning)
        learner, losses = learn(state.learner, lessons, min(max(known, 1), PLANS), for_learning)
        after, rollout = act(env, learner.policy, state.env, for_acting, config.loop)
        metrics = {**episode_statistics(rollout), **losses, "plans": jnp.asarray(known)}
        learner = replace(learner, steps=learner.steps + config.loop.iteration_steps)
        new = ImitationState(learner, after, key, lessons)
        finite = map(
            all_finite, (rollout.observation, rollout.output, rollout.reward, after, metrics, metrics, learner)
        )
        watched = Watched(metrics, Finite(*finite), rollout)
        return (new if watched.sound else state), watched

    return iterate


def _planned(teachers: Workers, kinds: Sequence[str], state: ImitationState, key: Array) -> tuple[Lessons, int]:
    """Lessons with ways in fresh scenes and from where the arms are, and how many there have been by then."""
    lessons: Lessons = jax.tree.map(np.array, state.lessons)
    rng, known = np.random.default_rng(np.asarray(jax.random.key_data(key))), int(lessons.count)
    beside: Any = jax.tree.map(np.asarray, (state.env.arm.q, state.env.goal.joints, state.env.arm.bodies))
    arms = [jax.tree.map(lambda x, row=row: x[row], beside) for row in range(len(beside[0]))]
    first = int(rng.integers(len(kinds)))
    asked = [
        Asked(int(rng.integers(1, 2**30)), kinds[(first + part) % len(kinds)], FRESH // PARTS, arms[part::PARTS])
        for part in range(PARTS)
    ]
    for lesson, bodies in itertools.chain.from_iterable(teachers.map(asked)):
        row = known % PLANS
        lessons.q[row], lessons.heading[row] = lesson.q, lesson.heading
        lessons.goal.position[row], lessons.goal.joints[row] = lesson.position, lesson.joints
        jax.tree.map(lambda rows, one, row=row: operator.setitem(rows, row, one), lessons.bodies, bodies)
        known += 1
    return replace(lessons, count=jnp.asarray(known, jnp.int32)), known


def _learn(env: Env, learner: Learner, lessons: Lessons, known: Array, key: Array) -> tuple[Learner, dict[str, Array]]:
    """Learner after the gradient steps of an iteration, and the means of what they are judged by."""

    def update(learner: Learner, key: Array) -> tuple[Learner, dict[str, Array]]:
        for_way, for_point = jax.random.split(key)
        ways = jax.random.randint(for_way, (BATCH,), 0, known)
        points = jax.random.randint(for_point, (BATCH,), 0, LESSONS)
        goal, bodies = jax.tree.map(lambda x: x[ways], (lessons.goal, lessons.bodies))
        seen = observe(env.setup, _at_rest(env.setup, lessons.q[ways, points], goal, bodies))
        policy, wanted = learner.policy.observed(seen), lessons.heading[ways, points]
        inputs: Inputs = policy.inputs(seen)

        def loss(parameters: Parameters) -> Array:
            off = jnp.square(distribution(parameters, inputs).mean - wanted).sum(axis=-1)
            return jnp.sqrt(off + SMOOTH).mean()

        error, gradient = jax.value_and_grad(loss)(policy.parameters)
        optimiser, before = make_optimiser(env.config, UPDATES, DECAY), cast("optax.Params", policy.parameters)
        change, state = optimiser.update(cast("optax.Updates", gradient), learner.optimiser, before)
        policy = replace(policy, parameters=jax.tree.map(jnp.add, policy.parameters, change))
        judged = {"heading_error": error, "gradient_norm": optax.tree.norm(gradient)}
        return replace(learner, policy=policy, optimiser=state), judged

    learner, judged = jax.lax.scan(update, learner, jax.random.split(key, UPDATES))
    return learner, jax.tree.map(jnp.mean, judged)


def _at_rest(setup: TaskSetup, q: Array, goal: Goal, bodies: Bodies) -> Situation:
    """Situations of arms that rest at joints `q [B, n]`."""
    tool, none = forward_kinematics(setup.robot.chain, q), jnp.zeros((len(q), 0))
    return Situation(q, jnp.zeros_like(q), *tool, goal, q, jnp.zeros_like(q), bodies, none, tool, none)


def _check(config: RunConfig, _resume: bool) -> None:
    """Make sure that ways can be planned, and that what is observed can be told of an arm at rest.

    Raises:
        InputError: it cannot, or the policy remembers something; OMPL is not installed, or scenes are drawn as episodes
            begin.
    """
    rules: Any = config.rules
    if drawn_anew(rules.scene):
        raise InputError("an action 'heading' is learnt among furniture: choose --scene wall, or another.")
    if not find_spec("ompl"):
        raise InputError(f"an action 'heading' is learnt from OMPL's plans: {installing('planner')}.")
    if rules.observation != "ways" or config.learner.memory:
        raise InputError(
            "an action 'heading' is learnt of planned ways, of which joints alone are known: choose --observation ways,"
            " and no --memory."
        )


IMITATION = Method(_check, _initial_state, _compile_iteration)
"""Imitation of planned ways."""
