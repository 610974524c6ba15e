"""Suite `memory`: policies that remember beside those that observe one step or four, in arms that vary."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import patch

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.agents import policy
from reachlab.bench.table import Row, row
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.evaluation.episodes import BATCH
from reachlab.evaluation.report import FRESH_SEED, examine
from reachlab.learn.train import train
from reachlab.settings.json_form import override

HELD_OUT, REMEMBERED, OBSERVED = 2000, 64, 4
"""Held-out targets of each seed, numbers that a policy remembers, and observations that another is given at once."""

VARIED = {
    "precise": ("dynamics", "delay"),
    "track": ("dynamics", "delay"),
    "push": ("objects", "sight", "dynamics", "delay"),
    "slide": ("objects", "sight"),
}
"""What varies from episode to episode, by task."""

KINDS = ("memory", "stack", "neither")

TRIED, OF, SEEDS = (
    os.environ.get(name, default).split()
    for name, default in {"TASKS": " ".join(VARIED), "KINDS": " ".join(KINDS), "SEEDS": "0 1 2 3 4"}.items()
)
"""Tasks, kinds of policies and seeds that are asked for, so that several processes can share them."""

STEPS = os.environ.get("STEPS")
"""Steps of each training, where they are others than the preset's."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Stack:
    """The last observations of `k` numbers each, in the place of a memory: the latest first, `size` numbers."""

    size: int = field(metadata={"static": True})

    @classmethod
    def make(cls, key: Array, inputs: int, size: int) -> Stack:
        """A stack of observations of `inputs` numbers, of so many numbers in all."""
        del key, inputs
        return cls(size)

    def __call__(self, memory: Array, x: Array) -> Array:
        """The stack `[..., size]` after an observation `[..., k]`."""
        return jnp.concatenate([x, memory[..., : -x.shape[-1]]], axis=-1)

    def over(self, memory: Array, x: Array, begins: Array) -> Array:
        """The same after each of the observations `[T, B, k]`, empty where episodes begin, `begins [T, B]`."""

        def step(memory: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
            x, begins = now
            memory = self(jnp.where(begins[:, None], 0.0, memory), x)
            return memory, memory

        return jax.lax.scan(step, memory, (x, begins))[1]


def memory() -> Iterator[Row]:
    """Success, errors and times of each task, kind and seed, and how long its training took."""
    for task in TRIED:
        for kind in OF:
            for seed in SEEDS:
                yield from _trained(task, kind, int(seed))


def _trained(task: str, kind: str, seed: int) -> Iterator[Row]:
    config = configure(task, robot="panda", randomise=VARIED[task], seed=seed, report_episodes=1)
    if STEPS:
        config = override(config, total_steps=int(STEPS))
    given: AbstractContextManager[object] = nullcontext()
    if kind == "memory":
        config = override(config, memory=REMEMBERED)
    if kind == "stack":
        env = Env(config, 1)
        config = override(config, memory=OBSERVED * env.schema.vector_size)
        env.close()
        given = patch.object(policy, "Cell", Stack)
    with given, tempfile.TemporaryDirectory() as folder:
        trained = train(config, Path(folder) / "run")
        env = Env(config, BATCH)
        report, _ = examine(env, "trained", trained.policy, seed=FRESH_SEED + seed, episodes=HELD_OUT)
        env.close()
    name = f"{task}, {kind}, seed {seed}"
    yield row(f"success/{name}", report.success_rate, "rate", interval=report.success_interval, held_out=HELD_OUT)
    for distance, share in (report.success_within or {}).items():
        yield row(f"within {distance} mm/{name}", share, "rate")
    if report.final_error_mm["p99"] is not None:
        yield row(f"error, p99/{name}", report.final_error_mm["p99"], "mm")
    if report.tracking:
        yield row(f"root mean square/{name}", report.tracking["rms_mm"], "mm")
    if report.time_to_reach_s is not None:
        yield row(f"time to reach/{name}", report.time_to_reach_s, "s")
    yield row(f"training/{name}", trained.train_wall_s, "s", steps=trained.steps, speed=trained.steps_per_second)
