"""The command line: one verb, one function; flags are the fields of the dataclasses."""

from __future__ import annotations

import contextlib
import io
import itertools
import json as jsonlib
import os
import re
import sys
import time
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from reachlab.config import (
    DISTIL_DEFAULTS,
    TASKS,
    Checked,
    Count,
    DistilConfig,
    DistilRunConfig,
    InputError,
    Positive,
    Range,
    RunConfig,
    Seed,
    Steps,
    choose,
    distillation,
    in_simulator,
    override,
    preset,
)

EVALUATION_LANES = {"pybullet": 8}
"""Lanes of an evaluation where they are dear."""

DONE, WRONG_INPUT, NOT_FINITE, INTERRUPTED = 0, 2, 3, 130
"""Exit statuses."""


@dataclass(frozen=True)
class Train(Checked):
    """Train a policy and report on held-out targets."""

    run: RunConfig = field(default_factory=RunConfig)
    out: Path | None = None
    """Run directory to make; by default a new one below runs/."""
    resume: Path | None = None
    """Run directory to go on in, from its newest checkpoint and with its own settings."""
    tensorboard: bool = False
    """Write TensorBoard's event file into the run directory too; needs the extra `tensorboard`."""
    json: bool = False
    """Print the result as one JSON object on standard output."""


@dataclass(frozen=True)
class Distil(Checked):
    """Teach a policy that sees pictures, by one that knows the state."""

    teacher: Annotated[Path | None, tyro.conf.Positional] = None
    """Run directory of the teacher."""
    observation: str = "image"
    """What the student sees: image, image+tool."""
    sim: str | None = None
    """Simulator, kinematic or mujoco; by default the teacher's."""
    seed: Seed = 0
    """Seed of everything random."""
    out: Path | None = None
    """Run directory to make; by default a new one below runs/."""
    resume: Path | None = None
    """Run directory to go on in, from its newest checkpoint and with its own settings."""
    randomise_view: bool = False
    """Every episode is seen in a view of its own: light, colours, and the camera's pose within 2 cm and 2 degrees."""
    total_steps: Steps = DISTIL_DEFAULTS["total_steps"]
    """Environment steps after which it ends; 4,096 an iteration."""
    report_episodes: Count = DISTIL_DEFAULTS["report_episodes"]
    """Held-out episodes of the report at the end."""
    deterministic: bool = False
    """Compute on one thread: the same weights on any number of cores."""
    settings: DistilConfig = field(default_factory=DistilConfig)
    tensorboard: bool = False
    """Write TensorBoard's event file into the run directory too; needs the extra `tensorboard`."""
    json: bool = False
    """Print the result as one JSON object on standard output."""


@dataclass(frozen=True)
class Eval(Checked):
    """Evaluate a run beside its baselines, on held-out targets."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run directory."""
    sim: str | None = None
    """Simulator, or `all` of them; by default the run's own."""
    agent: tuple[str, ...] = ("trained",)
    """Agents: trained, random, zero, ik, ik_open."""
    episodes: Count = 1000
    """Held-out episodes."""
    seed: Seed = 1
    """Seed of the targets."""
    perturb: bool = False
    """Give every episode an arm of its own and noisy measurements; see `perturb` of train."""
    perturb_view: bool = False
    """Show every episode in a view of its own, to a policy that sees; see `randomise_view` of train."""
    gui: bool = False
    """PyBullet: open its window."""
    slow: bool = False
    """PyBullet: slow down to be followed by eye."""
    json: bool = False
    """Print the report as JSON on standard output; a list of them for several agents or simulators."""


@dataclass(frozen=True)
class Video(Checked):
    """Film held-out episodes of a run."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run directory."""
    out: Path | None = None
    """File to write (.webp, .gif, or .mp4 with the extra `video`); by default video.webp in the run."""
    sim: str | None = None
    """Simulator; by default the run's own."""
    agent: str = "trained"
    """Agent: trained, random, zero, ik."""
    episodes: Count = 4
    """Episodes, one after the other: the first ones of `reachlab eval` with that seed."""
    seed: Seed = 1
    """Seed of the targets."""
    fps: Positive = 30.0
    """Pictures a second, about: each shows a whole number of control steps."""
    speed: Positive = 1.0
    """1 is real time, 0.5 half as fast."""
    json: bool = False
    """Print what was filmed as one JSON object on standard output."""


@dataclass(frozen=True)
class View(Checked):
    """Watch a run in the browser and move its target by hand."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run directory."""
    sim: str | None = None
    """Simulator; by default the run's own."""
    agent: str = "trained"
    """Agent to begin with: trained, random, zero, ik, ik_open."""
    seed: Seed = 1
    """Seed of the targets."""
    host: str = "127.0.0.1"
    """Address to listen on; by default no other machine reaches it."""
    port: Annotated[int, Range(1, 65535)] = 8080
    """Port to listen on; the next free one where it is taken."""
    open: bool = False
    """Open the page in the browser."""
    save: Path | None = None
    """Write recorded episodes as one page that needs no server and no network, and end."""
    episodes: Count = 5
    """Episodes of the saved page."""


@dataclass(frozen=True)
class Plot(Checked):
    """Draw learning curves, and of what was evaluated the errors and failures."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Run directories; those that differ by their seeds alone become one curve with its interval."""
    out: Path | None = None
    """Picture to write (.png or .svg); by default plots.png in the first run."""


@dataclass(frozen=True)
class Bench(Checked):
    """Measure speed, accuracy and learning on this machine."""

    suite: str = "speed"
    """Suite: speed, kinematics, learning, start, simulators, precise, soak, trust, viewer, camera, pixels."""
    json: bool = False
    """Print the measurements as a JSON list on standard output."""
    markdown: bool = False
    """Print them as a Markdown table, with the machine and the versions."""


@dataclass(frozen=True)
class List(Checked):
    """Show tasks, robots, simulators, observations, actions, rewards and agents."""

    json: bool = False
    """Print them as one JSON object on standard output."""


def train(arguments: Train) -> None:
    """Run `reachlab train`."""
    _learn(arguments, arguments.run, "train")


def distil(arguments: Distil) -> None:
    """Run `reachlab distil`."""
    _learn(arguments, _distillation(arguments), "distil")


def _distillation(arguments: Distil) -> RunConfig:
    """Settings of a distillation: those of the run to go on with, or of the teacher with what the flags say."""
    from reachlab.checkpoint import RunDirectory

    if arguments.resume:
        return RunDirectory(arguments.resume).read_config()
    if arguments.teacher is None:
        raise InputError("distil needs a teacher: name the run directory of one, as `reachlab train` makes it.")
    taught = RunDirectory(arguments.teacher).read_config()
    config = in_simulator(taught, arguments.sim or taught.sim)
    same = ("observation", "seed", "randomise_view", "total_steps", "report_episodes", "deterministic")
    chosen = {name: getattr(arguments, name) for name in same} | vars(arguments.settings)
    return distillation(str(arguments.teacher), config, **chosen)


def _learn(arguments: Train | Distil, config: RunConfig, verb: str) -> None:
    """Train or distil, and show what came of it."""
    from reachlab.interrupts import raise_on_termination

    raise_on_termination()
    if config.verb != verb:
        raise InputError(f"run '{arguments.resume}' goes on with `reachlab {config.verb} --resume {arguments.resume}`.")
    if arguments.resume and _told_that_finished(arguments, config, arguments.resume):
        return
    _prepare_jax()
    from reachlab.console import TrainDisplay, console, print_reports
    from reachlab.plots import plot as draw
    from reachlab.training import distil as run_distillation
    from reachlab.training import train as run_training

    out = arguments.resume or arguments.out or Path("runs") / f"{time.strftime('%Y%m%d-%H%M%S')}-{config.task}"
    settings = {"resume": arguments.resume is not None, "tensorboard": arguments.tensorboard}
    with TrainDisplay() as display:
        if isinstance(config, DistilRunConfig):
            result = run_distillation(config, out, display, **settings)
        else:
            result = run_training(config, out, display, **settings)
    draw([out], out / "curve.png")
    if arguments.json:
        print(jsonlib.dumps(result.to_json()))
    print_reports([result.to_json()])
    if result.validated is False:
        console.print(
            f"No validation reached {config.ppo.stop_success:g} success within {config.ppo.total_steps:,} steps."
        )
    console.print(
        f"{result.steps:,} steps in {result.train_wall_s:.1f} s, {result.steps_per_second:,.0f} steps/s;"
        f" with the report {result.total_wall_s:.1f} s. Written to {out}: report.json, curve.png, checkpoint."
    )
    console.print(f"Next: reachlab eval {out} --agent trained random ik")


def _told_that_finished(arguments: Train | Distil, config: RunConfig, folder: Path) -> bool:
    """Whether the run to go on with is finished, and this was said.

    Raises:
        InputError: it cannot be gone on with; this is found before JAX is loaded.
    """
    from reachlab.checkpoint import RunDirectory
    from reachlab.storage import read_json

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
    """Run `reachlab eval`."""
    _prepare_jax()
    from reachlab.checkpoint import RunDirectory
    from reachlab.console import print_reports
    from reachlab.env import Env
    from reachlab.evaluation import AGENTS, LANES, examine
    from reachlab.sims import SIMULATORS
    from reachlab.training import load_policy

    for agent in arguments.agent:
        choose("agent", agent, AGENTS)
    run = RunDirectory(arguments.run)
    trained = run.read_config()
    names = list(SIMULATORS) if arguments.sim == "all" else [arguments.sim or trained.sim]
    reports = []
    for name in names:
        config = in_simulator(trained, choose("simulator", name, [*SIMULATORS, "all"]))
        if (arguments.gui or arguments.slow) and name != "pybullet":
            raise InputError(f"--gui and --slow are PyBullet's, and the simulator is {name!r}: add --sim pybullet.")
        config = override(config, gui=arguments.gui, slow=arguments.slow, perturb=arguments.perturb)
        config = override(config, randomise_view=arguments.perturb_view)
        env = Env(config, 1 if arguments.gui else min(arguments.episodes, EVALUATION_LANES.get(name, LANES)))
        policy = load_policy(run, config, env)
        for agent in arguments.agent:
            result, played = examine(env, agent, policy, seed=arguments.seed, episodes=arguments.episodes)
            report = result.to_json()
            rows = {"target": played.target, "distance": played.distance, "success": played.success}
            kind = "-perturbed" * arguments.perturb + "-views" * arguments.perturb_view
            run.write_report(f"{name}-{agent}-{arguments.seed}{kind}", report, rows)
            reports.append(report)
        env.close()
    if arguments.json:
        print(jsonlib.dumps(reports[0] if len(reports) == 1 else reports))
    else:
        print_reports(reports)


def video(arguments: Video) -> None:
    """Run `reachlab video`."""
    _prepare_jax()
    from reachlab.checkpoint import RunDirectory
    from reachlab.console import console
    from reachlab.env import Env
    from reachlab.evaluation import AGENTS
    from reachlab.sims import SIMULATORS
    from reachlab.training import load_policy
    from reachlab.video import write_video

    agent = choose("agent", arguments.agent, AGENTS)
    run = RunDirectory(arguments.run)
    trained = run.read_config()
    config = in_simulator(trained, choose("simulator", arguments.sim or trained.sim, SIMULATORS))
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
    console.print(
        f"Written: {clip.out}, {clip.seconds:.1f} s, {clip.frames} pictures, {clip.bytes / 1e6:.2f} MB:"
        f" {clip.successes} of {clip.episodes} episodes reach the target."
    )


def view(arguments: View) -> None:
    """Run `reachlab view`."""
    _prepare_jax()
    from reachlab.checkpoint import RunDirectory
    from reachlab.console import console
    from reachlab.env import Env
    from reachlab.interrupts import Interrupts
    from reachlab.sims import SIMULATORS
    from reachlab.stage import is_local
    from reachlab.training import load_policy
    from reachlab.viewer import Viewer, save_page

    run = RunDirectory(arguments.run)
    trained = run.read_config()
    config = in_simulator(trained, choose("simulator", arguments.sim or trained.sim, SIMULATORS))
    steps = run.checkpoint_steps()
    env = Env(config, 1)
    if arguments.save:
        save_page(
            env, arguments.agent, load_policy(run, config, env), arguments.seed, arguments.episodes, arguments.save
        )
        env.close()
        console.print(f"Written: {arguments.save}")
        return
    load = partial(load_policy, run, config, env)
    with (
        Viewer(env, steps, load, arguments.agent, arguments.host, arguments.port) as viewer,
        Interrupts() as interrupts,
    ):
        console.print(f"Viewer: {viewer.url}   Ctrl-C ends it.")
        if not is_local(arguments.host):
            console.print(
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
    from reachlab.console import console
    from reachlab.plots import plot as draw

    if not arguments.runs:
        raise InputError("plot needs at least one run directory.")
    out = arguments.out or arguments.runs[0] / "plots.png"
    draw(arguments.runs, out)
    console.print(f"Written: {out}")


def bench(arguments: Bench) -> None:
    """Run `reachlab bench`."""
    _prepare_jax()
    from reachlab.bench import run_suite, to_markdown
    from reachlab.console import print_table

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
    _prepare_jax()
    from reachlab.console import print_table
    from reachlab.evaluation import AGENTS
    from reachlab.robots import ROBOTS
    from reachlab.sims import SIMULATORS
    from reachlab.task import ACTIONS, OBSERVATIONS, REWARDS

    names: dict[str, dict[str, str]] = {
        "tasks": {
            name: f"{config.rules.observation}, {config.rules.action}, {config.rules.reward}; simulator {config.sim}"
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status of the command line; see `DONE`, `WRONG_INPUT`, `NOT_FINITE`, `INTERRUPTED`."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        if not words or words[0] in ("-h", "--help"):
            print(_overview())
            return DONE
        verb = VERBS[choose("command", words[0], VERBS)]
        verb.run(_parse(words[0], verb.flags, words[1:]))
    except InputError as error:
        print(f"reachlab: {error}", file=sys.stderr)
        return WRONG_INPUT
    except OSError as error:
        print(f"reachlab: {error.filename or 'a file'} cannot be used: {error.strerror or error}.", file=sys.stderr)
        return WRONG_INPUT
    except FloatingPointError as error:
        print(f"reachlab: {error}", file=sys.stderr)
        return NOT_FINITE
    except KeyboardInterrupt as interruption:
        print(f"reachlab: {str(interruption) or 'interrupted.'}", file=sys.stderr)
        return vars(interruption).get("status", INTERRUPTED)
    return DONE


def _overview() -> str:
    width = max(map(len, VERBS))
    verbs = "\n".join(f"  {name:{width}}  {verb.flags.__doc__}" for name, verb in VERBS.items())
    return (
        "usage: reachlab COMMAND [OPTIONS]\n\nTrains robot arms to reach, and proves how well they do it.\n\n"
        f"commands:\n{verbs}\n\n`reachlab COMMAND --help` shows a command's options. A first run: reachlab train"
    )


def _parse(verb: str, flags: type, words: list[str]) -> Any:
    """Flags of a verb; `--task`, `--sim` and `--observation` are read first and set the other defaults.

    Raises:
        InputError: a flag or value that is not allowed, in one sentence.
    """
    default: Any = tyro.MISSING_NONPROP
    if flags is Train:
        default = Train(run=_defaults(words))
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(
                flags, prog=f"reachlab {verb}", args=words, default=default, config=(tyro.conf.OmitArgPrefixes,)
            )
    except SystemExit as end:
        if not end.code:
            raise
        raise InputError(f"{_sentence(said.getvalue())} See `reachlab {verb} --help`.") from None


def _defaults(words: Sequence[str]) -> RunConfig:
    """Settings that the flags of a training change: those of the run to go on with, or a preset."""
    if folder := _value_of("--resume", words):
        from reachlab.checkpoint import RunDirectory

        return RunDirectory(Path(folder)).read_config()
    task, sim, observation = (_value_of(flag, words) for flag in ("--task", "--sim", "--observation"))
    return preset(task or "tutorial", sim, observation)


def _value_of(flag: str, words: Sequence[str]) -> str | None:
    for word, following in zip(words, [*words[1:], None], strict=True):
        if word == flag:
            return following
        if word.startswith(f"{flag}="):
            return word.partition("=")[2]
    return None


def _sentence(box: str) -> str:
    """The first statement of tyro's framed message, and the flag it suggests; frames may be drawn in ASCII."""
    rows = [line.strip("│╭╮╰╯|+ ") for line in box.splitlines()[1:]]
    parts = [list(part) for rule, part in itertools.groupby(rows, lambda row: not row.strip("─-")) if not rule]
    text = re.sub(r"^Error parsing [\w.]+: ", "", " ".join(parts[0])).rstrip(".") + "."
    for heading, *rest in parts[1:]:
        if heading.startswith("Perhaps you meant"):
            text += f" Did you mean {next(row for row in rest if row.startswith('--')).split()[0].rstrip(',')}?"
    return text


def _prepare_jax() -> None:
    """Quiet XLA's log, which prints pages of CPU features when it reads the compilation cache, and use the cache."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    from reachlab.compilation import use_compilation_cache

    use_compilation_cache()
