"""Faults of trainings, made on purpose: processes that are killed, and numbers that are not finite."""

from __future__ import annotations

import hashlib
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

from faults.saves import Trial
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.jax_setup import jit
from reachlab.learn import ppo, ppo_method
from reachlab.learn.ppo_method import TrainState, compile_iteration, initial_state
from reachlab.learn.train import train
from reachlab.runs.directory import RunDirectory

KILLS_IN_A_RUN = 10
"""Kills after which a run is trained to its end."""

TINY: dict[str, Any] = {
    "num_envs": 16,
    "rollout_steps": 16,
    "total_steps": 150 * 256,
    "hidden": (8,),
    "stop_early": False,
    "report_episodes": 4,
    "max_steps": 30,
    "checkpoint_interval": 0.0,
}
"""A training that saves after every iteration."""

LONGEST_DELAY = 4.0
"""A process is killed at a random moment of this time after its start [s]: before, in and after its first steps."""

SAVES_SEEN = 12
"""A process that is to be killed inside a save has finished fewer saves than this."""

SHARE_INSIDE = 5
"""At least one in so many is killed inside a save."""

POLL = 0.0003
"""Time between two checks for a save under way [s]."""


# --- killed runs ----------------------------------------------------------------------------------


def killed_runs(count: int, seed: int = 0) -> Trial:
    """Runs killed again and again, every second time inside a save, and resumed: the weights of an unbroken one."""
    draw, wrong, inside, killed = random.Random(seed), [], 0, 0
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole"
        train(configure(**TINY), whole)
        while killed < count:
            run, here = Path(folder) / str(killed), 0
            while here < min(KILLS_IN_A_RUN, count - killed) and not RunDirectory(run).finished:
                if _kill(run, draw, inside_a_save=here % 2 == 1):
                    here += 1
                    inside += any((run / "checkpoints").glob(".step_*.tmp"))
            killed += here
            if not RunDirectory(run).finished:
                train(configure(**TINY), run, resume=run.exists())
            if _weights(run) != _weights(whole):
                wrong.append(f"run {run.name}: other weights")
    if inside < count // SHARE_INSIDE:
        wrong.append(f"only {inside} of {count} were killed inside a save")
    return Trial(count, wrong)


def _kill(run: Path, draw: random.Random, *, inside_a_save: bool) -> bool:
    """Whether a trainer of the run, started here, was killed before its end."""
    words = ["--resume", str(run)] if run.exists() else ["--out", str(run), *_flags()]
    command = [sys.executable, "-m", "reachlab", "train", *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        if inside_a_save:
            _wait_for_a_save(run, process, after=draw.randrange(1, SAVES_SEEN))
        else:
            time.sleep(draw.uniform(0, LONGEST_DELAY))
        alive = process.poll() is None
        process.kill()
    return alive


def _wait_for_a_save(run: Path, process: subprocess.Popen[bytes], after: int) -> None:
    """Wait until the process is inside a save, after so many others."""
    left = {path.name for path in (run / "checkpoints").glob(".step_*")}
    seen: set[str] = set()
    while process.poll() is None:
        names = {path.name for path in (run / "checkpoints").glob(".step_*.tmp")} - left
        seen |= names
        if names and len(seen) >= after:
            return
        time.sleep(POLL)


def _flags() -> list[str]:
    words = []
    for name, value in TINY.items():
        flag = name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{'' if value else 'no-'}{flag}")
        else:
            words += [f"--{flag}", *map(str, value if isinstance(value, tuple) else (value,))]
    return words


def _weights(run: Path) -> str:
    newest = max((run / "checkpoints").glob("step_*"))
    return hashlib.sha256((newest / "state.safetensors").read_bytes()).hexdigest()


# --- numbers that are not finite ------------------------------------------------------------------

BAD = {"NaN": np.nan, "inf": np.inf}
"""Numbers that are not finite."""


@dataclass
class Poison:
    """What is made not finite: the leaf of that number in what a function gives; -1 for none."""

    leaf: int = -1
    value: float = 0.0

    def __call__(self, tree: Any, offset: int) -> Any:
        """The tree, traced, with one number replaced when the program runs and its leaf's turn has come."""
        places = _floats(tree)
        leaf, value = jax.pure_callback(
            lambda: (np.int32(self.leaf), np.float32(self.value)), (jnp.int32(0), jnp.float32(0))
        )
        leaves = jax.tree.leaves(tree)
        for number, place in enumerate(places):
            spoilt = leaves[place].at[(-1,) * leaves[place].ndim].set(value)
            leaves[place] = jnp.where(leaf == offset + number, spoilt, leaves[place])
        return jax.tree.unflatten(jax.tree.structure(tree), leaves)


def _floats(tree: object) -> list[int]:
    leaves = enumerate(jax.tree.leaves(tree))
    return [number for number, leaf in leaves if leaf.size and jnp.issubdtype(leaf.dtype, jnp.floating)]


def not_finite() -> Trial:
    """A number made not finite, in each array of rollout, environment and learner: noticed at once, nothing changes."""
    config = configure(**{**TINY, "num_envs": 8, "rollout_steps": 4})
    env, poison, wrong, places = Env(config, 8), Poison(), [], 0
    state = jit(lambda seed: initial_state(env, config, seed))(np.uint32(0))
    with _poisoned(poison) as sizes:
        step = compile_iteration(env, config, jax.eval_shape(lambda: state))
        state, watched = step(state)
        if not watched.sound:
            wrong.append("without poison: not finite")
        for leaf in range(sum(sizes)):
            for name, poison.value in BAD.items():
                places, poison.leaf, before = places + 1, leaf, _bytes(state)
                state, watched = step(state)
                if watched.sound:
                    wrong.append(f"{name} in leaf {leaf}: not noticed")
                if _bytes(state) != before:
                    wrong.append(f"{name} in leaf {leaf}: the state has changed")
    return Trial(places, wrong)


@contextmanager
def _poisoned(poison: Poison) -> Iterator[list[int]]:
    """Let what is collected and learnt be poisoned; the list is filled with the numbers of leaves."""
    sizes: list[int] = []
    collect, update = ppo_method.collect, ppo.update

    def collect_poisoned(*arguments: Any) -> Any:
        gathered = collect(*arguments)
        sizes.append(len(_floats(gathered)))
        return poison(gathered, 0)

    def update_poisoned(*arguments: Any) -> Any:
        learnt = update(*arguments)
        sizes.append(len(_floats(learnt)))
        return poison(learnt, sizes[0])

    with mock.patch.object(ppo_method, "collect", collect_poisoned), mock.patch.object(ppo, "update", update_poisoned):
        yield sizes


def _bytes(state: TrainState) -> list[bytes]:
    plain = jax.tree.map(lambda x: jax.random.key_data(x) if jnp.issubdtype(x.dtype, jax.dtypes.prng_key) else x, state)
    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(plain)]
