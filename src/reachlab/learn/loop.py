"""The loop of a training: iterations, validations and checkpoints, until it is done, stopped or broken."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NoReturn

import jax
import numpy as np
from jax.stages import Wrapped

from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.random_streams import VALIDATION_STREAM, episode_keys
from reachlab.evaluation.episodes import Runner, make_runner, run_episodes
from reachlab.evaluation.report import Report, evaluate
from reachlab.jax_setup import beside, jit
from reachlab.learn.checkpointing import Checkpoints, reason, unwritable
from reachlab.learn.interrupts import Interrupted, Interrupts
from reachlab.learn.method import Method
from reachlab.learn.rollout import Collect, EngineError
from reachlab.runs import arrays
from reachlab.runs.checkpoint import Counters
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import write_synced
from reachlab.runs.metrics import Metrics
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError
from reachlab.traced import kept

VALIDATE_FROM = 0.9
"""Success rate of training episodes from which validations are worth their time, or `stop_success` if it is lower."""

MOST_SKIPPED = 3
"""Validations that are left out after one that failed: one for each hundredth that it was short of, and no more."""

ENOUGH_EPISODES = 20
"""Training episodes from which on their success rate says something: a single one may succeed by luck."""


class NotFiniteError(FloatingPointError):
    """A number in training is not finite; the last good state is saved, and the rollout beside it."""


@dataclass(frozen=True)
class Progress:
    """Where training stands: `steps` of `total_steps`, the metrics of the last iteration, and all time so far [s].

    And a function that evaluates the policy as it is now on so many of the report's targets, in the environment that it
    is trained in.
    """

    steps: int
    total_steps: int
    metrics: dict[str, float]
    elapsed_s: float
    evaluate: Callable[[int], Report]

    def __repr__(self) -> str:
        """One line, as `watch=print` shows it."""
        told = f", success {100 * self.metrics['success_rate']:.1f} %" if "success_rate" in self.metrics else ""
        return f"Progress({self.steps:,} of {self.total_steps:,} steps, {self.elapsed_s:.1f} s{told})"


class Loop:
    """Iterations until the steps are used up or enough validations in a row reach `stop_success`.

    Attributes:
        now: where training stands.
        checkpoints: its saving.
    """

    def __init__(
        self,
        config: RunConfig,
        env: Env,
        run: RunDirectory,
        watch: Callable[[Progress], None],
        start: float,
        method: Method,
        given: Any,
        collect: Collect | None = None,
        initial: Policy | None = None,
    ) -> None:
        """Loop that has taken no step yet.

        `start` is when training began [s], `given` what the method loaded, and `initial` a policy to begin with, by
        default an untrained one.
        """
        self.method, self.given, self.collect, self.initial = method, given, collect, initial
        self.config, self.env, self.run, self.watch, self.start = config, env, run, watch, start
        self.now = Counters(0)
        self.checkpoints = Checkpoints(run, config)
        self.runner = make_runner(env, "trained", max(config.loop.validation_episodes, config.loop.report_episodes))

    @property
    def validated(self) -> bool:
        """Whether enough validations in a row have reached `stop_success`."""
        return self.now.streak >= self.config.loop.stop_streak

    @property
    def steps_per_second(self) -> float:
        """Steps for each second of collecting and updating."""
        return self.now.steps / self.now.busy_s if self.now.busy_s else 0.0

    # --- before -----------------------------------------------------------------------------------

    def prepare(self, *, resume: bool) -> Any:
        """First state, or the saved one; the iteration is compiled the same for both.

        Where everything is traced its programs are compiled meanwhile, and what validates after them, while it trains.
        """
        env, config = self.env, self.config
        resume = resume and self.run.has_checkpoints  # damaged ones too: then it is said, and nothing is lost
        if not env.traced:
            state = self.method.initial_state(env, config, config.seed, self.given)
            self._step = self.method.compile_iteration(env, config, state, self.collect)
            return self._saved_state(state) if resume else self._begun(state)
        shape = jax.eval_shape(lambda: self.method.initial_state(env, config, config.seed, self.given))
        saved = self._saved_state(shape) if resume else None
        self._step = self.method.compile_iteration(env, config, shape, None)
        if saved is None:
            begin = kept(
                lambda seed: self.method.initial_state(env, config, seed, self.given),
                f"first state of {config.method}",
                env.identity,
                like=shape,
            )
            saved = self._begun(jit(begin, brief=True)(np.uint32(config.seed)))
        self.runner = self._compiled_runner(shape.learner.policy)
        return saved

    def _begun(self, state: Any) -> Any:
        """A first state, with the policy that training begins with where one is given."""
        return state if self.initial is None else replace(state, learner=replace(state.learner, policy=self.initial))

    def _saved_state(self, template: Any) -> Any:
        self.now, state = self.run.read_state(template)
        self.checkpoints.saved = self.now
        self.start -= self.now.train_s
        return state

    def _compiled_runner(self, policy: Policy) -> Runner:
        if not isinstance(self.runner.run, Wrapped):
            return self.runner
        run, count = self.runner.run, self.runner.num_envs
        keys = jax.eval_shape(lambda: episode_keys(0, VALIDATION_STREAM, 0, count))
        return Runner(beside(lambda: run.lower(policy, keys).compile()), count)

    # --- iterations -------------------------------------------------------------------------------

    def iterate(self, state: Any, metrics: Metrics, interrupts: Interrupts) -> Any:
        """State after training, saved."""
        self.checkpoints.start()
        self._loop_start = time.perf_counter() - self.now.loop_s
        first = self.now
        while self.now.steps < self.config.loop.total_steps and not self.validated:
            interrupts.at_once = self.now is first  # it compiles, for seconds, and nothing is lost with it
            try:
                state = self._advance(state, metrics, interrupts)
            except Interrupted as interruption:
                interruption.args = (f"interrupted in its first iteration; {self.checkpoints.how_to_resume()}",)
                raise
            if interrupts.received is not None:
                self._leave(state, metrics, interrupts.received)
            if self.checkpoints.due:
                self._try_to_save(state, metrics)
        try:
            self.checkpoints.save(self._timed(), state, metrics)
        except (OSError, InputError) as error:
            raise unwritable("last checkpoint", self.run, error, self.config.verb) from None
        return state

    def _advance(self, state: Any, metrics: Metrics, interrupts: Interrupts) -> Any:
        settings, tick = self.config.loop, time.perf_counter()
        try:
            state, watched = self._step(state)
            interrupts.at_once = False
        except EngineError as error:
            self._stop(state, metrics, str(error), error.rollout)
        row = {name: float(x) for name, x in sorted(jax.device_get(watched.metrics).items())}
        if missing := watched.finite.missing():
            self._stop(state, metrics, f"a number is not finite in: {', '.join(missing)}", watched.rollout)
        self.now = replace(
            self.now,
            steps=self.now.steps + settings.iteration_steps,
            busy_s=self.now.busy_s + time.perf_counter() - tick,
            validated=False,
        )
        self._count(row)
        if self._due():
            row["validation_success"] = self._validate(state, metrics)
        self.now = replace(self.now, loop_s=time.perf_counter() - self._loop_start)
        row |= {"steps": self.now.steps, "wall_s": self.now.loop_s, "steps_per_second": self.steps_per_second}
        metrics.write(row)
        elapsed = time.perf_counter() - self.start
        try:
            self.watch(Progress(self.now.steps, settings.total_steps, row, elapsed, partial(self._examine, state)))
        except BaseException:  # who watches may end a training so
            self._try_to_save(state, metrics)
            raise
        return state

    def _count(self, row: dict[str, float]) -> None:
        """Count the training episodes of an iteration; they are judged once there are enough."""
        episodes = self.now.episodes + round(row["episodes"])
        successes = self.now.successes + round(row["episodes"] * row["success_rate"])
        rate = self.now.training_success
        if episodes >= ENOUGH_EPISODES:
            rate, episodes, successes = successes / episodes, 0, 0
        self.now = replace(self.now, success=rate, training_success=rate, episodes=episodes, successes=successes)

    def _due(self) -> bool:
        settings = self.config.loop
        count = self.now.steps // settings.iteration_steps
        near = self.now.training_success >= min(VALIDATE_FROM, settings.stop_success)
        due = count % settings.validation_interval == 0 and self.now.steps >= self.now.next_validation
        return settings.stop_early and due and near

    def _validate(self, state: Any, metrics: Metrics) -> float:
        """Success rate of the validation so far; it ends as soon as it can no longer reach `stop_success`."""
        settings, at_once = self.config.loop, self.runner.num_envs
        failures, played = 0, 0
        while played < settings.validation_episodes and self._can_reach(failures):
            count = min(at_once, settings.validation_episodes - played)
            try:
                result = run_episodes(
                    self.runner, state.learner.policy, self.config.seed, VALIDATION_STREAM, count, first=played
                )
            except FloatingPointError as error:
                self._stop(state, metrics, f"in a validation {error}", None)
            played, failures = played + count, failures + int((~result.success).sum())
        success = 1 - failures / played
        streak = self.now.streak + 1 if self._can_reach(failures) else 0
        skipped = 0 if streak else min(int(100 * (settings.stop_success - success)), MOST_SKIPPED)
        following = self.now.steps + (1 + skipped) * settings.validation_interval * settings.iteration_steps
        self.now = replace(self.now, streak=streak, success=success, validated=True, next_validation=following)
        return success

    def _examine(self, state: Any, episodes: int) -> Report:
        policy, seed = state.learner.policy, self.config.seed
        return evaluate(self.env, "trained", policy, seed=seed, episodes=episodes, runner=self.runner)

    def _can_reach(self, failures: int) -> bool:
        """Whether a validation reaches `stop_success` if it has no more than these failures."""
        settings = self.config.loop
        # As one quotient: 0.9 of 1000 is 900 then, where (1 - 0.9) * 1000 is less than 100.
        return (settings.validation_episodes - failures) / settings.validation_episodes >= settings.stop_success

    # --- ends -------------------------------------------------------------------------------------

    def _leave(self, state: Any, metrics: Metrics, signal: int) -> NoReturn:
        self._try_to_save(state, metrics)
        raise Interrupted(signal, f"interrupted at step {self.now.steps:,}; {self.checkpoints.how_to_resume()}")

    def _stop(self, state: Any, metrics: Metrics, why: str, rollout: object) -> NoReturn:
        """End training at numbers that are not finite: the state is the one before them."""
        self._try_to_save(state, metrics)
        kept = ""
        if rollout is not None:
            try:
                write_synced(self.run.offending_file, arrays.to_bytes(rollout))
                kept = f" The rollout is in '{self.run.offending_file}'."
            except (OSError, InputError) as error:
                kept = f" The rollout cannot be written ({reason(error)})."
        saved = self.checkpoints.how_to_resume()
        if self.checkpoints.saved:
            saved += " Unless a file of yours is mended first, it stops there again: begin anew with other settings."
        raise NotFiniteError(f"training stopped after step {self.now.steps:,}: {why}.{kept} {saved}")

    def _try_to_save(self, state: Any, metrics: Metrics) -> None:
        self.checkpoints.try_to_save(self._timed(), state, metrics)

    def _timed(self) -> Counters:
        """Where training stands, with its time so far."""
        self.now = replace(self.now, train_s=time.perf_counter() - self.start)
        return self.now
