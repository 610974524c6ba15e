"""Training: iterations, validations and checkpoints, and in the end a report."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from reachlab.agents.policy import Policy
from reachlab.envs.consistency import check
from reachlab.envs.core import Env
from reachlab.envs.setup import check_reach, make_setup, settled
from reachlab.evaluation.episodes import Watch, ignore
from reachlab.evaluation.report import Report, examine
from reachlab.jax_setup import set_threads
from reachlab.learn import METHODS
from reachlab.learn.checkpointing import UnwritableError, unwritable
from reachlab.learn.interrupts import Interrupts
from reachlab.learn.learner import check_memory
from reachlab.learn.load import load_initial
from reachlab.learn.loop import Loop, Progress
from reachlab.learn.method import Method
from reachlab.learn.rollout import Collect
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import write_json
from reachlab.runs.lock import locked
from reachlab.runs.metrics import Metrics, cut_metrics
from reachlab.runs.shipped import refuse_sweep
from reachlab.runs.sinks import Sink, make_sinks
from reachlab.settings.arguments import typed
from reachlab.settings.config import DistilRunConfig, RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError, whole_number
from reachlab.tasks.actions import ACTIONS

MOST_THREADS = 4096
"""Largest number of threads to compute with."""


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
        validated: whether enough validations in a row reached `stop_success`; None if none was asked for.
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


@typed
def train(
    config: RunConfig,
    out: str | Path,
    watch: Callable[[Progress], None] = lambda _: None,
    *,
    watch_report: Watch = ignore,
    begun: Callable[[], None] = lambda: None,
    resume: bool = False,
    base: RunConfig | None = None,
    sinks: Sequence[str] = (),
    threads: int | None = None,
    collect: Collect | None = None,
) -> TrainResult:
    """Result of training, whose files are in the directory `out`.

    SIGINT, SIGTERM and SIGHUP end it after the iteration under way, with everything saved, a second one at once.

    Args:
        config: every setting.
        out: run directory, made here; with `resume` one that is there.
        watch: called after every iteration; what it raises ends the training, which is saved.
        watch_report: called with the number of episodes of the report that have ended, now and then.
        begun: called once nothing is refused any more, before the programs of a new run are compiled.
        resume: continue from the newest checkpoint of `out`, bit for bit (but for objects in PyBullet) as if unstopped.
        base: settings from which `config` was changed, by default its preset: changes without effect are refused.
        sinks: where the numbers of `metrics.jsonl` go too: names of `SINKS`, for example `("tensorboard", "wandb")`.
        threads: threads to compute with, by default one a core; a run that is resumed has those that it began with.
        collect: what collects the experience, by default this process; see `reachlab.scale.rollouts`.

    Raises:
        InputError: a setting that does not exist or fit, a directory that does, one that cannot be resumed, or
            a sink that cannot be used.
        NotFiniteError: a number is not finite.
        Interrupted: a signal asked for it.
    """
    start = time.perf_counter()
    run = RunDirectory(Path(out))
    if resume:
        run.check_robot(config)
    check(config, config if resume or isinstance(config, DistilRunConfig) else base)
    asked, config = config, _settled(config)
    _check_unfinished(run, config) if resume else run.refuse_existing()
    wanted = make_sinks(sinks)
    _choose_threads(run, config, threads)
    method: Method = METHODS[ACTIONS[config.rules.action].method or config.method].load()
    given = method.load(config, resume)
    if not resume and "object" not in asked.rules.gives:  # which need not be where the tool can be
        check_reach(asked)
    env = Env(config, config.loop.num_envs, threads=threads or 0)
    try:
        _check_shared(env, method, collect)
        env.check_rendering()
        initial = None if resume and run.has_checkpoints else load_initial(env)
        if not resume:
            run.create(config)
        with _held(run, new=not resume):
            loop = Loop(config, env, run, watch, start, method, given, collect, initial)
            return _train(loop, wanted, begun, watch_report, resume=resume)
    finally:
        env.close()


@contextlib.contextmanager
def _held(run: RunDirectory, *, new: bool) -> Iterator[None]:
    """A run directory that no other process may use; a new one goes where its training is refused at its start."""
    try:
        with locked(run.path):
            yield
    except InputError as error:
        if new and not isinstance(error, UnwritableError):  # what is there then is what it is resumed from
            run.remove_unbegun()
        raise


@typed
def distil(
    config: DistilRunConfig,
    out: str | Path,
    watch: Callable[[Progress], None] = lambda _: None,
    *,
    resume: bool = False,
    sinks: Sequence[str] = (),
) -> TrainResult:
    """Result of learning to act on pictures from the teacher in the run directory `config.teacher`; see `train`.

    Args:
        config: every setting, as `distillation` gives them.
        out: run directory, made here; with `resume` one that is there.
        watch: called after every iteration.
        resume: continue from the newest checkpoint of `out`.
        sinks: where the numbers go too, as for `train`.

    Raises:
        InputError: see `train`; or a teacher, observation or simulator that cannot be learnt with.
    """
    return train(config, out, watch, resume=resume, sinks=sinks)


def _settled(config: RunConfig) -> RunConfig:
    setup = make_setup(config)
    check_memory(config, setup)
    return settled(config, setup)


def _check_shared(env: Env, method: Method, collect: Collect | None) -> None:
    if collect is None:
        return
    if not method.shares:
        raise InputError(
            f"what action {env.config.rules.action!r} is learnt from is planned on all cores here, and shared with no"
            " worker: leave --workers out."
        )
    if env.traced:
        raise InputError(
            f"simulator {env.config.sim!r} is compiled with what learns from it, and shared with no worker: leave"
            " --workers out, or use --sim mujoco or pybullet."
        )


def _check_unfinished(run: RunDirectory, config: RunConfig) -> None:
    refuse_sweep(run)
    run.read_unfinished(config)
    if run.finished:
        raise InputError(
            f"run '{run.path}' is finished: its report is '{run.report_file}'. A new run begins with its policy by"
            f" initial_policy '{run.path}'."
        )


def _choose_threads(run: RunDirectory, config: RunConfig, wanted: int | None) -> None:
    """Compute with as many threads as the run has so far; a new one chooses if told to, or to be deterministic."""
    if wanted is not None:
        whole_number("threads", wanted, 0, MOST_THREADS)  # 0 is by default
    if saved := run.newest_manifest():
        set_threads(saved.threads)
    elif wanted or config.loop.deterministic:
        set_threads(wanted or 1)


def _train(
    loop: Loop, sinks: dict[str, Sink], begun: Callable[[], None], watch_report: Watch, *, resume: bool
) -> TrainResult:
    run, config = loop.run, loop.config
    if not resume:
        begun()
    state = loop.prepare(resume=resume)
    cut_metrics(run.metrics_file, loop.now.steps)
    with Metrics(run.metrics_file, sinks) as metrics:
        if resume:
            begun()
        with Interrupts() as interrupts:
            state = loop.iterate(state, metrics, interrupts)
        try:
            result = _result(loop, state.learner.policy, watch_report)
            write_json(run.report_file, result.to_json())
        except KeyboardInterrupt as interruption:
            interruption.args = (f"interrupted in its report; {loop.checkpoints.how_to_resume()}",)
            raise
        except OSError as error:
            raise unwritable("report", run, error, config.verb) from None
        metrics.finish(result.to_json())
    return result


def _result(loop: Loop, policy: Policy, watch: Watch) -> TrainResult:
    trained = time.perf_counter()
    return TrainResult(
        report=_report(loop, policy, watch),
        policy=policy,
        steps=loop.now.steps,
        train_wall_s=loop.now.train_s,
        total_wall_s=loop.now.train_s + time.perf_counter() - trained,
        steps_per_second=loop.steps_per_second,
        validated=loop.validated if loop.config.loop.stop_early else None,
    )


def _report(loop: Loop, policy: Policy, watch: Watch) -> Report:
    """Report on held-out targets, without what varied in training."""
    config = override(loop.config, randomise=())
    newest = loop.run.newest_manifest()
    asked: dict[str, Any] = {
        "seed": config.seed,
        "episodes": config.loop.report_episodes,
        "checkpoint": newest.identity if newest else None,
        "watch": watch,
    }
    if loop.env.config == config:
        return examine(loop.env, "trained", policy, **asked, runner=loop.runner)[0]
    env = Env(config, loop.env.num_envs)
    try:
        return examine(env, "trained", policy, **asked)[0]
    finally:
        env.close()
