"""Faults of an arm's measurements, goals and clock, and what the controller of an exported policy makes of them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks.deploy import lively_run
from faults.saves import Trial
from reachlab.deploy.check import load_controller
from reachlab.deploy.export import export, write_files
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.learn.learner import make_initial_policy

REST = 0.25
"""Time from the first sign of a fault in which the arm has to rest [s]."""

STILL = 1e-9
"""Speed and acceleration of a command at rest [rad/s, rad/s²]."""

AFTER = 30
"""Control steps for which a fault lasts."""

Call = tuple[Any, Any, Any, float]
"""What the controller is told: joints, speeds, goal and time."""

Fault = Callable[[np.random.Generator, Call], Call]


def exported(place: Path, task: str = "precise", **settings: Any) -> Path:
    """Folder with the export of such a run."""
    run = lively_run(place / "run", task, **settings)
    return export(run, place / "policy").folder


def written(folder: Path, task: str, **settings: Any) -> Path:
    """A folder as an export writes it, of a policy that was never computed with: nothing is compiled."""
    env = Env(configure(task, **settings), 1)
    shapes = jax.eval_shape(lambda key: make_initial_policy(env.config, env, key), jax.random.key(0))
    policy = jax.tree.map(lambda one: np.full(one.shape, 0.02, one.dtype), shapes)
    folder.mkdir()
    write_files(folder, env, policy, {"run": {}, "held_out": [], "versions": {}})
    env.close()
    return folder


def broken(commands: list[np.ndarray], controller: Any) -> list[str]:
    """Which limits a sequence of commands `[n]` leaves, judged by their differences."""
    limits, period = controller.limits, controller.period
    position = np.array(commands)
    speed, acceleration, jerk = (np.diff(position, n, axis=0) / period**n for n in (1, 2, 3))
    # Differences of numbers with sixteen digits have fewer: `limits` are inside what is allowed by one in 10⁹.
    room = 1 + 2e-9 + 1e-14 / period ** np.arange(4)
    return [
        name
        for name, past in (
            ("position", (position < limits.lower) | (position > limits.upper)),
            ("speed", np.abs(speed) > room[1] * limits.speed),
            ("acceleration", np.abs(acceleration) > room[2] * limits.acceleration),
            ("jerk", np.abs(jerk) > room[3] * limits.jerk),
        )
        if past.any()
    ]


def hostile_commands(folder: Path, steps: int) -> Trial:
    """Random goals, random and hostile measurements, for so many control steps: no command leaves a limit."""
    controller, random = load_controller(folder).Controller(folder), np.random.default_rng(0)
    low, high = controller.limits.lower, controller.limits.upper
    speed, commands, wrong = controller.limits.speed, [], []
    q, qd, goal, time = controller.home, np.zeros_like(low), random.normal(size=3), 0.0
    for step in range(steps):
        kind = (step // 500) % 4
        if step % 100 == 0:
            goal = random.uniform(-1, 1, 3) if kind else random.normal(0, 3, 3)
        time += controller.period * (random.uniform(0.5, 1.5) if kind != 3 else random.uniform(-1, 8))
        told: tuple[Any, Any] = (q, qd)
        if kind == 1 and random.random() < 0.1:
            told = (random.uniform(2 * low, 2 * high), random.normal(0, 10 * speed))
        elif kind == 2 and random.random() < 0.1:
            told = (random.choice([np.nan, np.inf, 0.0, 1e300], len(q)), qd)
        elif kind == 3 and random.random() < 0.1:
            told = (None, "nonsense")
        command = controller.step(*told, goal, time)
        commands.append(command)
        qd, q = 0.5 * (command - q) / controller.period, q + 0.5 * (command - q)
        if len(commands) == 20_000:
            wrong += broken(commands, controller)
            commands = commands[-3:]
    return Trial(steps, wrong + broken(commands, controller))


def _nan(random: np.random.Generator, call: Call) -> Call:
    return (np.where(np.arange(len(call[0])) == random.integers(len(call[0])), np.nan, call[0]), *call[1:])


def _infinite(random: np.random.Generator, call: Call) -> Call:
    bad = np.where(np.arange(len(call[1])) == random.integers(len(call[1])), -np.inf, call[1])
    return (call[0], bad, *call[2:])


def _far_goal(random: np.random.Generator, call: Call) -> Call:
    goal = np.array(call[2])
    goal[:3] += random.choice([-1, 1]) * random.uniform(2, 5)
    return (call[0], call[1], goal, call[3])


FAULTS: dict[str, Fault] = {
    "nan": _nan,
    "infinite": _infinite,
    "missing": lambda _, call: (None, None, *call[2:]),
    "jumping": lambda random, call: (call[0] + random.choice([-1, 1]) * random.uniform(0.6, 1.5), *call[1:]),
    "wrong_size": lambda _, call: (call[0][:-1], *call[1:]),
    "goal_out_of_reach": _far_goal,
    "clock_runs_back": lambda _, call: (*call[:3], call[3] - 5.0),
    "frozen": lambda _, call: call,
    "late": lambda _, call: call,
}
"""Faults that last, by name. Of a frozen measurement and a late call the loop itself takes care."""


def faulty(folder: Path, name: str, times: int) -> Trial:
    """A fault, so often, in an arm on its way: it rests in `REST`, within its limits, and says why."""
    controller, random = load_controller(folder).Controller(folder), np.random.default_rng(0)
    wrong = [line for number in range(times) for line in _one_fault(controller, name, random, number)]
    return Trial(times, wrong)


def _one_fault(controller: Any, name: str, random: np.random.Generator, number: int) -> list[str]:
    limits, period = controller.limits, controller.period
    q = np.clip(controller.home + random.uniform(-0.3, 0.3, len(controller.home)), limits.lower, limits.upper)
    qd, time, low, high = np.zeros_like(q), 0.0, *controller.goal_box
    controller.reset(q)
    goal, commands, begin, told = random.uniform(low, high), [q] * 4, int(random.integers(4, 30)), False
    if controller.asks_orientation:
        goal = np.concatenate([goal, controller.home_quaternion])
    rest, frozen = None, (q, qd)
    for step in range(begin + AFTER):
        time += period
        call: Call = (q, qd, goal, time)
        if step == begin:
            frozen = (q.copy(), qd.copy())
            time += random.uniform(0.08, 0.5) if name == "late" else 0.0
        if step >= begin:
            call = FAULTS[name](random, (*(frozen if name == "frozen" else (q, qd)), goal, time))
        command = controller.step(*call)
        commands.append(command)
        # An arm whose servos lag by a tenth of a second.
        moved = q + (command - q) * min(period / 0.1, 1.0)
        q, qd = moved, (moved - q) / period
        told = told or bool(controller.problem)
        still = max(np.abs(controller.motion.speed).max(), np.abs(controller.motion.acceleration).max()) < STILL
        if step >= begin and still:
            rest = (step - begin + 1) * period
            break
    lines = [f"{number}: past the limit of {what}" for what in broken(commands, controller)]
    lines += [] if told else [f"{number}: no reason told"]
    return lines + ([] if rest is not None and rest <= REST else [f"{number}: at rest after {rest} s"])


def controllers(steps: int, times: int) -> dict[str, Trial]:
    """All of it, for a policy of `precise`."""
    with tempfile.TemporaryDirectory() as place:
        folder = exported(Path(place))
        trials = {"hostile_commands": hostile_commands(folder, steps)}
        return trials | {f"fault_{name}": faulty(folder, name, times) for name in FAULTS}
