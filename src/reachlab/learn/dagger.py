"""Learning to see from a teacher that knows the state: DAgger (Ross, Gordon, Bagnell, arXiv:1011.0686).

The student acts on what it sees, the teacher says what it would have done there, and the student learns that of
everything seen so far.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from reachlab.agents.policy import Normaliser, Parameters, Policy, distribution, features
from reachlab.envs.core import Env, EnvState, Transition
from reachlab.envs.streams import LEARNER_STREAM, TRAINING_STREAM, episode_keys, stream_key
from reachlab.jax_setup import jit
from reachlab.learn import ppo
from reachlab.learn.dagger_buffer import Album, Memory, make_memory, remember
from reachlab.learn.method import (
    Finite,
    Method,
    Watched,
    all_finite,
    make_initial_policy,
)
from reachlab.robots.loading import Robot
from reachlab.settings.config import DistilRunConfig, RunConfig, override
from reachlab.settings.validation import InputError
from reachlab.tasks import reach as task
from reachlab.tasks.reach import OBSERVATIONS

PLACES = 6
"""The first features are taught where target and tool are: three numbers each."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DistilState:
    """All that a distillation changes, and its teacher: enough to go on from."""

    learner: ppo.Learner
    env: EnvState
    key: Array
    memory: Memory
    teacher: Policy


def dagger(teacher: Policy | None) -> Method:
    """Method that learns from a teacher; from that of its checkpoint if it is gone on with."""

    def initial_state(env: Env, config: RunConfig, seed: int | Array) -> DistilState:
        return _initial_state(env, check_distillation(config), seed, teacher)

    return Method(initial_state, lambda env, config, _: _Lessons(env, check_distillation(config)).iterate)


def check_distillation(config: RunConfig) -> DistilRunConfig:
    """The configuration, if it is one that can be learnt with.

    Raises:
        InputError: it is none of a distillation, or of another simulator, observation or teacher than can be used.
    """
    if not isinstance(config, DistilRunConfig):
        raise InputError("a distillation needs a teacher: see `reachlab distil --help`.")
    if config.sim == "pybullet":
        raise InputError(
            "a distillation draws with MuJoCo: choose --sim kinematic or mujoco, and evaluate in pybullet."
        )
    if not OBSERVATIONS[config.rules.observation].pictured:
        raise InputError(f"observation {config.rules.observation!r} holds no picture to learn from: image, image+tool.")
    if OBSERVATIONS[config.teacher_observation].pictured:
        raise InputError(
            "a teacher has to know the state, and this one sees pictures: train one with another observation."
        )
    iterations = -(-config.ppo.total_steps // config.ppo.iteration_steps)
    if config.distil.guided >= iterations:
        raise InputError(
            f"the teacher would act in all {iterations} iterations of {config.ppo.iteration_steps:,} steps, as guided"
            f" is {config.distil.guided}: choose a lower --guided or --action-repeat, or more --total-steps."
        )
    if config.distil.capacity < config.ppo.num_envs:
        raise InputError(f"capacity must be at least the {config.ppo.num_envs} lanes, got {config.distil.capacity}.")
    return config


def _initial_state(env: Env, config: DistilRunConfig, seed: int | Array, teacher: Policy | None) -> DistilState:
    key, for_policy = jax.random.split(stream_key(seed, LEARNER_STREAM))
    policy = jit(lambda key: make_initial_policy(config, env, key))(for_policy)
    if teacher is None:
        knowing = Env(override(config, observation=config.teacher_observation), 1)
        teacher = make_initial_policy(knowing.config, knowing, for_policy)
    state = env.init(episode_keys(seed, TRAINING_STREAM, 0, config.ppo.num_envs))
    optimiser = _optimiser(config).init(policy.parameters)
    return DistilState(ppo.Learner(policy, optimiser), state, key, make_memory(state, config.distil.capacity), teacher)


def _optimiser(config: DistilRunConfig) -> optax.GradientTransformation:
    return ppo.make_optimiser(config.ppo, config.distil.updates)


class _Lessons:
    """Iterations of a distillation: pictures are drawn beside JAX, all else is compiled."""

    def __init__(self, env: Env, config: DistilRunConfig) -> None:
        self._env, self._config = env, config
        taught = override(config, observation=config.teacher_observation).rules
        self._known = replace(env.reach, config=taught)
        self._album = Album(env, config.distil.capacity)
        self._decide, self._remember, self._learn = jit(self._decision), jit(remember), jit(self._update)
        self._finite = jit(_finite)

    def iterate(self, state: DistilState) -> tuple[DistilState, Watched]:
        """State after pictures were collected and learnt from, and what it is judged by."""
        self._album.complete(state.memory)
        key, for_acting, for_learning = jax.random.split(state.key, 3)
        collected, tally = self._collect(state, for_acting)
        learner, losses = self._study(collected.learner, collected.memory, for_learning)
        metrics = {**_statistics(tally), **losses, "pictures": collected.memory.count}
        new = replace(collected, learner=learner, key=key)
        watched = Watched(metrics, self._finite(new, metrics), new.memory.label)
        return (new if watched.sound else state), watched

    def _collect(self, state: DistilState, key: Array) -> tuple[DistilState, Counter[str]]:
        """State with more pictures in its memory, and what became of the student's episodes that ended."""
        settings, lanes, memory = self._config.distil, state.env, state.memory
        policy, tally = state.learner.policy, Counter[str]()
        loop = self._config.ppo
        guided = int(memory.count) < settings.guided * loop.rollout_steps * loop.num_envs
        for now in jax.random.split(key, loop.rollout_steps):
            picture = self._env.see(lanes)
            label, action, normaliser = self._decide(state.teacher, policy, lanes, picture, now, guided)
            memory, policy = self._remember(memory, lanes, label), replace(policy, normaliser=normaliser)
            self._album.add(cast("np.ndarray", picture))
            # The action is held, as nobody learns from pictures that hardly differ.
            lanes = self._begun_anew(*self._env.step(lanes, action, loop.action_repeat), tally)
        learner = replace(state.learner, policy=policy)
        return replace(state, learner=learner, env=lanes, memory=memory), Counter() if guided else tally

    def _begun_anew(self, lanes: EnvState, transition: Transition, tally: Counter[str]) -> EnvState:
        """BatchArray of which those that ended are counted and begin anew."""
        done = np.asarray(transition.done)
        if not done.any():
            return lanes
        ended = {name: np.asarray(transition.terms[name])[done] for name in ("success", "distance")}
        tally.update(episodes=int(done.sum()), successes=int(ended["success"].sum()))
        tally.update(steps=int(np.asarray(lanes.clock)[done].sum()), millimetres=round(1000 * ended["distance"].sum()))
        return self._env.reset(lanes, done)

    def _decision(
        self, teacher: Policy, policy: Policy, state: EnvState, picture: Array, key: Array, guided: bool
    ) -> tuple[Array, Array, Normaliser]:
        """The teacher's action `[B, a]`, the one that is taken, and what the student knows of what it observes."""
        observation = self._env.observe(state, picture)
        label, own = teacher.act(task.observe(self._known, self._env.situation(state))), policy.act(observation)
        if self._config.rules.clip_actions:
            label = jnp.clip(label, *self._env.action_bounds)
        noise = self._config.distil.noise * policy.half * jax.random.normal(key, label.shape)
        action = jnp.clip(jnp.where(guided, label, own) + noise, *self._env.action_bounds)
        return label, action, policy.normaliser.update(observation)

    def _study(self, learner: ppo.Learner, memory: Memory, key: Array) -> tuple[ppo.Learner, dict[str, Array]]:
        """Learner after the gradient steps of an iteration, and the means of their losses."""
        settings = self._config.distil
        known = min(int(memory.count), settings.capacity)
        batches = np.asarray(jax.random.randint(key, (settings.updates, settings.batch), 0, known))
        watched = []
        for rows in batches:
            learner, losses = self._learn(learner, memory, rows, self._album[rows])
            watched.append(losses)
        return learner, {name: jnp.mean(jnp.array([losses[name] for losses in watched])) for name in watched[0]}

    def _update(
        self, learner: ppo.Learner, memory: Memory, rows: Array, pictures: Array
    ) -> tuple[ppo.Learner, dict[str, Array]]:
        policy, optimiser = learner.policy, _optimiser(self._config)
        target, tool, label = memory.target[rows], memory.tool[rows], memory.label[rows]
        seen = task.observe(self._env.reach, task.pictured_situation(pictures, tool))
        observation, wanted = policy.normaliser(seen), (label - policy.centre) / policy.half
        places = jnp.concatenate([_in_workspace(self._env.reach.robot, point) for point in (target, tool)], axis=-1)

        def loss(parameters: Parameters) -> tuple[Array, dict[str, Array]]:
            action = distribution(parameters, observation).mean - wanted
            place = features(parameters, observation)[..., :PLACES] - places
            errors = {"action_error": jnp.square(action).mean(), "place_error": jnp.square(place).mean()}
            return errors["action_error"] + self._config.distil.place_weight * errors["place_error"], errors

        gradient, errors = jax.grad(loss, has_aux=True)(policy.parameters)
        change, state = optimiser.update(gradient, learner.optimiser)
        parameters = jax.tree.map(jnp.add, policy.parameters, change)
        watched = errors | {"gradient_norm": optax.tree.norm(gradient)}
        return ppo.Learner(replace(policy, parameters=parameters), state), watched


def _in_workspace(robot: Robot, point: Array) -> Array:
    """Point `[..., 3]` m from the workspace's middle, in halves of its edges."""
    low, high = (jnp.array(corner) for corner in robot.workspace)
    return (2 * point - high - low) / (high - low)


def _statistics(tally: Counter[str]) -> dict[str, Array]:
    """As `rollout.episode_statistics`, of the episodes that were counted."""
    episodes = tally["episodes"]
    shares = {
        "success_rate": tally["successes"],
        "episode_length": tally["steps"],
        "final_distance": tally["millimetres"] / 1000,
    }
    return {"episodes": jnp.asarray(episodes)} | {
        name: jnp.asarray(total / max(episodes, 1)) for name, total in shares.items()
    }


def _finite(state: DistilState, metrics: dict[str, Array]) -> Finite:
    fine = jnp.array(True)
    return Finite(
        observation=fine,
        action=all_finite(state.memory),
        reward=fine,
        environment=all_finite(replace(state.env, recent=None)),
        gradient=all_finite(metrics["gradient_norm"]),
        loss=all_finite(metrics),
        parameter=all_finite(state.learner),
    )
