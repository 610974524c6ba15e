"""A page in which policies themselves run: one file, without server and network."""

from __future__ import annotations

import base64
import json
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.agents.policy import Policy
from reachlab.watch.page.episode import DRAWN, drawn, programs
from reachlab.watch.page.physics import engine_of
from reachlab.watch.page.shapes import scene
from reachlab.emit.braced import JAVASCRIPT_HEAD, javascript_function
from reachlab.emit.program import Program, constants_of
from reachlab.envs.core import Env
from reachlab.envs.setup import in_evaluation
from reachlab.learn.load import load_policy
from reachlab.render import marks
from reachlab.robots.catalogue import ROBOTS
from reachlab.runs.shipped import find_run
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.watch.player import knows_home_alone
from reachlab.watch.server import TITLE

SIMULATORS = ("kinematic", "mujoco")
"""The simulators that a page has, of which the first shows policies of any other."""

ENGINE = {"wasm": "mujoco.wasm.zlib", "glue": "mujoco.js.zlib"}
"""The second of them, compressed, by the name of its part of a page."""

SCRIPTS = (
    *("vectors", "physics", "episode", "player", "solids", "light", "bodies"),
    *("drawing", "view", "hand", "panel", "perturb", "live"),
)
"""The page's scripts, each after those that it needs when it is read."""

STYLES = ("page.css", "panel.css", "narrow.css")
"""Its styles, of which later ones outrank earlier ones."""

RULES = ("success_distance", "hold_steps", "max_steps", "ends_outside", "settle_steps")
"""Settings of a task that the page's own scripts ask for; where a task has none it is 0."""


@dataclass(frozen=True)
class Shown:
    """A policy of a page.

    Attributes:
        name: of its run's directory.
        env: its environment in the page's simulator.
        policy: the policy.
    """

    name: str
    env: Env
    policy: Policy


def write_page(runs: Sequence[Path], out: Path) -> int:
    """Write a page in which the policies of runs can be chosen, and give its size [bytes].

    Raises:
        InputError: a run cannot be read or shown so, or the file cannot be written.
    """
    if not out.parent.is_dir():
        raise InputError(f"page '{out}' cannot be written: there is no folder '{out.parent}'.")
    page = live_page([load_shown(run) for run in runs]).encode()
    try:
        out.write_bytes(page)
    except OSError as error:
        raise InputError(f"page '{out}' cannot be written: {error.strerror}.") from None
    return len(page)


def load_shown(path: Path) -> Shown:
    """The newest policy of a run, in the page's simulator.

    Raises:
        InputError: the run cannot be read, or its policy needs pictures or bodies.
    """
    run = find_run(path)
    trained = run.read_config()
    if OBSERVATIONS[trained.rules.observation].pictured:
        raise InputError(
            f"'{path}' needs pictures, which a live page does not have: view it without --live, or record it with"
            " --save."
        )
    sim = trained.sim if trained.sim in SIMULATORS else SIMULATORS[0]
    env = Env(override(in_evaluation(trained, sim), shaping=False), 1)
    return Shown(path.name, env, load_policy(run, env))


def live_page(shown: Sequence[Shown]) -> str:
    """The page's HTML."""
    robots = {_scene_of(one): one.env.setup.robot for one in shown}
    several = len({one.env.config.task for one in shown}) > 1
    labels = [_title(one) + f" · {one.env.config.task}" * several for one in shown]
    counts, traced = Counter(labels), [programs(one.env, one.policy) for one in shown]
    facts = {
        "runs": [
            _facts(one, functions) | {"label": f"{label} · {one.name}" if counts[label] > 1 else label}
            for one, label, functions in zip(shown, labels, traced, strict=True)
        ],
        "scenes": {name: scene(robot) for name, robot in robots.items()},
        "marks": _marks(),
    }
    licences = [_file("three.LICENSE")]
    packed = {"three": zlib.compress(_bytes("three.min.js"), 9)}
    packed["script"] = zlib.compress(script(list(map(printed, traced))).encode(), 9)
    if any(one["physics"] for one in facts["runs"]):
        packed |= {name: _bytes(file) for name, file in ENGINE.items()}
        licences.append("MuJoCo 3.14.0, copyright DeepMind Technologies Limited\n" + _file("mujoco.LICENSE"))
    parts = {
        "title": f"{_title(shown[0])} · {shown[0].env.config.task} · {TITLE}",
        "style": "\n".join(map(_file, STYLES)),
        "licence": "\n".join(licences),
        # No `<` ends a script too early.
        "facts": json.dumps(facts, separators=(",", ":")).replace("<", "\\u003c"),
        "packed": "".join(_part(name, content) for name, content in packed.items()),
        "boot": _file("boot.js"),
    }
    before, *rest = _file("page.html").split("{{")
    return before + "".join(parts[name] + after for name, after in (part.split("}}", 1) for part in rest))


def script(functions: Sequence[str] = ()) -> str:
    """The page's own scripts as one, whose names nothing else sees, after the printed functions of its runs."""
    joined = "\n".join(_file(f"{name}.js") for name in SCRIPTS)
    return (
        f'(() => {{\n"use strict";\n\n{JAVASCRIPT_HEAD}\nconst PROGRAMS = [{", ".join(functions)}];\n\n{joined}}})();\n'
    )


def printed(one: Sequence[Program]) -> str:
    """A function of a run's constants that gives its printed functions by name."""
    names = ", ".join(program.name for program in one)
    return f"(CONSTANTS) => {{\n{''.join(map(javascript_function, one))}return {{ {names} }};\n}}"


def _part(name: str, content: bytes) -> str:
    """A compressed part of a page, which no browser reads by itself."""
    return f'<script type="text/plain" id="{name}">{base64.b64encode(content).decode()}</script>\n'


def _bytes(name: str) -> bytes:
    return (Path(__file__).parent / name).read_bytes()


def _file(name: str) -> str:
    return _bytes(name).decode()


def _title(one: Shown) -> str:
    """Maker and type of an arm of the catalogue, else its name."""
    name = one.env.setup.robot.name
    return ROBOTS[name].title if name in ROBOTS else name


def _scene_of(one: Shown) -> str:
    """Name of what is drawn of an arm: of the same arm with another gripper it is another one."""
    rules = one.env.setup.rules
    return f"{one.env.setup.robot.name} {rules.mounts} {rules.grips}"


def _facts(one: Shown, traced: Sequence[Program]) -> dict[str, Any]:
    """Facts that the page has to know of a policy."""
    setup = one.env.setup
    low, high = setup.robot.workspace
    box, (least, most) = setup.task.goal_box(setup), one.env.action_bounds
    begins, (engine, exact) = drawn(one.env), engine_of(one.env)
    return {
        "physics": engine,
        "exact": encoded(exact),
        "task": one.env.config.task,
        "robot": _scene_of(one),
        "title": _title(one),
        "asks": setup.task.asks(setup.rules, setup.period),
        "control_period": setup.period,
        "joints": setup.robot.joint_names,
        "objects": setup.task.scene(setup).objects,
        "actuators": setup.robot.actuators,
        "action": {"low": least.tolist(), "high": most.tolist()},
        "goal": {
            "low": box[0].tolist(),
            "high": box[1].tolist(),
            "moves": setup.rules.moves,
            "orientation": setup.rules.asks_orientation,
        },
        "rules": {name: getattr(setup.rules, name, 0) for name in RULES},
        "workspace": {"low": low, "high": high},
        "top": setup.robot.table_top,
        "knows_home_alone": knows_home_alone(one.env),
        "drawn": DRAWN,
        "begins": encoded(begins),
        "constants": encoded(constants_of(traced)),
    }


def encoded(arrays: Mapping[str, np.ndarray]) -> dict[str, dict[str, str]]:
    """Arrays by name as text, each with its type."""
    kinds = {"i": "<i4", "b": "|b1"}
    sent = {name: np.ascontiguousarray(one, kinds.get(one.dtype.kind, one.dtype)) for name, one in arrays.items()}
    return {
        name: {"type": one.dtype.str[1:], "data": base64.b64encode(one.tobytes()).decode()}
        for name, one in sent.items()
    }


def _marks() -> dict[str, Any]:
    return {
        "waiting": marks.WAITING,
        "reached": marks.REACHED,
        "path": marks.PATH,
        "trail": marks.TRAIL,
        "obstacle": marks.OBSTACLE,
        "object": marks.OBJECT,
        "axes": marks.AXES,
        "tool_axes": marks.TOOL_AXES,
        "goal_axes": marks.TARGET_AXES,
        "radius": marks.TARGET_RADIUS,
        "opacity": marks.BALL_OPACITY,
    }
