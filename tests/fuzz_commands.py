"""Random commands: none may end in a traceback, hang, or be accepted in silence where it makes no sense.

`python tests/fuzz_commands.py 500` runs 500 of them in this process, in a folder of their own. Every flag of every
command is read from its dataclass, with values that are valid, on the border and senseless. Commands are real but for:
a training stops after everything is built (one in `WHOLE` goes through, of a few steps), the viewer's server does not
wait, and no suite of `bench` is measured.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import logging
import os
import random
import shlex
import signal
import sys
import tempfile
import time
import traceback
import types
import typing
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

from reachlab.agents import AGENTS
from reachlab.cli import main as cli
from reachlab.cli.flags import evaluated
from reachlab.cli.verbs import VERBS
from reachlab.deploy.topics import Topics
from reachlab.envs.consistency import RANDOMISED
from reachlab.envs.presets import preset
from reachlab.render import CAMERAS
from reachlab.robots.catalogue import ROBOTS
from reachlab.runs.sinks import SINKS
from reachlab.scale import ENGINES
from reachlab.scale.goals import GOALS
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import Range, hints
from reachlab.sims import SIMULATORS
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.handling import SHAPES
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.paths import PATHS as GOAL_PATHS
from reachlab.tasks.rewards import REWARDS
from reachlab.tasks.targets import TARGETS
from reachlab.watch.page import server

SOUND = 0.75
"""Share of commands whose every value is allowed by itself; the others have any."""

WHOLE = 8
"""One training in so many goes through."""

LIMIT = 120
"""A command may take this long [s]: on a busy machine most of it is compilation."""

USUAL = ("train",) * 6 + ("distil",) * 2 + ("eval",) * 4 + tuple(VERBS)
"""Verbs, as often as they are tried."""

NAMES: dict[str, Sequence[str]] = {
    "task": [*TASKS, "tutoral"],
    "sim": [*SIMULATORS, "all", "mujocco"],
    "robot": ["iiwa14", "iiwa14", "arm.xml", "gone.xml", "broken.urdf", "iiwa"],
    "tool": ["link_7", "flange", "hand", "link_9"],
    "base": ["base", "link_1", "upper", "floor"],
    "package": ["parts=.", "parts=young", "parts"],
    "observation": [*OBSERVATIONS, "picture"],
    "action": [*ACTIONS, "tool-delta"],
    "reward": [*REWARDS, "spars"],
    "targets": [*TARGETS, "floor"],
    "goal_paths": [*GOAL_PATHS, "zigzag"],
    "scene": ["balls", "moving", "shelv", "gone.json", "arm.xml"],  # furniture takes minutes to draw
    "object_shape": [*SHAPES, "bx"],
    "agent": [*AGENTS, "tained"],
    "randomise": [*RANDOMISED, "colours"],
    "cameras": [*CAMERAS, "frnt"],
    "suite": ["sped", "speed"],
    "host": ["127.0.0.1"],
    "engine": [*ENGINES, "slurm"],
    "address": ["127.0.0.1:1", "auto"],
    "frame": ["base_link", ""],
    "joint_names": ["shoulder", "elbow"],
    "kind": ["task", "robot", "tsk"],
    "goal": [*GOALS, "succes_rate"],
    **{topic.name: [str(topic.default), "no topic"] for topic in dataclasses.fields(Topics)},
}
"""Values of the settings that are names."""

RUNS = ("young", "precise", "empty", "nowhere")
"""Run directories: two with a checkpoint, one that is none, and none."""

PATHS: dict[str, Sequence[str]] = {
    "out": ["a.png", "b.webp", "c.svg", "no/d.png", ".", "", "/", "..", "young", "x" * 300, "new"],
    "save": ["page.html", "no/page.html", "."],
    "live": ["page.html", "no/page.html", "."],
    "resume": [*RUNS, "."],
    "teacher": [*RUNS],
    "initial_policy": [*RUNS, "panda/precise"],
    "limits": ["gone.json", "arm.xml", "."],
    "normaliser": ["gone.pkl", "."],
    "run": [*RUNS],
    "runs": [*RUNS],
    "space": ["space.toml", "gone.toml", "arm.xml", "."],
    "config": ["young/config.json", "precise/config.json", "gone.json", "."],
}
"""Values of the flags that are paths."""

SOUND_PATHS: dict[str, Sequence[str]] = {
    "out": ["new.webp"],
    "save": ["page.html"],
    "live": ["page.html"],
    "resume": RUNS[:2],
    "space": ["space.toml"],
    "config": ["young/config.json"],
}
"""Those that can be."""

LARGEST = {
    "size": 64,
    "num_envs": 64,
    "rollout_steps": 64,
    "hidden": 64,
    "episodes": 4,
    "port": 65535,
    "action_repeat": 2000,
}
"""Larger values of these take memory or time, and are not tried."""

TINY = ["--total-steps", "64", "--report-episodes", "2", "--validation-episodes", "4", "--hidden", "8"]
SMALL = ["--num-envs", "4", "--minibatches", "2", "--rollout-steps", "8", "--epochs", "1"]
"""Flags at the end of a training that goes through; the last one of a kind counts."""

ARM = """
<mujoco><worldbody><body name="upper" pos="0 0 0.5"><joint axis="0 0 1" range="-90 90"/><geom size="0.02"/>
  <body name="hand" pos="0.4 0 0"><joint axis="0 1 0" range="-60 60"/><geom size="0.02" pos="0.3 0 0"/></body></body>
</worldbody></mujoco>"""


@dataclass(frozen=True)
class Outcome:
    """What a command came to; `problem` is what is wrong with that, if anything is."""

    words: list[str]
    status: int | None
    seconds: float
    problem: str | None


# --- commands -------------------------------------------------------------------------------------


def _evaluated() -> dict[str, Any]:
    """Annotations of the settings that evaluations may change."""
    kinds = {name: kind for task in TASKS.values() for name, kind in hints(task.load()).items()}
    return {name: kinds[name] for name in evaluated() if name != "goal_velocity"}


def flags_of(cls: type) -> dict[str, Any]:
    """Annotations of a verb's flags by name; those of the dataclasses in it stand beside them."""
    found: dict[str, Any] = {}
    for name, hint in hints(cls).items():
        if name == "goals":
            found |= _evaluated()
        elif name == "sinks":
            found |= {sink: bool for sink in SINKS if sink != "wandb"}  # which may not leave this machine
        else:
            kind = TASKS["tutorial"].load() if name == "rules" else hint
            found |= flags_of(typing.cast("type", kind)) if dataclasses.is_dataclass(kind) else {name: kind}
    return found


def values(name: str, hint: Any, chance: random.Random, *, sound: bool) -> list[str] | None:
    """Words of a value, right or (unless `sound`) wrong; None for a truth value."""
    base, limits = (hint.__origin__, hint.__metadata__) if hasattr(hint, "__metadata__") else (hint, ())
    options = [arg for arg in typing.get_args(base) if arg is not type(None)]
    if isinstance(base, types.UnionType) or typing.get_origin(base) is typing.Union:
        return values(name, options[0], chance, sound=sound) if len(options) == 1 else ["1"]
    if typing.get_origin(base) is tuple:
        many = typing.get_args(base)
        count = len(many) if many[-1] is not Ellipsis else chance.choice([1, 1, 2, 3])
        count += not sound and chance.random() < 0.3
        return [word for _ in range(count) for word in values(name, many[0], chance, sound=sound) or []]
    if base is bool:
        return None
    if base is Path:
        return [chance.choice(SOUND_PATHS.get(name, PATHS[name]) if sound else PATHS[name])]
    if base is str:
        return [chance.choice(NAMES[name][: -1 if sound and len(NAMES[name]) > 1 else None])]
    bounds = [limit for limit in limits if isinstance(limit, Range)]
    pool = ["0", "1", "-1", "2", "3", "10", "nan", "inf", "x", "", "1e30"]
    pool += ["16", "100"] if base is int else ["0.5", "0.1", "0.3", "1e-6", "-0.2", "0.01"]
    pool += [str(edge) for bound in bounds for edge in (bound.low, bound.high) if abs(edge) < 1e12]
    if sound:
        pool = [word for word in pool if _allowed(word, base, bounds)]
    chosen = chance.choice(pool)
    with contextlib.suppress(ValueError):
        if float(chosen) > LARGEST.get(name, float("inf")):
            return [str(LARGEST[name])]
    return [chosen]


def _allowed(word: str, base: Any, bounds: Sequence[Range]) -> bool:
    try:
        number = base(word)
    except ValueError:
        return False
    return abs(number) < 1e9 and all(number in bound for bound in bounds)


def command(chance: random.Random, verbs: Sequence[str]) -> list[str]:
    """A random command, of one of those verbs."""
    verb = chance.choice(verbs)
    kinds = flags_of(VERBS[verb].flags)
    words, sound = [verb], chance.random() < SOUND
    runs = RUNS[:2] if sound else RUNS
    if verb in ("eval", "record", "video", "view"):
        words += [chance.choice(runs)]
    elif verb == "plot":
        words += chance.sample(runs, chance.choice([1, 2]))
    elif verb == "robot":
        words += values("robot", str, chance, sound=sound) or []
    elif verb == "distil" and chance.random() < 0.8:
        words += [chance.choice(runs)]
    elif verb == "sweep":
        words += values("space", Path, chance, sound=sound) or []
    elif verb == "deploy":
        words += [chance.choice(("check", "ros2")), chance.choice(runs)]
    positional = {"run", "runs", "teacher", "space", "how", "policy"} | ({"robot"} if verb == "robot" else set())
    free = sorted(kinds.keys() - positional - {"open"} - ({"resume"} if chance.random() < SOUND else set()))
    for name in chance.sample(free, min(chance.choice([0, 1, 2, 3, 5, 8]), len(free))):
        flag, value = f"--{name.replace('_', '-')}", values(name, kinds[name], chance, sound=sound)
        words += [chance.choice([flag, f"--no-{flag[2:]}"])] if value is None else [flag, *value]
    if verb in ("eval", "record", "video") or (verb == "view" and "--out" in words):
        words += ["--episodes", "2"] if "--episodes" not in words else []
    return words


# --- what makes no sense --------------------------------------------------------------------------


def _needs(now: Callable[[str], Any]) -> dict[str, bool]:
    """Flags, and whether each has an effect."""
    mujoco, pybullet, stops = now("sim") == "mujoco", now("sim") == "pybullet", now("stop-early") not in (False, "no")
    table, precise = now("targets") == "table", now("reward") == "precise"
    close = precise or now("reward") == "track"
    return {
        **dict.fromkeys(("collisions", "gravity-compensation", "physics-steps"), mujoco),
        **dict.fromkeys(("gui", "slow"), pybullet),
        **dict.fromkeys(("closeness-weight", "closeness-scale", "effort-weight"), close),
        **dict.fromkeys(("target-low", "target-high"), not table),
        **dict.fromkeys(("stop-success", "stop-streak", "validation-interval"), stops),
        "target-height": table,
        "joint-scale": now("action") != "tool_delta",
        "tool-scale": now("action") == "tool_delta",
        "approach-weight": now("reward") in ("dense", "precise"),
        "hold-speed": precise,
    }


def _misplaced(now: Callable[[str], Any], low: Sequence[float], high: Sequence[float]) -> str | None:
    """Why targets make no sense: the longest arm here reaches less than 2 m."""
    if now("targets") == "table":
        far = abs(float(now("target-height") or 0.0))
    else:
        if any(a > b for a, b in zip(low, high, strict=True)):
            return "a crossed box"
        far = sum(max(a, -b, 0.0) ** 2 for a, b in zip(low, high, strict=True)) ** 0.5
    return "targets out of reach" if far > 2.0 + float(now("success-distance") or 0.1) else None


def _flags(words: Sequence[str]) -> dict[str, list[str]]:
    """Flags of a command and their values; `no` where one is denied."""
    said: dict[str, list[str]] = {}
    for word in words[1:]:
        if word.startswith("--"):
            said[word[2:].removeprefix("no-")] = ["no"] if word.startswith("--no-") else []
        elif said:
            said[list(said)[-1]].append(word)
    return said


def senseless(words: Sequence[str]) -> str | None:
    """Why a training of these flags makes no sense; written down once more, apart from what is tested."""
    said = _flags(words)
    task = said.get("task", ["tutorial"])[0]
    every = {each: flatten(to_json(preset(each))) for each in TASKS}
    usual = every[task]
    foreign = {name.replace("_", "-") for settings in every.values() for name in settings if name not in usual}
    if foreign & said.keys():
        return "a setting of another task"

    def now(name: str) -> Any:
        given = said.get(name)
        return usual[name.replace("-", "_")] if given is None else given[0] if given else True

    def changed(name: str) -> bool:
        given, before = said.get(name), usual.get(name.replace("-", "_"))
        if given is None:
            return False
        if isinstance(before, bool):
            return (given != ["no"]) != before
        if before is None or name == "goal-paths":
            return True
        numbers = [float(x) for x in given]
        return numbers != [float(x) for x in (before if isinstance(before, tuple | list) else [before])]

    only = _needs(now)
    for name, effective in only.items():
        if changed(name) and not effective:
            return f"--{name} has no effect"
    seen, real = str(now("observation")).startswith("image"), now("sim") == "mujoco"
    if vain := {"view": not seen, "lag": not real}.items() & {(one, True) for one in said.get("randomise", [])}:
        return f"{vain} of what does not vary"
    own = dict(zip(("target_low", "target_high"), ROBOTS["iiwa14"].goal_box or (), strict=True))
    low, high = ([float(x) for x in said.get(name.replace("_", "-")) or corner] for name, corner in own.items())
    return _misplaced(now, low, high)


# --- running --------------------------------------------------------------------------------------


class TooLongError(BaseException):
    """A command took longer than `LIMIT`."""


@contextlib.contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Raise `TooLongError` after that time."""

    def late(*_: object) -> None:
        raise TooLongError

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def built(*_: object, **__: object) -> None:
    """Stand for a training: everything is there."""
    raise KeyboardInterrupt


def run(words: list[str], *, whole: bool) -> Outcome:
    """Run a command in this process and judge what came of it."""
    words = [*words, *TINY, *SMALL] if whole and words[0] == "train" and "--resume" not in words else words
    out, err = io.StringIO(), io.StringIO()
    handler = logging.StreamHandler(err)
    start, status, problem = time.perf_counter(), None, None
    with contextlib.ExitStack() as stack:
        if not (whole and words[0] == "train"):
            stack.enter_context(mock.patch("reachlab.learn.train._train", built))
        stack.enter_context(mock.patch("reachlab.scale.sweep.Trials", built))
        stack.enter_context(mock.patch("reachlab.scale.cluster.Cluster._connect", built))
        stack.enter_context(mock.patch.object(server.PageServer, "serve"))
        stack.enter_context(mock.patch("reachlab.cli.verbs.run_suite", return_value=[]))
        stack.enter_context(mock.patch.object(logging.getLogger("reachlab"), "handlers", [handler]))
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(err))
        try:
            with limited(LIMIT):
                status = cli.main(words)
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
        except TooLongError:
            problem = f"took more than {LIMIT} s"
        except BaseException:
            problem = traceback.format_exc()
    problem = problem or _judged(words, status, err.getvalue())
    return Outcome(words, status, time.perf_counter() - start, problem)


def _judged(words: list[str], status: int | None, said: str) -> str | None:
    if "Traceback" in said:
        return f"a traceback: {said}"
    if status not in (cli.DONE, cli.WRONG_INPUT, cli.NOT_FINITE, cli.INTERRUPTED):
        return f"exit status {status}"
    last = (said.splitlines() or [""])[-1]
    if status == cli.WRONG_INPUT and not (last.startswith("reachlab: ") and last.endswith((".", "?"))):
        return f"no sentence: {said!r}"
    if words[0] == "train" and status != cli.WRONG_INPUT and not {"--resume", "--config", "--help"} & {*words}:
        why = senseless(words)
        if why and "reachlab: " not in said.replace("reachlab: interrupted.", ""):
            return f"accepted in silence: {why}"
    return None


@contextlib.contextmanager
def workplace() -> Iterator[None]:
    """A folder with runs and robots to try commands on."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            Path("arm.xml").write_text(ARM)
            Path("space.toml").write_text("[space]\nepochs = [2, 3]\n")
            Path("broken.urdf").write_text("<robot")
            Path("empty").mkdir()
            for name in ("young", "precise"):
                task = {"young": "tutorial"}.get(name, name)
                words = ["--out", name, "--task", task, "--max-steps", "40", *TINY, *SMALL]
                with contextlib.redirect_stderr(io.StringIO()) as said:
                    assert cli.main(["train", *words]) == cli.DONE, said.getvalue()
            yield
        finally:
            os.chdir(here)


def fuzz(count: int, seed: int, verbs: Sequence[str] = USUAL) -> list[Outcome]:
    """Outcomes of so many random commands."""
    chance = random.Random(seed)
    with workplace():
        return [run(command(chance, verbs), whole=number % WHOLE == 0) for number in range(count)]


def main() -> int:
    """Number of commands with a problem."""
    given = [int(word) for word in sys.argv[1:]]
    count, seed = (given + [500, 0][len(given) :])[:2]
    from reachlab.jax_setup import use_compilation_cache

    use_compilation_cache()
    outcomes = fuzz(count, seed)
    for outcome in outcomes:
        if outcome.problem:
            sys.stdout.write(f"reachlab {shlex.join(outcome.words)}\n  {outcome.problem}\n")
    wrong = sum(outcome.problem is not None for outcome in outcomes)
    slowest = max(outcomes, key=lambda outcome: outcome.seconds)
    summary = {
        "commands": count,
        "wrong": wrong,
        "statuses": Counter(str(outcome.status) for outcome in outcomes),
        "verbs": Counter(outcome.words[0] for outcome in outcomes),
        "slowest": [round(slowest.seconds, 1), shlex.join(slowest.words)],
    }
    sys.stdout.write(f"{json.dumps(summary)}\n")
    return min(wrong, 1)


if __name__ == "__main__":
    sys.exit(main())
