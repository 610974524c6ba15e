"""DAgger: learning to act on pictures from a teacher that knows the state (Ross, Gordon, Bagnell, arXiv:1011.0686).

The student acts on what it observes, the teacher says what it would have done there, and the student learns that of
everything observed so far.
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

from reachlab.agents.encoder import Keypoints
from reachlab.agents.policy import Inputs, Memory, Parameters, Policy, encoded, features, gaussian, remembered
from reachlab.envs.core import Env
from reachlab.envs.delays import goal_seen
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.random_streams import LEARNER_STREAM, TRAINING_STREAM, episode_keys, stream_key
from reachlab.jax_setup import jit
from reachlab.learn.dagger_buffer import DaggerBuffer, Pictures, add, make_buffer, sequences
from reachlab.learn.learner import Learner, make_initial_policy, make_learner, make_optimiser
from reachlab.learn.load import load_policy
from reachlab.learn.method import Finite, Method, Watched, all_finite
from reachlab.runs.shipped import find_run
from reachlab.settings.config import DistilRunConfig, RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.tasks import actions
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DistilState:
    """All that a distillation changes, and its teacher: enough to continue from."""

    learner: Learner
    env: EnvState
    key: Array
    buffer: DaggerBuffer
    teacher: Policy


def check_distillation(config: RunConfig) -> DistilRunConfig:
    """The configuration, if it is one that can be learnt with.

    Raises:
        InputError: it is not that of a distillation, or of a simulator, observation or teacher that cannot be used.
    """
    if not isinstance(config, DistilRunConfig):
        raise InputError("a distillation needs a teacher: see `reachlab distil --help`.")
    if not SIMULATORS[config.sim].draws_anything:
        others = " or ".join(name for name, entry in SIMULATORS.items() if entry.draws_anything)
        raise InputError(
            f"a distillation draws past pictures again, which {config.sim} cannot: choose --sim {others}, and evaluate"
            f" in {config.sim}."
        )
    if not OBSERVATIONS[config.rules.observation].pictured:
        pictured = " or ".join(name for name, design in OBSERVATIONS.items() if design.pictured)
        raise InputError(f"observation {config.rules.observation!r} holds no picture to learn from: choose {pictured}.")
    if OBSERVATIONS[config.teacher_observation].pictured:
        raise InputError(
            "a teacher has to know the state, and this one observes pictures: train one with another observation."
        )
    own, whole = config.rules.action, ACTIONS[config.teacher_action].whole
    if own not in (config.teacher_action, whole) and not ACTIONS[own].points:
        raise InputError(
            f"a student with action {own!r} cannot be taught by {config.teacher_action!r}: choose"
            f" {whole or config.teacher_action}."
        )
    iterations = -(-config.loop.total_steps // config.loop.iteration_steps)
    if config.dagger.guided >= iterations:
        raise InputError(
            f"the teacher would act in all {iterations} iterations of {config.loop.iteration_steps:,} steps, as guided"
            f" is {config.dagger.guided}: choose a lower --guided or --action-repeat, or more --total-steps."
        )
    if config.dagger.capacity < config.loop.num_envs:
        raise InputError(f"capacity must be at least num_envs, {config.loop.num_envs}, got {config.dagger.capacity}.")
    return config


def _initial_state(env: Env, config: RunConfig, seed: int | Array, teacher: Policy | None) -> DistilState:
    """State before the first iteration; without a teacher that of a checkpoint takes this one's place."""
    config = check_distillation(config)
    key, for_policy = jax.random.split(stream_key(seed, LEARNER_STREAM))
    policy = jit(lambda key: make_initial_policy(config, env, key))(for_policy)
    if teacher is None:
        known = {"observation": config.teacher_observation, "action": config.teacher_action, "memory": 0}
        known |= {} if config.teacher_hidden is None else {"hidden": config.teacher_hidden}
        knowing = Env(override(config, **known), 1)
        teacher = make_initial_policy(knowing.config, knowing, for_policy)
        knowing.close()
    state = env.init(episode_keys(seed, TRAINING_STREAM, 0, config.loop.num_envs))
    learner = make_learner(make_optimiser(config, config.dagger.updates), policy)
    dated = state.memory is not None or config.rules.hides_goal
    buffer = make_buffer(state, env.schema.vector_size, config.dagger.capacity, dated=dated)
    return DistilState(learner, state, key, buffer, teacher)


class _Lessons:
    """Iterations of a distillation: pictures are drawn beside JAX, all else is compiled."""

    def __init__(self, env: Env, config: DistilRunConfig) -> None:
        self._env, self._config = env, config
        rules = override(config, observation=config.teacher_observation, action=config.teacher_action).rules
        rules = replace(rules, goal_steps=None, goal_lost=0.0) if rules.hides_goal else rules
        self._known = replace(env.functions, setup=replace(env.setup, rules=rules), randomise=())
        self._pictures = Pictures(env, config.dagger.capacity)
        self._decide, self._add, self._learn = jit(self._decision), jit(add), jit(self._update)

    def iterate(self, state: DistilState) -> tuple[DistilState, Watched]:
        """State after pictures were collected and learnt from, and what it is judged by."""
        self._pictures.complete(state.buffer)
        key, for_acting, for_learning = jax.random.split(state.key, 3)
        collected, tally = self._collect(state, for_acting)
        learner, losses = self._study(collected.learner, collected.buffer, for_learning)
        metrics = {**_statistics(tally), **losses, "pictures": collected.buffer.count}
        learner = replace(learner, steps=learner.steps + self._config.loop.iteration_steps)
        new = replace(collected, learner=learner, key=key)
        watched = Watched(metrics, _finite(new, metrics), new.buffer.label)
        return (new if watched.sound else state), watched

    def _collect(self, state: DistilState, key: Array) -> tuple[DistilState, Counter[str]]:
        """State with more samples in its buffer, and what became of the student's episodes that ended."""
        loop, episodes, buffer = self._config.loop, state.env, state.buffer
        policy, tally = state.learner.policy, Counter[str]()
        guided = int(buffer.count) < self._config.dagger.guided * loop.rollout_steps * loop.num_envs
        for now in jax.random.split(key, loop.rollout_steps):
            picture = self._env.render_observation(episodes)
            given = state.teacher, policy, episodes, picture, now, guided
            label, action, vector, policy, memory = self._decide(*given)
            buffer = self._add(buffer, episodes, vector, label)
            self._pictures.add(cast("np.ndarray", picture))
            # The action is repeated: nobody learns from pictures that hardly differ.
            stepped = self._env.step(replace(episodes, memory=memory), action, loop.action_repeat)
            episodes = self._begun_anew(*stepped, tally)
        learner = replace(state.learner, policy=policy)
        return replace(state, learner=learner, env=episodes, buffer=buffer), Counter() if guided else tally

    def _begun_anew(self, episodes: EnvState, transition: Transition, tally: Counter[str]) -> EnvState:
        """Episodes of which those that ended are counted and begin anew."""
        done = np.asarray(transition.done)
        if not done.any():
            return episodes
        successes, distances = np.asarray(transition.terms["success"]), np.asarray(transition.errors.distance)
        tally.update(episodes=int(done.sum()), successes=int(successes[done].sum()))
        tally.update(steps=int(np.asarray(episodes.clock)[done].sum()), millimetres=round(1000 * distances[done].sum()))
        return self._env.reset(episodes, done)

    def _decision(
        self, teacher: Policy, policy: Policy, state: EnvState, picture: Array, key: Array, guided: bool
    ) -> tuple[Array, Array, Array, Policy, Memory]:
        """The teacher's action `[B, a]`, the one that is taken, what is seen beside the picture, and the student.

        The student has these observations known; and what it remembers then. The teacher knows how things are, not how
        they are measured.
        """
        observation = self._env.observe(state, picture)
        label = self._label(teacher, replace(state, sensed=None, sight=None))
        own, memory = policy.decide(observation, state.memory)
        vector = self._env.schema.split(observation)[1]
        vector = jnp.zeros((len(label), 0)) if vector is None else vector
        noise = self._config.dagger.noise * policy.half * jax.random.normal(key, label.shape)
        if ACTIONS[self._config.rules.action].points:
            noise *= guided  # who sees things where they are not strays enough
        action = jnp.clip(jnp.where(guided, label, own) + noise, *self._env.action_bounds)
        return label, action, vector, policy.observed(observation), memory

    def _label(self, teacher: Policy, known: EnvState) -> Array:
        """What the student's action should be `[B, a]`: the teacher's, as one of its own, or where things are."""
        situation, own = self._known.situation(known), self._config.rules.action
        if ACTIONS[own].points:
            return ACTIONS[own].towards(self._env.setup, situation, situation)
        label = actions.bounded(self._known.setup, teacher.act(self._known.observe(known)))
        if self._config.teacher_action == own:
            return label
        command = actions.command(self._known.setup, situation, label)
        return jnp.clip((command - known.command) / actions.joint_scale(self._env.setup), *self._env.action_bounds)

    def _study(self, learner: Learner, buffer: DaggerBuffer, key: Array) -> tuple[Learner, dict[str, Array]]:
        """Learner after the gradient steps of an iteration, and the means of their losses."""
        settings = self._config.dagger
        known = min(int(buffer.count), settings.capacity)
        if buffer.memory is None:
            batches = np.asarray(jax.random.randint(key, (settings.updates, settings.batch), 0, known))
        else:
            batches = sequences(key, int(buffer.count), known, self._config.loop.num_envs, settings)
        watched = []
        for rows in batches:
            learner, losses = self._learn(learner, buffer, rows, self._pictures[rows])
            watched.append(losses)
        return learner, {name: jnp.mean(jnp.array([losses[name] for losses in watched])) for name in watched[0]}

    def _update(
        self, learner: Learner, buffer: DaggerBuffer, rows: Array, pictures: Array
    ) -> tuple[Learner, dict[str, Array]]:
        policy, optimiser = learner.policy, make_optimiser(self._config, self._config.dagger.updates)
        parts = (buffer.arm, buffer.goal, buffer.vector, buffer.label, buffer.clock)
        arm, goal, vector, label, clock = jax.tree.map(lambda x: x[rows], parts)
        seen = policy.normaliser(vector) if vector.shape[-1] else None
        shown = None if clock is None else goal_seen(self._env.setup.rules, buffer.key[rows], clock)
        # Of a student without memory nothing is remembered, and nobody asks where episodes begin.
        memory, begins = jax.tree.map(lambda x: x[rows[:1]], buffer.memory), jax.tree.map(lambda x: x == 0, clock)
        inputs = Inputs(pictures, seen, memory, begins)
        wanted = (label - policy.centre) / policy.half
        points = jnp.stack([goal.position, arm.tool_position, *jnp.moveaxis(arm.bodies.position, -2, 0)], axis=-2)
        places = self._env.setup.robot.in_workspace(points).reshape(*rows.shape, -1)

        def loss(parameters: Parameters) -> tuple[Array, dict[str, Array]]:
            known = features(parameters, inputs)
            action = jnp.square(gaussian(parameters, known).mean - wanted).mean()
            if isinstance(parameters.encoder, Keypoints):
                place = parameters.encoder.loss(
                    pictures.reshape(-1, *pictures.shape[-2:]), label.reshape(rows.size, -1)
                )
            else:
                off = jnp.square(encoded(parameters, inputs)[..., : places.shape[-1]] - places)
                place = off.mean() if shown is None else (off * shown[..., None]).mean()
            if (memory := remembered(parameters, known)) is not None:  # where things are is worth remembering
                size = min(memory.shape[-1], places.shape[-1])
                place += jnp.square(memory[..., :size] - places[..., :size]).mean()
            errors = {"action_error": action, "place_error": place}
            return action + self._config.dagger.place_weight * place, errors

        gradient, errors = jax.grad(loss, has_aux=True)(policy.parameters)
        change, state = optimiser.update(gradient, learner.optimiser)
        parameters = jax.tree.map(jnp.add, policy.parameters, change)
        watched = errors | {"gradient_norm": optax.tree.norm(gradient)}
        new = replace(learner, policy=replace(policy, parameters=parameters), optimiser=state)
        return new, watched


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
    return Finite(
        observation=True,
        action=all_finite(state.buffer),
        reward=True,
        environment=all_finite(state.env),
        gradient=all_finite(metrics["gradient_norm"]),
        loss=all_finite(metrics),
        parameter=all_finite(state.learner),
    )


def _load_teacher(config: RunConfig, resume: bool) -> Policy | None:
    """The teacher of a new distillation; a resumed one has it in its checkpoint."""
    checked = check_distillation(config)
    if resume:
        return None
    run = find_run(checked.teacher)
    taught = run.read_config()
    if taught.learner.memory:
        raise InputError(f"teacher '{checked.teacher}' remembers, and a teacher must not: train one with --memory 0.")
    env = Env(taught, 1)
    try:
        return load_policy(run, env)
    finally:
        env.close()


DAGGER = Method(
    _load_teacher, _initial_state, lambda env, config, *_: _Lessons(env, check_distillation(config)).iterate
)
"""Dataset aggregation."""
