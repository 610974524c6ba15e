"""What each verb of the command line does."""

from __future__ import annotations

import json as jsonlib
import os
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reachlab.cli.flags import LESSON, Bench, Distil, Eval, List, Plot, Train, Video, View
from reachlab.settings.config import TASKS, DistilRunConfig, RunConfig, distillation, in_simulator, override
from reachlab.settings.names import AGENTS
from reachlab.settings.validation import InputError, choose

if TYPE_CHECKING:
    from reachlab.cli.displays import EvalDisplay
    from reachlab.learn.train import Saved
    from reachlab.runs.directory import RunDirectory

EVALUATION_LANES = {"pybullet": 8}
"""BatchArray of an evaluation where they are dear."""


def train(arguments: Train) -> None:
    """Run `reachlab train`."""
    _learn(arguments, arguments.run, "train")


def distil(arguments: Distil) -> None:
    """Run `reachlab distil`."""
    _learn(arguments, _distillation(arguments), "distil")


def _distillation(arguments: Distil) -> RunConfig:
    """Settings of a distillation: those of the run to go on with, or of the teacher with what the flags say."""
    from reachlab.runs.directory import RunDirectory

    said = {name: getattr(arguments, name) for name in LESSON} | vars(arguments.settings)
    if arguments.resume:
        config = RunDirectory(arguments.resume).read_config()
        said |= {"sim": arguments.sim} if arguments.sim else {}
        said |= {"teacher": str(arguments.teacher)} if arguments.teacher else {}
        return override(config, **said) if isinstance(config, DistilRunConfig) else config
    if arguments.teacher is None:
        raise InputError("distil needs a teacher: name the run directory of one, as `reachlab train` makes it.")
    taught = RunDirectory(arguments.teacher).read_config()
    config = in_simulator(taught, arguments.sim or taught.sim)
    return distillation(str(arguments.teacher), config, **said)


def _learn(arguments: Train | Distil, config: RunConfig, verb: str) -> None:
    """Train or distil, and show what came of it."""
    from reachlab.learn.interrupts import raise_on_termination

    raise_on_termination()
    if config.verb != verb:
        raise InputError(f"run '{arguments.resume}' goes on with `reachlab {config.verb} --resume {arguments.resume}`.")
    if arguments.resume and _told_that_finished(arguments, config, arguments.resume):
        return
    _prepare()
    from reachlab.cli.console import note, say
    from reachlab.cli.displays import TrainDisplay, print_training
    from reachlab.learn.train import distil as run_distillation
    from reachlab.learn.train import train as run_training
    from reachlab.watch.plots import plot as draw

    out = arguments.resume or arguments.out or Path("runs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{config.task}"
    settings = {"resume": arguments.resume is not None, "tensorboard": arguments.tensorboard}
    with TrainDisplay(config) as display:
        if isinstance(config, DistilRunConfig):
            result = run_distillation(config, out, display, **settings)
        else:
            result = run_training(config, out, display, **settings)
    draw([out], out / "curve.png")
    if arguments.json:
        print(jsonlib.dumps(result.to_json()))
    else:
        print_training(result, config, display, resumed=arguments.resume is not None)
        say(f"Written: {out}: report.json, curve.png, checkpoints. With the report: {result.total_wall_s:.1f} s.")
    if result.validated is False:
        note(
            f"Warning: validations did not reach {100 * config.ppo.stop_success:g} % success as often in a row as asked"
            f" for ({config.ppo.stop_streak}) within {config.ppo.total_steps:,} steps."
        )
    note(f"Next: reachlab eval {out} --agent trained random ik")


def _told_that_finished(arguments: Train | Distil, config: RunConfig, folder: Path) -> bool:
    """Whether the run to go on with is finished, and this was said.

    Raises:
        InputError: it cannot be gone on with; this is found before JAX is loaded.
    """
    from reachlab.runs.directory import RunDirectory
    from reachlab.runs.files import read_json

    if arguments.out:
        raise InputError("--resume names the run directory: leave --out out.")
    run = RunDirectory(folder)
    run.read_unfinished(config)
    if not run.finished:
        return False
    if arguments.json:
        print(jsonlib.dumps(read_json(run.report_file)))
    print(f"Run {folder} is finished: {run.report_file} holds its report.", file=sys.stderr)
    return True


def evaluate(arguments: Eval) -> None:
    """Run `reachlab eval`.

    Of several simulators, one that fails keeps nothing from the others.

    Raises:
        InputError: a flag that does not fit, or a simulator that cannot be used: after the results of the others.
    """
    for agent in arguments.agent:
        choose("agent", agent, AGENTS)
    _prepare()
    from reachlab.cli.console import note
    from reachlab.cli.displays import EvalDisplay
    from reachlab.runs.directory import RunDirectory
    from reachlab.sims import SIMULATORS

    run = RunDirectory(arguments.run)
    trained, several = run.read_config(), arguments.sim == "all"
    names = list(SIMULATORS) if several else [arguments.sim or trained.sim]
    configs = {name: _evaluated_config(arguments, trained, name) for name in names}
    reports: list[dict[str, Any]] = []
    failed: list[str] = []
    unsaved: list[str] = []
    loaded: list[Saved] = []
    try:
        with EvalDisplay(arguments.episodes) as display:
            if several:  # known before minutes are spent on the others
                failed += [name for name, config in configs.items() if not _can_be_used(config)]
            for name in names:
                if name in failed:
                    continue
                try:
                    for report, warning in _evaluated(arguments, run, configs[name], loaded, display):
                        reports.append(report)
                        unsaved += warning
                except (InputError, FloatingPointError) as error:
                    if not several:
                        raise
                    note(f"{name}: {error}")
                    failed.append(name)
    finally:  # what there is, whatever ended it
        _show_evaluation(reports, trained, as_list=len(names) * len(arguments.agent) > 1, json=arguments.json)
    for warning in unsaved:
        note(f"Warning: {warning}")
    if failed:
        raise InputError(f"no result in {', '.join(failed)}: the reason is above.")


def _evaluated_config(arguments: Eval, trained: RunConfig, name: str) -> RunConfig:
    """Settings of an evaluation in a simulator.

    Raises:
        InputError: there is no such simulator, or a flag is not for it.
    """
    from reachlab.envs.settle import in_evaluation

    physics = {"gui": arguments.gui, "slow": arguments.slow, "perturb": arguments.perturb}
    return in_evaluation(trained, name, **physics, randomise_view=arguments.perturb_view)


def _can_be_used(config: RunConfig) -> bool:
    """Whether the simulator of a configuration can be used here; if it cannot, why was said."""
    from reachlab.cli.console import note
    from reachlab.envs.core import Env

    try:
        Env(config, 1).close()
    except InputError as error:
        note(f"{config.sim}: {error}")
        return False
    return True


def _evaluated(
    arguments: Eval, run: RunDirectory, config: RunConfig, loaded: list[Saved], display: EvalDisplay
) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """Report of each agent in one simulator, and why it was not saved if it was not.

    What is `loaded` is used: one checkpoint for all simulators, though a training may write newer ones meanwhile.
    """
    from reachlab.envs.core import Env
    from reachlab.evaluation.report import LANES, examine
    from reachlab.learn.train import load_saved

    name = config.sim
    env = Env(config, 1 if arguments.gui else min(arguments.episodes, EVALUATION_LANES.get(name, LANES)))
    try:
        if not loaded:
            loaded.append(load_saved(run, config, env))
        policy, checkpoint = loaded[0].policy, loaded[0].checkpoint
        for agent in arguments.agent:
            display.begin(agent, name)
            seed, episodes = arguments.seed, arguments.episodes
            result, played = examine(
                env, agent, policy, seed=seed, episodes=episodes, watch=display, checkpoint=checkpoint
            )
            report = result.to_json()
            rows = {"target": played.target, "distance": played.distance, "success": played.success}
            kind = "-perturbed" * arguments.perturb + "-views" * arguments.perturb_view
            try:
                run.write_report(f"{name}-{agent}-{seed}{kind}", report, rows)
            except InputError as error:
                yield report, [str(error)]
            else:
                yield report, []
    finally:
        env.close()


def _show_evaluation(reports: list[dict[str, Any]], config: RunConfig, *, as_list: bool, json: bool) -> None:
    """Print reports, if there are any: one alone as it is, or a list."""
    from reachlab.cli.console import print_reports

    if reports and json:
        print(jsonlib.dumps(reports if as_list else reports[0]))
    elif reports:
        print_reports(reports, config)


def _as_it_is(trained: RunConfig, sim: str | None) -> RunConfig:
    """Settings of a run in a simulator, its own without a name, and in the view as it is."""
    from reachlab.sims import SIMULATORS

    return override(in_simulator(trained, choose("simulator", sim or trained.sim, SIMULATORS)), randomise_view=False)


def video(arguments: Video) -> None:
    """Run `reachlab video`."""
    _prepare()
    from reachlab.cli.console import say
    from reachlab.envs.core import Env
    from reachlab.learn.train import load_policy
    from reachlab.runs.directory import RunDirectory
    from reachlab.watch.video import write_video

    agent = choose("agent", arguments.agent, AGENTS)
    run = RunDirectory(arguments.run)
    config = _as_it_is(run.read_config(), arguments.sim)
    env = Env(config, 1)
    clip = write_video(
        env,
        agent,
        load_policy(run, config, env),
        arguments.out or run.path / "video.webp",
        seed=arguments.seed,
        episodes=arguments.episodes,
        fps=arguments.fps,
        speed=arguments.speed,
    )
    env.close()
    if arguments.json:
        print(jsonlib.dumps(vars(clip)))
    else:
        say(
            f"Written: {clip.out}, {clip.seconds:.1f} s, {clip.frames} pictures, {clip.bytes / 1e6:.2f} MB:"
            f" {clip.successes} of {clip.episodes} episodes reach the target."
        )


def view(arguments: View) -> None:
    """Run `reachlab view`."""
    _prepare()
    from reachlab.cli.console import note, say
    from reachlab.envs.core import Env
    from reachlab.learn.interrupts import Interrupts
    from reachlab.learn.train import load_policy
    from reachlab.runs.directory import RunDirectory
    from reachlab.watch.page import save_page
    from reachlab.watch.server import is_local
    from reachlab.watch.viewer import Viewer

    run = RunDirectory(arguments.run)
    config = _as_it_is(run.read_config(), arguments.sim)
    steps = run.checkpoint_steps()
    env = Env(config, 1)
    if arguments.save:
        save_page(
            env, arguments.agent, load_policy(run, config, env), arguments.seed, arguments.episodes, arguments.save
        )
        env.close()
        say(f"Written: {arguments.save}")
        return
    load = partial(load_policy, run, config, env)
    with (
        Viewer(env, steps, load, arguments.agent, arguments.host, arguments.port) as viewer,
        Interrupts() as interrupts,
    ):
        say(f"Viewer: {viewer.url}   Ctrl-C ends it.")
        if not is_local(arguments.host):
            note(
                f"Warning: --host {arguments.host} lets other machines in, without a password: whoever reaches it can"
                " watch and move the target."
            )
        if arguments.open:
            webbrowser.open(viewer.url)
        viewer.prepare(arguments.seed)
        viewer.run(lambda: interrupts.received is not None)
    env.close()


def plot(arguments: Plot) -> None:
    """Run `reachlab plot`."""
    from reachlab.cli.console import note, say
    from reachlab.watch.plots import plot as draw

    if not arguments.runs:
        raise InputError("plot needs at least one run directory.")
    out = arguments.out or arguments.runs[0] / "plots.png"
    left_out = draw(arguments.runs, out)
    say(f"Written: {out}")
    for sentence in left_out:
        note(f"Not drawn: {sentence}")


def bench(arguments: Bench) -> None:
    """Run `reachlab bench`."""
    _prepare()
    from reachlab.bench.suites import run_suite, to_markdown
    from reachlab.cli.console import print_table

    rows = run_suite(arguments.suite)
    if arguments.json:
        print(jsonlib.dumps(rows))
    elif arguments.markdown:
        print(to_markdown(rows), end="")
    else:
        cells = [(row["name"], f"{row['value']:.4g}", row["unit"], str(row["config"])) for row in rows]
        print_table(f"suite {arguments.suite}", ("measurement", "value", "unit", "configuration"), cells)


def list_names(arguments: List) -> None:
    """Run `reachlab list`."""
    _prepare()
    from reachlab.cli.console import asked, print_table
    from reachlab.evaluation.report import AGENTS
    from reachlab.robots.loading import ROBOTS
    from reachlab.sims import SIMULATORS
    from reachlab.tasks.reach import ACTIONS, OBSERVATIONS, REWARDS

    names: dict[str, dict[str, str]] = {
        "tasks": {
            name: f"{asked(config)}. Unless told otherwise: simulator {config.sim}, observation"
            f" {config.rules.observation}, action {config.rules.action}, reward {config.rules.reward}"
            for name, config in TASKS.items()
        },
        "robots": {name: f"tool frames {', '.join(robot.tools)}" for name, robot in ROBOTS.items()},
        "simulators": {name: entry.summary for name, entry in SIMULATORS.items()},
        "observations": {name: design.summary for name, design in OBSERVATIONS.items()},
        "actions": {name: design.summary for name, design in ACTIONS.items()},
        "rewards": {name: (reward.__doc__ or "").strip() for name, reward in REWARDS.items()},
        "agents": {name: (agent.__doc__ or "").strip() for name, agent in AGENTS.items()},
    }
    if arguments.json:
        print(jsonlib.dumps(names))
    else:
        for kind, entries in names.items():
            print_table(kind, ("name", "what it is"), list(entries.items()))


def _prepare() -> None:
    """Quiet XLA's log, which prints pages of CPU features when it reads the compilation cache, and use the cache.

    Raises:
        InputError: MuJoCo does not load, as with a `MUJOCO_GL` that it does not know or cannot have.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    from reachlab.jax_setup import use_compilation_cache

    use_compilation_cache()
    try:
        import_module("mujoco")
    except Exception as error:
        if "MUJOCO_GL" not in os.environ:
            raise
        wanted = os.environ["MUJOCO_GL"]
        raise InputError(f"MuJoCo does not load with MUJOCO_GL={wanted!r} ({error}): unset it, or set egl.") from None


@dataclass(frozen=True)
class Verb:
    """A verb: its flags and its function."""

    flags: type
    run: Callable[[Any], None]


VERBS: dict[str, Verb] = {
    "train": Verb(Train, train),
    "distil": Verb(Distil, distil),
    "eval": Verb(Eval, evaluate),
    "video": Verb(Video, video),
    "view": Verb(View, view),
    "plot": Verb(Plot, plot),
    "bench": Verb(Bench, bench),
    "list": Verb(List, list_names),
}
