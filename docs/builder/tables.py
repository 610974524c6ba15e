"""Tables of tasks, observations, actions, rewards and what else has a name, from the package's own tables."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping

from builder.markdown import code, number, span, table
from reachlab.agents import AGENTS
from reachlab.bench import SUITES
from reachlab.cli.console import task_and_success
from reachlab.envs.consistency import RANDOMISED, check
from reachlab.envs.presets import configure, preset
from reachlab.envs.setup import make_setup
from reachlab.envs.uses import USES
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.loading import load_robot
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS, joint_scale
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.paths import PATHS
from reachlab.tasks.rewards import REWARDS
from reachlab.tasks.schema import Field
from reachlab.tasks.targets import TARGETS
from reachlab.tasks.tutorial import AT_GOAL

TERMS = {
    "goal": "the target's position",
    "tool": "the tool's position",
    "image": "the camera's picture, rows from the top",
    "joints": "the measured joints",
    "joint_speeds": "their speeds",
    "lag": "how far each joint is behind its command",
    "way": "from the tool to the target",
    "way_near": "the same, divided by its length and 0.02 m: it tells the last millimetres apart",
    "seen": "1 where the target is seen, or else 0",
    "last_action": "the action before this one",
    "tool_axes": "first two axes of the tool's frame",
    "goal_axes": "first two axes of the target's frame",
    "turn": "from the tool's orientation to the target's, as an axis times twice the sine of half the angle",
    "turn_near": "the same, divided by its length and 0.2 rad",
    "joint_way": "from the joints to those at which the tool is at the target",
    "goal_velocity": "the target's velocity; zero where it is not told",
    "clearance": "for each capsule of the arm, the direction away from what is nearest to it, longer the nearer it is",
    "bodies": "of each body whether it is there, place, half sides, radius, first two axes; in proportion to the arm",
    "scene": "how near obstacles are to the points of a grid of 4 × 4 × 4",
    "object_way": "from the tool to the object",
    "left": "from the object to the target, along the table",
    "left_near": "the same, divided by its length and 0.02 m",
    "faces": "sine and cosine of four times the object's yaw; 0 of one that is round",
    "left_all": "from the object to the goal",
    "left_all_near": "the same, divided by its length and 0.02 m",
    "opening": "opening of the gripper",
    "squeeze": "how far below the opening the gripper is commanded",
    "object_velocity": "velocity of the object along the table",
    "achieved_goal": "where the tool is, or the object that it moves",
    "desired_goal": "where it is asked to be",
}
"""What each term of an observation is."""

FEW = 3
"""Terms of an observation that are told again where another has them too."""

CLOSE = "closeness_scale / (closeness_scale + gap)"

FORMULAS = {
    "sparse": {"reach": "gained", "outside": "-0.1 * outside", "timeout": "-0.1 * timeout * (1 - success)"},
    "dense": {
        "reach": "gained",
        "outside": "-0.1 * outside",
        "timeout": "-0.1 * timeout * (1 - success)",
        "approach": "approach_weight * (gap_before - gap)",
    },
    "precise": {
        "approach": "approach_weight * (gap_before - gap)",
        "closeness": f"closeness_weight * {CLOSE}",
        "stillness": f"closeness_weight * {CLOSE} * hold_speed / (hold_speed + speed)",
        "effort": "-effort_weight * effort",
    },
    "closeness": {"closeness": f"closeness_weight * {CLOSE}", "effort": "-effort_weight * effort"},
    "goal": {"goal": "-(1 - near)"},
    "goal_distance": {"goal_distance": "-gap"},
}
"""Terms of each reward; tests/test_site.py computes them beside the functions themselves."""

VARIED = {
    "dynamics": "in MuJoCo servo gains within 15 %, joint damping within 30 % and a payload at the tool; in every"
    " simulator joints measured with noise of 0.5 mrad and 0.01 rad/s, and a wrench with 0.1 N and 0.005 Nm",
    "delay": "measurements are a control period old and up to 10 ms more, and 5 % of them do not come",
    "lag": "in MuJoCo joints follow a fifth to one and a half times as late as usual, which is by 0.1 s of most arms",
    "sight": "an object is seen one to three steps late, and a tenth of the sights do not come",
    "objects": "an object's mass from 0.3 to 3 times, its friction from 0.3 to 1 and its size within 25 %; all an"
    " episode it is measured up to 5 mm and 5° off",
    "view": "light, colours, uneven brightness, grain, and the camera's pose within 2 cm and 2°",
}
"""What each choice of `randomise` varies."""


def _tasks() -> str:
    configs = {name: preset(name) for name in TASKS}
    asks = table(
        ["task", "asks the arm to"], [[code(name), task_and_success(config)[0]] for name, config in configs.items()]
    )
    choices = [
        [name, one.sim, one.rules.observation, one.rules.action, one.rules.reward] for name, one in configs.items()
    ]
    heads = ["by default", "simulator", "observation", "action", "reward"]
    return f"{asks}\n{table(heads, [list(map(code, row)) for row in choices])}"


def _successes() -> str:
    return table(
        ["task", "an episode is a success if"], [[code(name), task_and_success(preset(name))[1]] for name in TASKS]
    )


def _presets() -> str:
    """Settings of each task's preset that differ from those of the tutorial's."""
    usual = flatten(to_json(preset("tutorial")))
    others = {name: flatten(to_json(preset(name))) for name in TASKS if name != "tutorial"}
    names = dict.fromkeys(key for one in (usual, *others.values()) for key in one if key != "task")
    changed = [key for key in names if any(usual.get(key) != other.get(key) for other in others.values())]
    rows = [[code(key), *(_setting(one.get(key)) for one in (usual, *others.values()))] for key in changed]
    return table(["setting", "tutorial", *others], rows)


def _setting(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_setting, value)) or "–"
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "–"}[value]
    return f"{value:,.6g}" if isinstance(value, float) else f"{value:,}" if isinstance(value, int) else str(value)


def _fitting(**chosen: str) -> RunConfig:
    """The preset of a task with which settings fit together: one that has them by default, or the first.

    Raises:
        InputError: there is none.
    """
    usual = {task: flatten(to_json(preset(task))) for task in TASKS}
    for task in sorted(TASKS, key=lambda task: any(usual[task].get(name) != value for name, value in chosen.items())):
        try:
            config = configure(task, **chosen)
            check(config)
        except InputError:
            continue
        return config
    raise InputError(f"no task allows {chosen}.")


def _observations() -> str:
    parts, shown = [], {}
    for name, design in OBSERVATIONS.items():
        fields = design.schema(make_setup(_fitting(observation=name))).fields
        longer = [other for other, terms in shown.items() if len(terms) > FEW and design.terms[: len(terms)] == terms]
        known = len(shown[longer[0]]) if longer else 0
        before = f" Its terms are those of `{longer[0]}`, and:" if longer else ""
        shown[name] = design.terms
        terms = table(["term", "what it is", "shape", "unit", "bounds"], map(_term, fields[known:]))
        parts.append(f"### `{name}`\n\n{design.summary[0].upper()}{design.summary[1:]}.{before}\n\n{terms}")
    return "\n".join(parts)


def _term(field: Field) -> list[str]:
    shape = f"[{', '.join(map(str, field.shape))}]"
    return [code(field.name), TERMS[field.name], code(shape), field.unit.replace("1", "–"), span(field.low, field.high)]


def _actions() -> str:
    rows = []
    for name, design in ACTIONS.items():
        seen = {"observation": "image"} if "picture" in ACTIONS[name].needs else {}
        setup = make_setup(_fitting(action=name, **seen))
        low, high = design.bounds(setup)
        scale, *_ = USES["action"][name]
        unit = f"{number(setup.rules.tool_scale)} m" if scale == "tool_scale" else _joint_unit()
        unit = "half of the picture's side" if design.points else unit
        bounds = " × ".join(dict.fromkeys(span([a], [b]) for a, b in zip(low.tolist(), high.tolist(), strict=True)))
        rows.append(
            [
                code(name),
                design.summary,
                code(f"[{len(low)}]"),
                bounds,
                unit,
                code(f"--{scale}".replace("_", "-")),
            ]
        )
    return table(["action", "what it is", "shape", "bounds", "an action of 1", "set by"], rows)


def _joint_unit() -> str:
    """Displacement of a joint for an action of 1, where the setting gives one and where it is left to the arm."""
    given = joint_scale(make_setup(configure("precise", action="joint_delta")))
    return f"{number(float(given[0]))} rad in `precise`; else a control period at full speed"


def _rewards() -> str:
    rows = []
    for name, reward in REWARDS.items():
        summary = inspect.cleandoc(reward.__doc__ or "").partition("\n")[0]
        for index, (term, formula) in enumerate(FORMULAS[name].items()):
            rows.append([code(name) if not index else "", summary if not index else "", code(term), code(formula)])
    return table(["reward", "what it pays for", "term", "formula"], rows)


def _randomised() -> str:
    return table(
        ["`--randomise`", "what varies from episode to episode"], [[code(name), VARIED[name]] for name in RANDOMISED]
    )


def _robots() -> str:
    rows = []
    for name, known in ROBOTS.items():
        robot = load_robot(name)
        low, high = robot.workspace
        box = ", ".join(f"{axis} {span([a], [b])}" for axis, a, b in zip("xyz", low, high, strict=True))
        rows.append([code(name), known.title, str(robot.chain.n), ", ".join(map(code, known.tools.values())), box])
    return table(["robot", "what it is", "joints", "tool frames", "workspace [m]"], rows)


def _summaries(heading: str, entries: Mapping[str, str]) -> str:
    return table([heading, "what it is"], [[code(name), summary.rstrip(".")] for name, summary in entries.items()])


TABLES: dict[str, Callable[[], str]] = {
    "tasks": _tasks,
    "successes": _successes,
    "presets": _presets,
    "observations": _observations,
    "actions": _actions,
    "rewards": _rewards,
    "randomised": _randomised,
    "robots": _robots,
    "simulators": lambda: _summaries("simulator", {name: entry.summary for name, entry in SIMULATORS.items()}),
    "targets": lambda: _summaries("`--targets`", {name: entry.summary for name, entry in TARGETS.items()}),
    "paths": lambda: _summaries("`--goal-paths`", {name: entry.summary for name, entry in PATHS.items()}),
    "at goal": lambda: _summaries("`--at-goal`", AT_GOAL),
    "agents": lambda: _summaries("agent", {name: entry.summary for name, entry in AGENTS.items()}),
    "suites": lambda: _summaries("suite", {name: entry.summary for name, entry in SUITES.items()}),
}
"""Functions that give a table, or several with headings, by name."""
