"""Inputs edited by hand: exported folders, runs, robot files, seeds, signals; none is silent, a traceback, or deaf."""

from __future__ import annotations

import copy
import json
import math
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
import types
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import reachlab
from faults.controllers import broken, written
from faults.robot_trial import try_out
from faults.saves import Trial, make_run, problem_of
from reachlab.deploy.check import load_controller
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.evaluation.report import evaluate
from reachlab.runs.directory import RunDirectory
from reachlab.settings.validation import LAST_SEED, InputError

VALUES = (None, "", "x", True, -1, 0, 7, 1e308, math.nan, math.inf, [], {}, 10**30, [1.0] * 7, "../../etc/passwd")
"""What stands in place of an entry."""

GONE = object()
"""In place of an entry: nothing."""

NUMBERS = ("nan", "inf", "-inf", "1e308", "-1", "0", "", "x", "1e-300", "9" * 400, "1 2 3 4")
"""What stands in place of an attribute's numbers."""

SEEDS = (-1, 2**32, 2**64, 1.5, "5", None, True, [1], np.float32(2), np.nan, 10**30, b"1", {}, np.array([1, 2]))
"""Seeds that are none."""

SOONEST, LATEST, ENDED = 0.3, 9.0, 5.0
"""When a signal comes, and how soon the command has to have ended [s]."""

URDF = """<robot name="arm"><link name="base"/>{links}</robot>"""
LINK = """<link name="l{i}"><inertial><origin xyz="0 0 0.1"/><mass value="1.5"/>
<inertia ixx="0.01" iyy="0.01" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><cylinder radius="0.03" length="0.2"/></geometry></collision></link>
<joint name="j{i}" type="revolute"><parent link="{parent}"/><child link="l{i}"/><origin xyz="0 0 0.2" rpy="0 0 0"/>
<axis xyz="{axis}"/><limit lower="-2" upper="2" effort="40" velocity="2"/>
<dynamics damping="0.5" friction="0.1"/></joint>"""
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
ARM = URDF.format(
    links="".join(LINK.format(i=i, parent=f"l{i - 1}" if i else "base", axis=axis) for i, axis in enumerate(AXES))
)
"""A sound robot file: six joints of cylinders."""


def _leaves(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of the entries of a JSON file that hold no others."""
    parts = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    below = [leaf for key, value in parts for leaf in _leaves(value, (*path, key))]
    yield from below or [path]


def _edited(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    """A copy with another value in one entry."""
    data = copy.deepcopy(data)
    place = data
    for key in path[:-1]:
        place = place[key]
    if value is GONE:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return data


def _refusal(what: Callable[[], object], *refused: type[Exception]) -> str | None:
    """What is wrong with how it is refused; empty if it is in a sentence, and None if it is not refused."""
    try:
        what()
    except refused as error:
        return "" if "\n" not in str(error) and str(error).endswith(".") else f"no sentence: {error}"
    except Exception as error:  # whatever else comes out is the problem
        return f"{type(error).__name__}: {error}"
    return None


def edited_exports(count: int, seed: int = 0) -> Trial:
    """An entry of `policy.json` is another: refused, or the arm keeps the limits that it was exported with."""
    draw, wrong = random.Random(seed), []
    with tempfile.TemporaryDirectory() as place:
        folder = written(Path(place) / "policy", "precise")
        file = folder / "policy.json"
        sound = json.loads(file.read_text())
        leaves, usual = list(_leaves(sound)), load_controller(folder).Controller(folder).limits
        for _ in range(count):
            path, value = draw.choice(leaves), draw.choice((*VALUES, GONE))
            file.write_text(json.dumps(_edited(sound, path, value)))
            problem = _refusal(lambda: load_controller(folder).Controller(folder), ValueError, OSError)
            if problem is None:
                controller = load_controller(folder).Controller(folder)
                q = np.array(sound["arm"]["home"]) if "arm" in sound and "home" in sound["arm"] else np.zeros(7)
                controller.reset(q)
                commands = [controller.step(q, np.zeros(7), [0.5, 0.0, 0.4], n * controller.period) for n in range(20)]
                held = types.SimpleNamespace(limits=usual, period=sound["control_period"])
                problem = ", ".join(broken([np.array(one) for one in commands], held))
            if problem:
                wrong.append(f"{'.'.join(map(str, path))} = {value!r:.40}: {problem}")
    return Trial(count, wrong)


def edited_runs(count: int, seed: int = 0) -> Trial:
    """An entry of a run's configuration or manifest is another: refused in a sentence, or the state before is read."""
    draw, wrong = random.Random(seed), []
    for _ in range(count):
        with tempfile.TemporaryDirectory() as place:
            run = make_run(Path(place) / "run")
            good = run.read_config()
            file = draw.choice([*run.path.rglob("*.json")])
            data = json.loads(file.read_text())
            path, value = draw.choice(list(_leaves(data))), draw.choice((*VALUES, GONE))
            if file.name == "config.json" and _same(data, path, value):
                continue
            file.write_text(json.dumps(_edited(data, path, value)))
            if problem := problem_of(run.path, good):
                wrong.append(f"{file.name} {'.'.join(map(str, path))} = {value!r:.40}: {problem}")
    return Trial(count, wrong)


def _same(data: Any, path: tuple[Any, ...], value: Any) -> bool:
    for key in path:
        data = data[key]
    return bool(data == value)


def edited_robots(count: int, seed: int = 0) -> Trial:
    """An attribute of a URDF holds other numbers: refused or noted where they make no sense, and read soon."""
    draw, wrong = random.Random(seed), []
    places = list(re.finditer(r'(\w+)="([-\d. ]+)"', ARM))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.urdf"
        for _ in range(count):
            place, value = draw.choice(places), draw.choice(NUMBERS)
            file.write_text(f"{ARM[: place.start(2)]}{value}{ARM[place.end(2) :]}")
            begun, said = time.perf_counter(), ""
            problem = _refusal(lambda: try_out(file), InputError)
            if problem is None:
                said = try_out(file)
            absurd = value in ("nan", "inf", "-inf", "1e308", "", "x", "9" * 400)
            if not problem and said.startswith("read: ") and absurd and len(said) <= len("read: "):
                problem = "silent"
            if not problem and time.perf_counter() - begun > ENDED:
                problem = "slow"
            if problem:
                wrong.append(f'{place[1]}="{value:.20}": {problem}')
    return Trial(count, wrong)


def wrong_seeds() -> Trial:
    """Seeds that are none, of an evaluation, a configuration, an environment and a batch of them."""
    env, single = Env(configure(max_steps=5), 2), reachlab.ReachEnv(max_steps=5)
    batch = gymnasium.make_vec("reachlab:reachlab/KukaReach-v0", num_envs=2)
    asked: dict[str, tuple[Callable[[Any], object], Sequence[Any]]] = {
        "evaluate": (lambda one: evaluate(env, "zero", seed=one, episodes=2), SEEDS),
        "configure": (lambda one: configure(seed=one), SEEDS),
        # None is Gymnasium's word for "draw one"; a batch takes a list of seeds.
        "reset": (lambda one: single.reset(seed=one), [one for one in SEEDS if one is not None]),
        "batch": (lambda one: batch.reset(seed=one), [one for one in SEEDS[:-1] if one is not None]),
    }
    wrong = []
    for name, (call, seeds) in asked.items():
        for one in seeds:
            problem = _refusal(lambda call=call, one=one: call(one), InputError, gymnasium.error.Error)
            if problem is None:
                problem = "accepted" if not (isinstance(one, int) and 0 <= one <= LAST_SEED) else ""
            if problem:
                wrong.append(f"{name} {one!r:.30}: {problem}")
    return Trial(sum(len(seeds) for _, seeds in asked.values()), wrong)


COMMANDS = (
    ("train", "--no-stop-early", "--out"),
    ("train", "--task", "precise", "--out"),
    ("eval", "--task", "pose", "--agent", "ik", "--episodes", "100000"),
    ("sweep", "space.toml", "--total-steps", "200000", "--trials", "3", "--out"),
)


def signals(count: int, seed: int = 0) -> Trial:
    """A command gets a signal at a random time: it ends soon, without a traceback, and what was saved can be read."""
    draw, wrong = random.Random(seed), []
    for number in range(count):
        with tempfile.TemporaryDirectory() as place:
            (Path(place) / "space.toml").write_text("[space]\nepochs = { low = 2, high = 4 }\n")
            words = [*COMMANDS[number % len(COMMANDS)]]
            words += ["made"] if words[-1] == "--out" else []
            asking = draw.choice([signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
            after = draw.uniform(SOONEST, LATEST)
            problem = _signalled(Path(place), words, asking, after)
        if problem:
            wrong.append(f"{' '.join(words[:3])}, {asking.name} after {after:.1f} s: {problem}")
    return Trial(count, wrong)


def _signalled(place: Path, words: list[str], asking: signal.Signals, after: float) -> str | None:
    command = [sys.executable, "-m", "reachlab", *words]
    with subprocess.Popen(command, cwd=place, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        time.sleep(after)
        process.send_signal(asking)
        try:
            out, _ = process.communicate(timeout=ENDED)
        except subprocess.TimeoutExpired:
            process.kill()
            return "deaf"
    # Python itself tells of an interrupt that comes before the first line of reachlab has run.
    if "Traceback" in out and "reachlab/cli" in out:
        return out[-300:]
    run = RunDirectory(place / "made")
    if words[0] == "train" and run.path.exists() and any((run.path / "checkpoints").glob("step_*")):
        return _refusal(run.read_config, InputError)
    return None


TRIALS: dict[str, Callable[[], Trial]] = {
    "edited_exports": lambda: edited_exports(90),
    "edited_runs": lambda: edited_runs(60),
    "edited_robots": lambda: edited_robots(80),
    "wrong_seeds": wrong_seeds,
    "signals": lambda: signals(24),
}
"""Three hundred and a few inputs."""
