"""Training: collect, update, validate, and in the end a report."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax import Array
from jax.stages import Wrapped

from reachlab import ppo
from reachlab.checkpoint import RunDirectory, write_json
from reachlab.compilation import jit
from reachlab.config import InputError, RunConfig
from reachlab.env import Env, EnvState
from reachlab.evaluation import (
    VALIDATION_STREAM,
    Report,
    Runner,
    episode_keys,
    evaluate,
    make_runner,
    run_episodes,
)
from reachlab.metrics import Metrics
from reachlab.policy import Policy, make_policy
from reachlab.rollout import Collect, Rollout, collect, episode_statistics, host_collector

TRAINING_STREAM = 0
"""Random stream of the lanes; those of `evaluate` differ."""

Learn = Callable[[ppo.Learner, Rollout, Array], tuple[ppo.Learner, dict[str, Array]]]

VALIDATE_FROM = 0.9
"""Success rate of the training episodes from which validations are worth their time."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TrainState:
    """All that training changes: enough to go on from."""

    learner: ppo.Learner
    env: EnvState
    key: Array


@dataclass(frozen=True)
class Progress:
    """Where training stands: `steps` of `total_steps`, the metrics of the last iteration."""

    steps: int
    total_steps: int
    metrics: dict[str, float]


@dataclass(frozen=True)
class TrainResult:
    """What training came to.

    Attributes:
        report: on held-out targets.
        policy: what was learnt.
        steps: environment steps taken.
        train_wall_s: time of the loop, compilation and validations included [s].
        total_wall_s: time of everything, the report included [s].
        steps_per_second: of collecting and updating, without the first iteration and validations.
        validated: whether a validation held; None if none was asked for.
    """

    report: Report
    policy: Policy
    steps: int
    train_wall_s: float
    total_wall_s: float
    steps_per_second: float
    validated: bool | None

    def to_json(self) -> dict[str, Any]:
        """Plain form: the report's fields and the times."""
        times = {name: value for name, value in vars(self).items() if name not in ("report", "policy")}
        return self.report.to_json() | times


def make_initial_policy(config: RunConfig, env: Env, key: Array) -> Policy:
    """Untrained policy for an environment."""
    return make_policy(key, env.observation_bounds, env.action_bounds, config.ppo.hidden, config.ppo.initial_std)


def load_policy(run: RunDirectory, config: RunConfig, env: Env, step: int | None = None) -> Policy:
    """Policy of a run's newest checkpoint, or of the one after `step`.

    Raises:
        InputError: see `RunDirectory.read_checkpoint`.
    """
    template = jax.eval_shape(lambda key: make_initial_policy(config, env, key), jax.random.key(0))
    return run.read_checkpoint("learner/policy", template, step)


def train(config: RunConfig, out: Path, watch: Callable[[Progress], None] = lambda _: None) -> TrainResult:
    """Result of training, whose files are in the new directory `out`.

    Args:
        config: every setting.
        out: run directory, made here.
        watch: called after every iteration.

    Raises:
        InputError: a setting that does not exist or fit, or a directory that does.
    """
    start = time.perf_counter()
    _check(config)
    env = Env(config, config.ppo.lanes)
    run = RunDirectory(out)
    run.create(config)
    with Metrics(run.metrics_file) as metrics:
        loop = _Loop(config, env, metrics, watch)
        state = loop.run()
    run.write_checkpoint(loop.steps, state)
    trained = time.perf_counter()
    report = evaluate(
        env,
        "trained",
        state.learner.policy,
        seed=config.seed,
        episodes=config.ppo.report_episodes,
        runner=loop.runner,
    )
    result = TrainResult(
        report=report,
        policy=state.learner.policy,
        steps=loop.steps,
        train_wall_s=trained - start,
        total_wall_s=time.perf_counter() - start,
        steps_per_second=loop.steps_per_second,
        validated=loop.validated if config.ppo.stop_early else None,
    )
    write_json(run.report_file, result.to_json())
    env.close()
    return result


def _check(config: RunConfig) -> None:
    settings = config.ppo
    if settings.lanes % settings.minibatches:
        raise InputError(
            f"{settings.lanes} lanes cannot be divided among {settings.minibatches} minibatches: choose a divisor."
        )


Iteration = Callable[[TrainState], tuple[TrainState, dict[str, Array]]]


def compile_iteration(env: Env, config: RunConfig, shape: TrainState) -> Iteration:
    """Function that gives the state after one rollout and its update, and scalars of both.

    With a pure simulator it is one program; else the environment steps on the host, between compiled parts.
    """

    def learn(learner: ppo.Learner, rollout: Rollout, key: Array) -> tuple[ppo.Learner, dict[str, Array]]:
        learner, watched = ppo.update(learner, rollout, key, config.ppo)
        return learner, {**episode_statistics(rollout), **watched}

    def iterate(gather: Collect, learn: Learn, state: TrainState) -> tuple[TrainState, dict[str, Array]]:
        key, for_rollout, for_update = jax.random.split(state.key, 3)
        lanes, rollout = gather(env, state.learner.policy, state.env, for_rollout, config.ppo.rollout_steps)
        learner, watched = learn(state.learner, rollout, for_update)
        return TrainState(learner, lanes, key), watched

    if env.simulator.pure:
        return jit(partial(iterate, collect, learn), donate=(0,)).lower(shape).compile()
    return partial(iterate, host_collector(env), jit(learn, donate=(0,)))


def initial_state(env: Env, config: RunConfig, seed: int | Array) -> TrainState:
    """State before the first iteration."""
    key, for_policy = jax.random.split(jax.random.fold_in(jax.random.key(seed), TRAINING_STREAM))
    lanes = episode_keys(seed, TRAINING_STREAM, 0, config.ppo.lanes)
    learner = env.traced(lambda key: ppo.make_learner(config.ppo, make_initial_policy(config, env, key)))(for_policy)
    return TrainState(learner, env.init(lanes), key)


class _Loop:
    """Iterations until the steps are used up or a validation holds."""

    def __init__(self, config: RunConfig, env: Env, metrics: Metrics, watch: Callable[[Progress], None]) -> None:
        self.config, self.env, self.metrics, self.watch = config, env, metrics, watch
        self.steps = 0
        self.steps_per_second = 0.0
        self.streak = 0
        self.runner = make_runner(env, "trained")

    def run(self) -> TrainState:
        settings = self.config.ppo
        per_iteration = settings.lanes * settings.rollout_steps
        state, step = self._prepare()
        start, busy = time.perf_counter(), 0.0
        while self.steps < settings.total_steps and not self.validated:
            tick = time.perf_counter()
            state, watched = step(state)
            watched = jax.device_get(watched)
            busy += time.perf_counter() - tick
            self.steps += per_iteration
            self.steps_per_second = self.steps / busy
            row = {name: float(x) for name, x in sorted(watched.items())}
            if self._due(row):
                row["validation_success"] = self._validate(state.learner.policy)
            row |= {
                "steps": self.steps,
                "wall_s": time.perf_counter() - start,
                "steps_per_second": self.steps_per_second,
            }
            self.metrics.write(row)
            self.watch(Progress(self.steps, settings.total_steps, row))
        return state

    def _prepare(self) -> tuple[TrainState, Iteration]:
        """First state and the compiled iteration; with a pure simulator three programs are compiled at once."""
        env, config = self.env, self.config
        if not env.simulator.pure:
            state = initial_state(env, config, config.seed)
            return state, compile_iteration(env, config, state)
        shape = jax.eval_shape(lambda: initial_state(env, config, config.seed))
        with ThreadPoolExecutor(2) as pool:
            begun = pool.submit(jit(lambda seed: initial_state(env, config, seed)), np.uint32(config.seed))
            runner = pool.submit(self._compiled_runner, shape.learner.policy)
            step = compile_iteration(env, config, shape)
            self.runner = runner.result()
            return begun.result(), step

    def _compiled_runner(self, policy: Policy) -> Runner:
        if not isinstance(self.runner.run, Wrapped):
            return self.runner
        keys = jax.eval_shape(lambda: episode_keys(0, VALIDATION_STREAM, 0, self.runner.lanes))
        return Runner(self.runner.run.lower(policy, keys).compile(), self.runner.lanes)

    @property
    def validated(self) -> bool:
        """Whether enough validations in a row have held."""
        return self.streak >= self.config.ppo.stop_streak

    def _due(self, row: dict[str, float]) -> bool:
        settings = self.config.ppo
        count = self.steps // (settings.lanes * settings.rollout_steps)
        return (
            settings.stop_early and count % settings.validation_interval == 0 and row["success_rate"] >= VALIDATE_FROM
        )

    def _validate(self, policy: Policy) -> float:
        """Success rate of the validation so far; it ends as soon as it can no longer hold."""
        settings, lanes = self.config.ppo, self.runner.lanes
        failures, allowed, seen = 0, (1 - settings.stop_success) * settings.validation_episodes, 0
        while seen < settings.validation_episodes and failures <= allowed:
            count = min(lanes, settings.validation_episodes - seen)
            result = run_episodes(self.runner, policy, self.config.seed, VALIDATION_STREAM, count, first=seen)
            seen, failures = seen + count, failures + int((~result.success).sum())
        self.streak = self.streak + 1 if failures <= allowed else 0
        return 1 - failures / seen
