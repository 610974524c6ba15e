"""The C sources of an export among hostile inputs: they decide as Python does, and no command leaves a limit."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from faults.controllers import broken, exported
from faults.saves import Trial
from reachlab.control.motion_limits import MotionLimits
from reachlab.deploy.c_library import FLAGS, OWN, QUICKLY, CPolicy, compiler
from reachlab.deploy.onboard.aiming import NEARBY
from reachlab.deploy.onboard.controller import Controller

SANITIZED = [flag for flag in FLAGS if flag not in ("-shared", "-fPIC")] + [
    QUICKLY,
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
]
"""Flags under which the first step out of memory or out of the language's rules ends a program."""

PROGRAM = Path(__file__).parent / "hostile_inputs.c"

ODD = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 0.0, -0.0, 1e-300)

SAME = 1e-9
"""Largest difference of a command in C from that in Python [rad or m]."""


def same_decisions(folder: Path, steps: int) -> Trial:
    """So many steps, some of them hostile: C refuses what Python refuses, commands the same, and keeps the limits."""
    controller, random = Controller(folder), np.random.default_rng(2)
    inputs = json.loads((folder / "policy.json").read_text())["inputs"]
    limits: MotionLimits = controller.limits
    motion, action, wrong = limits.at_rest(controller.home), [0.0] * inputs["last_action"][0], []
    commands, (low, high) = [motion.position], controller.goal_box + np.array([[-NEARBY], [NEARBY]])
    with tempfile.TemporaryDirectory() as build:
        c = CPolicy(folder, inputs, limits.n, Path(build))
        c.set(c.state, **motion._asdict())
        for step in range(steps):
            given = {
                name: (random.integers(0, 4, shape) if name == "bodies_kind" else _numbers(random, shape))
                .ravel()
                .tolist()
                for name, shape in inputs.items()
                if name not in OWN
            }
            if random.random() < 0.8:  # else it is hardly ever in the workspace
                given["goal_position"] = random.uniform(low, high).tolist()
            brake, goal = bool(random.random() < 0.02), np.array(given["goal_position"])
            wanted, problem = motion.position, not all(np.isfinite(one).all() for one in given.values())
            problem |= not brake and bool(((goal < low) | (goal > high)).any())
            if not (problem or brake):
                with np.errstate(all="ignore"):
                    decided, aimed = controller._decide(**given, command=motion.position.tolist(), last_action=action)
                problem = not np.isfinite([*decided, *aimed]).all()
                if not problem:
                    action, wanted = decided, np.array(aimed)
            motion = limits.advance(motion, wanted, brake or problem)
            c.set(c.input, **given)
            command, told = c.step(brake=brake)
            if bool(told) != problem:
                wrong.append(f"step {step}: C says {told}, Python {problem}")
            if not (difference := np.abs(command - motion.position).max()) <= SAME:
                wrong.append(f"step {step}: commands differ by {difference:.1e}")
            c.set(c.state, **motion._asdict(), last_action=action)  # last bits do not add up
            commands.append(motion.position)
    return Trial(steps, wrong + broken(commands, controller))


def _numbers(random: np.random.Generator, shape: list[int]) -> np.ndarray:
    """Numbers of which, in some inputs, some are odd."""
    numbers = random.uniform(-3, 3, shape)
    odd = random.random(shape) < random.choice([0.0, 0.0, 0.05])
    return np.where(odd, random.choice(ODD, shape), numbers)


def hostile_inputs(folder: Path, steps: int) -> Trial:
    """So many steps of hostile bytes under the sanitizers of the compiler."""
    controller = Controller(folder)
    limits = controller.limits
    with tempfile.TemporaryDirectory() as place:
        build = Path(place)
        for file in (PROGRAM, folder / "reachlab_policy.c", folder / "reachlab_policy.h"):
            shutil.copyfile(file, build / file.name)
        names = ("lower", "upper", "speed", "acceleration", "jerk")
        arrays = {name.upper(): getattr(limits, name) for name in names} | {"GOAL": controller.goal_box.ravel()}
        rows = {name: ", ".join(f"{float(one)!r}" for one in array) for name, array in arrays.items()}
        lines = [f"static const double {name}[] = {{ {row} }};\n" for name, row in rows.items()]
        (build / "limits.h").write_text("".join(lines), encoding="ascii")
        program = build / "hostile_inputs"
        sources = [str(build / name) for name in (PROGRAM.name, "reachlab_policy.c")]
        words = [str(compiler()), *SANITIZED, "-o", str(program), *sources, "-lm"]
        subprocess.run(words, check=True, capture_output=True)
        done = subprocess.run([str(program), str(steps)], check=False, capture_output=True, text=True)
    if done.returncode or done.stderr:
        return Trial(steps, [done.stderr[:500] or f"status {done.returncode}"])
    left, refused = (int(word) for word in done.stdout.split())
    wrong = [f"{left} commands left a limit"] if left else []
    return Trial(steps, wrong if 0 < refused < steps else [*wrong, f"{refused} of {steps} inputs were refused"])


def c_sources(task: str, decisions: int, steps: int) -> Trial:
    """Both of it, for the export of a policy of a task."""
    with tempfile.TemporaryDirectory() as place:
        folder = exported(Path(place), task)
        trials = same_decisions(folder, decisions), hostile_inputs(folder, steps)
    return Trial(decisions + steps, [line for trial in trials for line in trial.wrong])
