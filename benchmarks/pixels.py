"""Suite `pixels`: PPO from pixels, without a teacher."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.camera import HELD_OUT, NUM_ENVS, SEEDS, success
from reachlab.bench.table import Row, row
from reachlab.envs.presets import configure
from reachlab.learn.train import train


def pixels() -> Iterator[Row]:
    """PPO from pixels: how long it takes [s], and what it comes to on held-out targets."""
    with tempfile.TemporaryDirectory() as folder:
        for seed in SEEDS:
            run = Path(folder) / str(seed)
            result = train(configure(observation="image", seed=seed), run)
            pictures = result.steps // configure(observation="image").loop.action_repeat
            yield row("pixels/wall", result.total_wall_s, "s", seed=seed, pictures=pictures)
            for sim in ("kinematic", "mujoco"):
                yield success(f"pixels/success/{sim}", run, sim, HELD_OUT, NUM_ENVS, seed)
