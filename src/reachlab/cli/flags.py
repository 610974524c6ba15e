"""Flags of the command line: the fields of a dataclass for each verb."""

from __future__ import annotations

from dataclasses import dataclass, field, make_dataclass
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import tyro

from reachlab.agents import AGENTS
from reachlab.bench import SUITES
from reachlab.cli.short_help import field_docstrings, first_sentence
from reachlab.envs.presets import DISTILLATION
from reachlab.runs.sinks import SINKS
from reachlab.scale import ENGINES
from reachlab.settings.config import DaggerConfig, RunConfig
from reachlab.settings.validation import (
    Checked,
    Count,
    Fraction,
    NonNegative,
    NonNegativeInt,
    Positive,
    Range,
    Seed,
    Steps,
    choose,
    hints,
)
from reachlab.tasks import TASKS

Optional = tyro.conf.arg(metavar="PATH", help_behavior_hint="")
"""A path that may be left out."""

Agent = Annotated[str, tyro.conf.arg(help=f"Agent: {', '.join(AGENTS)}.")]
Agents = Annotated[tuple[str, ...], tyro.conf.arg(help=f"Agents: {', '.join(AGENTS)}.")]


Engine = Annotated[str, tyro.conf.arg(help=f"What carries the workers: {', '.join(ENGINES)}.")]
Address = Annotated[
    str | None,
    tyro.conf.arg(
        help="Address of a Ray cluster; by default Ray is started here.",
        metavar="HOST:PORT",
        help_behavior_hint="",
    ),
]


def _sink_flags() -> type:
    """Dataclass with a flag for every sink."""
    flags = [(name, Annotated[bool, tyro.conf.arg(help=sink.summary)], False) for name, sink in SINKS.items()]
    return make_dataclass("SinkFlags", flags, frozen=True)


@dataclass(frozen=True)
class Training(Checked):
    """Flags of whatever trains one policy."""

    out: Annotated[Path | None, Optional] = None
    """Run directory to make; by default a new one below runs/."""
    resume: Annotated[Path | None, Optional] = None
    """Run directory to resume, with its own settings; training continues from its newest checkpoint."""
    sinks: Annotated[Any, tyro.conf.arg(name="", constructor_factory=_sink_flags)] = field(
        default_factory=lambda: _sink_flags()()  # noqa: PLW0108 (tables may grow until it is called)
    )
    json: bool = False
    """Print the result as one JSON object on standard output."""


@dataclass(frozen=True)
class Train(Training):
    """Train a policy and report on held-out targets."""

    # Without a name, its own settings are in the first group of flags, and its parts are groups under their own names.
    run: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)
    config: Annotated[Path | None, Optional] = None
    """File with all settings; flags change them. It is the config.json of a run or the best.json of a sweep."""
    workers: NonNegativeInt = 0
    """Processes that collect experience, of one thread each; with 0 this one does. The weights are the same."""
    engine: Engine = "ray"
    address: Address = None


@dataclass(frozen=True)
class Distil(Training):
    """Teach a policy that gets camera pictures, by one that gets the positions themselves."""

    teacher: Annotated[Path | None, tyro.conf.Positional] = None
    """Run directory of the teacher, or a policy of `reachlab list`."""
    observation: str = "image"
    """What the student observes, with a picture in it; see `reachlab list`."""
    sim: Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")] = None
    """Simulator, kinematic or mujoco; by default the teacher's."""
    seed: Seed = 0
    """Seed of everything random."""
    randomise: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[STR ...]", help_behavior_hint="")] = None
    """What varies from episode to episode, of dynamics, delay, lag and view; by default what varied for the teacher."""
    total_steps: Steps = DISTILLATION["total_steps"]
    """Environment steps after which training ends: 4,096 an iteration with the default `--action-repeat`."""
    report_episodes: Count = DISTILLATION["report_episodes"]
    """Held-out episodes of the report at the end."""
    action_repeat: Count = DISTILLATION["action_repeat"]
    """While training, steps from one picture to the next; the action is the same in between."""
    memory: Annotated[int, Range(0, 4096)] = 0
    """Numbers that the student remembers from step to step; 0: it acts by what it observes now."""
    goal_lost: Annotated[Fraction | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint="")] = None
    """Share of the steps in which its picture is black; by default the teacher's, none."""
    deterministic: bool = False
    """Compute on one thread: the same weights on any number of cores."""
    settings: DaggerConfig = field(default_factory=DaggerConfig)


STUDENT = ("observation", "seed", "randomise", "total_steps", "report_episodes", "action_repeat", "deterministic")
STUDENT += ("memory", "goal_lost")
"""Flags of `Distil` that are settings of its run, beside `settings`."""


def evaluated() -> list[str]:
    """Settings of any task that an evaluation may change.

    Raises:
        InputError: a task's `evaluated` names one that it has not.
    """
    names: dict[str, None] = {}
    for task, kind in ((task, entry.load()) for task, entry in TASKS.items()):
        names |= {choose(f"setting in {task}'s `evaluated`", name, hints(kind)): None for name in kind.evaluated}
    return list(names)


def _goal_flags() -> type:
    """Dataclass with a flag for each setting that is `evaluated`; None where one is not given."""
    kinds: dict[str, Any] = {}
    for name, kind in chain.from_iterable(hints(task.load()).items() for task in TASKS.values()):
        same = kinds.setdefault(name, kind) == kind  # else each task checks it by the limits of its own
        kinds[name] = kind if same or get_origin(kind) is not Annotated else get_args(kind)[0]
    texts = {name: text for task in reversed(TASKS.values()) for name, text in field_docstrings(task.load()).items()}

    def flag(name: str) -> Any:
        text = first_sentence(texts.get(name, "A setting of its task."))
        marks = tyro.conf.arg(help=text, metavar="VALUE", help_behavior_hint="")
        return Annotated[kinds[name] | None, marks]

    flags = [(name, flag(name), None) for name in evaluated()]
    return make_dataclass("GoalFlags", flags, bases=(Checked,), frozen=True)


GoalFlags = Annotated[Any, tyro.conf.arg(name="", constructor_factory=_goal_flags)]
"""A flag for each setting that is `evaluated`."""


def no_goals() -> Any:
    """None of them is given."""
    return _goal_flags()()


@dataclass(frozen=True)
class Arm(Checked):
    """Flags of an arm beside its name."""

    tool: Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")] = None
    """Tool frame, a site or body; by default the catalogue's for the task, or the one found in the file."""
    base: Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")] = None
    """Body of the robot's file that holds the arm; joints before it are locked. By default its first."""
    package: tuple[str, ...] = ()
    """Folders of the ROS packages that the file names, each as NAME=FOLDER."""


@dataclass(frozen=True)
class Subjects(Arm):
    """Flags of whatever plays episodes: by runs, models of other libraries or baselines, on which goals."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Run directories, policies that come with reachlab, as `panda/precise`, policies in ONNX (.onnx or an export),
    models of Stable-Baselines3 (.zip) or policies that LeRobot has saved; baselines need none. `eval` gives means of
    those that differ by seed."""
    trust: bool = False
    """The model's file may run code: it is unpickled."""
    normaliser: Annotated[Path | None, Optional] = None
    """What `VecNormalize.save` wrote, if the model was trained with one; it is unpickled too."""
    task: Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")] = None
    """Task preset, where there is no run; see `reachlab list`."""
    robot: Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")] = None
    """Robot, where there is no run: a name of `reachlab list`, or the path of an MJCF or URDF file."""
    sim: Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")] = None
    """Simulator, for `eval` also `all` of them; by default the run's own or the task's."""
    goals: GoalFlags = field(default_factory=no_goals)
    """Other goals than those of the run or the task; reports of a run on such goals are not kept in it."""


@dataclass(frozen=True)
class Eval(Subjects):
    """Evaluate a run beside its baselines, or baselines alone, on held-out targets."""

    agent: Agents = ("trained",)
    episodes: Count = 1000
    """Held-out episodes."""
    seed: Seed = 1
    """Seed of the targets."""
    randomise: tuple[str, ...] = ()
    """What varies from episode to episode: dynamics, delay, lag, of tasks with an object objects and sight, and for a
    policy that gets pictures view."""
    gui: bool = False
    """PyBullet: open its window."""
    slow: bool = False
    """PyBullet: slow down to be followed by eye."""
    json: bool = False
    """Print the report as JSON on standard output; a list of them for several agents or simulators."""


@dataclass(frozen=True)
class ShowRobot(Arm):
    """Show what is known of an arm, in the catalogue or in a file of your own: the first thing to do with a new one."""

    robot: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="NAME|FILE", help_behavior_hint="")] = None
    """Robot: a name of `reachlab list`, or the path of an MJCF or URDF file."""
    task: Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")] = None
    """Task whose tool frame is taken where the catalogue lists several; by default its first one."""
    out: Annotated[Path | None, Optional] = None
    """Picture to write (.png): the arm at home, its workspace, and a target in the middle of its floor."""
    json: bool = False
    """Print all of it as one JSON object on standard output."""


@dataclass(frozen=True)
class Video(Subjects):
    """Film held-out episodes of a run, or of a baseline."""

    out: Annotated[Path | None, Optional] = None
    """File to write (.webp, .gif, or .mp4 with the extra `video`); by default video.webp in the run directory."""
    agent: Agent = "trained"
    episodes: Count = 4
    """Episodes, one after the other: the first ones of `reachlab eval` with that seed."""
    seed: Seed = 1
    """Seed of the targets."""
    fps: Positive = 30.0
    """Pictures a second, about: each shows a whole number of control steps."""
    speed: NonNegative = 0.0
    """1 is real time, 0.5 half as fast; with 0 it is slow enough to be followed by eye."""
    json: bool = False
    """Print what was filmed as one JSON object on standard output."""


@dataclass(frozen=True)
class View(Subjects):
    """Watch runs in the browser, and move goals, bodies and joints by hand: one page, with the physics of training."""

    agent: Agent = "trained"
    seed: Seed = 1
    """Seed of the held-out episodes."""
    checkpoints: bool = False
    """All checkpoints of the runs to choose from, not only the newest."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="", aliases=("--live", "--save"))] = (
        None
    )
    """Write the page to this file, and end: it needs neither server nor network. What a browser cannot compute is
    recorded in it."""
    episodes: Count = 5
    """Episodes that are recorded, where any are."""
    host: str = "127.0.0.1"
    """Address to listen on; by default no other machine reaches it."""
    port: Annotated[int, Range(1, 65535)] = 8080
    """Port to listen on; the next free one where it is taken."""
    open: bool = False
    """Open the page in the browser."""


@dataclass(frozen=True)
class Plot(Checked):
    """Draw learning curves, and of what was evaluated the errors and failures."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Run directories; those that differ by their seeds alone become one curve with its interval."""
    out: Annotated[Path | None, Optional] = None
    """Picture to write (.png or .svg); by default plots.png in the first run."""


@dataclass(frozen=True)
class Bench(Checked):
    """Measure speed, accuracy and learning on this machine."""

    suite: Annotated[str, tyro.conf.arg(help=f"Suite: {', '.join(SUITES)}.")] = "speed"
    json: bool = False
    """Print the measurements as a JSON list on standard output."""
    markdown: bool = False
    """Print them as a Markdown table, with the machine and the versions."""


@dataclass(frozen=True)
class List(Checked):
    """Show tasks, robots, simulators, observations, actions, rewards, targets, agents, policies and suites of bench."""

    kind: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="KIND")] = ()
    """Which of them, as `robots`; by default all."""
    json: bool = False
    """Print them as one JSON object on standard output."""
