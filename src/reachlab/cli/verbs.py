"""The verbs `bench` and `list`, and the table of all verbs."""

from __future__ import annotations

import json as jsonlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from reachlab.bench import SUITES, run_suite
from reachlab.cli.deploy_command import deploy, export
from reachlab.cli.deploy_flags import Deploy, Export
from reachlab.cli.eval_command import evaluate
from reachlab.cli.flags import Bench, Distil, Eval, List, Plot, ShowRobot, Train, Video, View
from reachlab.cli.preparation import prepare
from reachlab.cli.record_command import record
from reachlab.cli.record_flags import Record
from reachlab.cli.robot_command import robot
from reachlab.cli.sweep_command import sweep
from reachlab.cli.sweep_flags import Sweep
from reachlab.cli.train_command import distil, train
from reachlab.cli.watch_commands import plot, video, view
from reachlab.settings.cache import kept, package
from reachlab.settings.extensions import extended
from reachlab.settings.validation import choose


def bench(arguments: Bench) -> None:
    """Run `reachlab bench`."""
    prepare()
    from reachlab.bench.table import cell, settings, to_markdown
    from reachlab.cli.console import print_table

    rows = run_suite(arguments.suite)
    if arguments.json:
        print(jsonlib.dumps(rows))
    elif arguments.markdown:
        print(to_markdown(rows), end="")
    else:
        cells = [(row["name"], cell(row), row["unit"], settings(row)) for row in rows]
        print_table(f"suite {arguments.suite}", ("measurement", "value", "unit", "configuration"), cells)


def list_names(arguments: List) -> None:
    """Run `reachlab list`; what it says is kept, since half of the package has to be loaded to find it."""
    from reachlab.cli.console import print_table

    names = (
        _names() if extended() else kept("names", (package(), version("reachlab")), _names, dict, lambda names: names)
    )
    chosen = [choose("kind", kind.replace("-", " "), names) for kind in arguments.kind]
    names = {kind: names[kind] for kind in chosen or names}
    if arguments.json:
        print(jsonlib.dumps(names))
    else:
        for kind, entries in names.items():
            print_table(kind, ("name", "what it is"), list(entries.items()))


def _names() -> dict[str, dict[str, str]]:
    """Names that settings may have, by kind, with what each is."""
    prepare()
    from reachlab.agents import AGENTS
    from reachlab.cli.console import task_and_success
    from reachlab.envs.presets import preset
    from reachlab.render import CAMERAS
    from reachlab.robots.catalogue import ROBOTS
    from reachlab.runs.shipped import shipped, told
    from reachlab.scale import ENGINES
    from reachlab.scale.goals import GOALS
    from reachlab.sims import SIMULATORS
    from reachlab.tasks import TASKS
    from reachlab.tasks.actions import ACTIONS
    from reachlab.tasks.observations import OBSERVATIONS
    from reachlab.tasks.paths import PATHS
    from reachlab.tasks.rewards import REWARDS
    from reachlab.tasks.targets import TARGETS
    from reachlab.tasks.tutorial import AT_GOAL

    return {
        "tasks": {
            name: f"{task_and_success(config)[0]}. Unless told otherwise: simulator {config.sim}, observation"
            f" {config.rules.observation}, action {config.rules.action}, reward {config.rules.reward}"
            for name, config in ((name, preset(name)) for name in TASKS)
        },
        "robots": {
            name: f"{robot.title}; tool frames {', '.join(robot.tools.values())}" for name, robot in ROBOTS.items()
        },
        "simulators": {name: entry.summary for name, entry in SIMULATORS.items()},
        "observations": {name: design.summary for name, design in OBSERVATIONS.items()},
        "actions": {name: design.summary for name, design in ACTIONS.items()},
        "rewards": {name: _summary(reward) for name, reward in REWARDS.items()},
        "targets": {name: targets.summary for name, targets in TARGETS.items()},
        "goal paths": {name: path.summary for name, path in PATHS.items()},
        "at goal": dict(AT_GOAL),
        "engines": {name: engine.summary for name, engine in ENGINES.items()},
        "goals of a sweep": {name: "most" if goal.maximise else "least" for name, goal in GOALS.items()},
        "agents": {name: agent.summary for name, agent in AGENTS.items()},
        "cameras": {name: entry.summary for name, entry in CAMERAS.items()},
        "policies": {name: told(run) for name, run in shipped().items()},
        "suites": {name: suite.summary for name, suite in SUITES.items()},
    }


def _summary(function: Callable[..., Any]) -> str:
    """The first sentence of a docstring."""
    return (function.__doc__ or "").partition("\n")[0].strip()


@dataclass(frozen=True)
class Verb:
    """A verb: its flags and its function."""

    flags: type
    run: Callable[[Any], None]


VERBS: dict[str, Verb] = {
    "robot": Verb(ShowRobot, robot),
    "train": Verb(Train, train),
    "distil": Verb(Distil, distil),
    "sweep": Verb(Sweep, sweep),
    "eval": Verb(Eval, evaluate),
    "video": Verb(Video, video),
    "view": Verb(View, view),
    "plot": Verb(Plot, plot),
    "record": Verb(Record, record),
    "export": Verb(Export, export),
    "deploy": Verb(Deploy, deploy),
    "bench": Verb(Bench, bench),
    "list": Verb(List, list_names),
}


def overview() -> str:
    """What `reachlab` without a command prints."""
    width = max(map(len, VERBS))
    verbs = "\n".join(f"  {name:{width}}  {verb.flags.__doc__}" for name, verb in VERBS.items())
    return (
        "usage: reachlab COMMAND [OPTIONS]\n\nTrains robot arms to reach, and proves how well they do it.\n\n"
        f"commands:\n{verbs}\n\n`reachlab COMMAND --help` shows a command's options, `reachlab --version` the version."
        " A first run: reachlab train\n`--import MODULE|FILE`, of every command, imports a module of yours with tasks,"
        " robots or other entries of the tables; runs remember it."
    )
