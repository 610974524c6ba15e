"""Faults put into the code by hand, one at a time: does a target of the tests catch them? See `make planted-faults`."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

SOURCE = Path(__file__).parents[1] / "src"

TIERS = {"check": "not slow and not long", "test": "not slow"}
"""Tests of `make check` and of `make test`, by their marks."""

QUICK = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"
"""How both compile."""


class Fault(NamedTuple):
    """A line of a file below `src/reachlab`, what it is made, and the files of tests that are asked first."""

    file: str
    right: str
    wrong: str
    tests: str


FAULTS = (
    # signs
    Fault("tasks/rewards.py", "OUTSIDE_REWARD = -0.1", "OUTSIDE_REWARD = 0.1", "task"),
    Fault("learn/ppo.py", "- config.entropy_weight * entropy", "+ config.entropy_weight * entropy", "ppo"),
    Fault("control/motion_limits.py", "by_speed.append(-of_speed", "by_speed.append(of_speed", "motion_limits"),
    Fault(
        "envs/delays.py", "arm.q + older * (before.past_q", "arm.q - older * (before.past_q", "motion_limits precise"
    ),
    Fault(
        "robots/shapes/clearance.py", "- radii[one] - radii[other]", "- radii[one] + radii[other]", "capsules clutter"
    ),
    Fault("agents/policy.py", "self.mean + jnp.exp(self.log_std)", "self.mean - jnp.exp(self.log_std)", "policy ppo"),
    # off by one
    Fault("tasks/judging.py", "clock >= rules.max_steps", "clock > rules.max_steps", "task env"),
    Fault(
        "sims/mujoco.py", "self._batch.step(nstep=self._substeps)", "self._batch.step(nstep=self._substeps - 1)", "sims"
    ),
    Fault("tasks/reach.py", "recent[:, 1:], latest", "recent[:, :-1], latest", "task precise"),
    Fault(
        "runs/checkpoint.py",
        "folder_of(checkpoints, step)][keep:]",
        "folder_of(checkpoints, step)][keep - 1 :]",
        "checkpoint",
    ),
    Fault("scale/trials.py", "seed=config.seed + index", "seed=config.seed + index + 1", "scale"),
    # units
    Fault("sims/kinematic.py", "(q - state.q) / self._period", "(q - state.q) * self._period", "sims env"),
    Fault("evaluation/report.py", "np.float64) * 1000", "np.float64) * 100", "evaluation"),
    Fault("envs/functions.py", "commands.speed) * self.setup.period", "commands.speed)", "precise motion_limits"),
    Fault("robots/derive/servos.py", "NATURAL_FREQUENCY**2", "NATURAL_FREQUENCY", "servos"),
    Fault("watch/captions.py", "millimetres = 1000 * distance", "millimetres = 100 * distance", "video player"),
    # keys and seeds used twice
    Fault(
        "envs/delays.py",
        "step_keys(keys, clock, streams.DELAY_STREAM)",
        "step_keys(keys, clock, streams.NOISE_STREAM)",
        "env",
    ),
    Fault("tasks/task.py", "sample_start(setup, keys.start)", "sample_start(setup, keys.goal)", "env task"),
    # logic
    Fault("learn/ppo.py", "gamma * v_tp1 * ~terminated", "gamma * v_tp1 * ~done", "ppo"),
    Fault("deploy/onboard/controller.py", "lower - ASIDE) | (q", "lower - ASIDE) & (q", "deploy"),
)


def caught(source: Path, marks: str, tests: list[str]) -> bool:
    """Whether one of the tests fails with the code below `source`."""
    root = SOURCE.parent
    kept = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    paths = os.pathsep.join(map(str, (source, root / "tests", root / "docs")))
    words = [sys.executable, "-m", "pytest", "-n", "2", "--dist", "worksteal", "--maxfail", "1", "-m", marks, *tests]
    settings = {"PYTHONPATH": paths, "NPROC": "1", "XLA_FLAGS": QUICK}
    done = subprocess.run(words, cwd=root, env=kept | settings, capture_output=True, check=False)
    return done.returncode in (1, 2)  # pytest's "tests failed", and "interrupted", at the first; 5 is "none collected"


def first_tier(fault: Fault) -> str:
    """The first tier that catches a fault, of which each has all tests of the one before; empty if none does."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "src"
        shutil.copytree(SOURCE, source)
        planted = source / "reachlab" / fault.file
        text = planted.read_text(encoding="utf-8")
        assert text.count(fault.right) == 1, f"{fault.file} has changed: {fault.right!r}"
        planted.write_text(text.replace(fault.right, fault.wrong), encoding="utf-8")
        nearest = [f"tests/test_{name}.py" for name in fault.tests.split()]
        for tier, marks in TIERS.items():
            if caught(source, marks, nearest) or caught(source, marks, []):
                return tier
    return ""


def main() -> int:
    """Exit status: the number of faults that all tiers let through."""
    count = Counter[str]()
    for number, fault in enumerate(FAULTS, 1):
        tier = first_tier(fault)
        count[tier] += 1
        print(f"{number:2d} {f'make {tier}' if tier else 'MISSED':10s} {fault.file}: {fault.wrong}", flush=True)  # noqa: T201
    print(f"make check catches {count['check']} of {len(FAULTS)}, make test {len(FAULTS) - count['']}")  # noqa: T201
    return count[""]


if __name__ == "__main__":
    sys.exit(main())
