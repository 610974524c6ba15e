"""Suite `critic`: what a critic knows, and what is learnt without one, by the tutorial's first two observations."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

from reachlab.bench.table import Row, row
from reachlab.bench.timing import run_command
from reachlab.evaluation.report import FRESH_SEED

SEEDS, HELD_OUT = range(3), 2000

STEPS = "2000000"

OBSERVATIONS = ("target", "target+tool")

WITHOUT = ("--value-weight", "0", "--gae-lambda", "1")
"""An action is judged by the discounted sum of what was paid after it."""


def train(folder: Path) -> Iterator[tuple[str, bool, int, Path]]:
    """Runs in a folder: each observation with and without a critic, and their seeds."""
    for observation in OBSERVATIONS:
        for critic in (True, False):
            for seed in SEEDS:
                run = folder / f"{observation}-{'with' if critic else 'without'}-{seed}"
                flags = ("--observation", observation, "--reward", "sparse", "--no-stop-early", "--total-steps", STEPS)
                run_command("train", *flags, *(() if critic else WITHOUT), "--seed", str(seed), "--out", str(run))
                yield observation, critic, seed, run


def critic() -> Iterator[Row]:
    """Explained variance of the critic at the end, success, and steps of an episode."""
    with tempfile.TemporaryDirectory() as folder:
        for observation, has_critic, seed, run in train(Path(folder)):
            name = f"{observation}, {'with' if has_critic else 'without'} a critic"
            last = json.loads((run / "metrics.jsonl").read_text().splitlines()[-1])
            if has_critic:
                yield row(f"explained variance/{name}", last["explained_variance"], "share", seed=seed)
            asked = ("--episodes", str(HELD_OUT), "--seed", str(FRESH_SEED + seed))
            _, report = run_command("eval", str(run), *asked)
            yield row(f"success/{name}", report["success_rate"], "rate", seed=seed, held_out=HELD_OUT)
            yield row(f"steps/{name}", report["mean_steps"], "steps", seed=seed, held_out=HELD_OUT)
