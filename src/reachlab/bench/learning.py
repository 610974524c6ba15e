"""Suite `learning`: what whole trainings come to, and how long they take."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from reachlab.bench.table import Row, row
from reachlab.bench.timing import run_command
from reachlab.evaluation.report import FRESH_SEED

SEEDS = range(5)
HELD_OUT = 2000
"""Seeds of the learning suite, and held-out episodes of each: seed s has the targets of seed `FRESH_SEED` + s."""


def learning() -> Iterator[Row]:
    """Success on held-out targets of five seeds, in the default and in the author's setting, with wall times."""
    settings = {"default": [], "author": ["--observation", "target", "--reward", "sparse"]}
    with tempfile.TemporaryDirectory() as folder:
        for name, flags in settings.items():
            for seed in SEEDS:
                out = Path(folder) / f"{name}-{seed}"
                wall, result = run_command("train", "--seed", str(seed), "--out", str(out), *flags)
                held_out = ("--episodes", str(HELD_OUT), "--seed", str(FRESH_SEED + seed))
                _, report = run_command("eval", str(out), *held_out)
                config = {"seed": seed, "steps": result["steps"], "held_out": HELD_OUT}
                yield row(f"success/tutorial-{name}/kinematic", report["success_rate"], "rate", **config)
                yield row(f"time_to_100/tutorial-{name}/kinematic", wall, "s", whole_command=True, **config)
