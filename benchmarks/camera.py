"""Suite `camera`: policies that get camera pictures: their speed, and their success, also with spoilt pictures."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax import Array

from reachlab.agents.policy import Policy
from reachlab.bench.table import Row, row
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.presets import configure, distillation, in_simulator
from reachlab.envs.random_streams import env_keys
from reachlab.evaluation.report import FRESH_SEED, Report, evaluate
from reachlab.jax_setup import jit
from reachlab.learn.load import load_policy
from reachlab.learn.train import distil, train
from reachlab.runs.directory import RunDirectory
from reachlab.settings.json_form import override
from reachlab.sims.simulator import BatchArray

SEEDS, HELD_OUT = range(3), 1000
"""Seeds that are distilled; each is evaluated on so many targets of seed `FRESH_SEED` + s."""

EPISODES_FROM_NOTHING = 200
"""Episodes of the evaluation that counts to the time from nothing."""

BULLET_EPISODES, BULLET_NUM_ENVS = 300, 8
"""Episodes through PyBullet's camera, and environments side by side."""

VARIED_STEPS = 245_760
"""Steps of a distillation in random views, half as many again as in the tutorial's."""

SPOILT_EPISODES, SPOILT_STEPS = 100, 400
"""Episodes with each kind of spoilt picture, and their length: most that fail would last for the task's 1,000 steps."""

NUM_ENVS, FRAMES = 256, 20
"""Environments of an evaluation, and pictures of each that are timed."""

Spoil = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def _grain(pictures: np.ndarray, random: np.random.Generator) -> np.ndarray:
    return np.clip(pictures + random.normal(0, 25, pictures.shape), 0, 255)


def _salt(pictures: np.ndarray, random: np.random.Generator) -> np.ndarray:
    return np.where(random.random(pictures.shape) < 0.05, 255 * random.integers(0, 2, pictures.shape), pictures)


def _half_covered(pictures: np.ndarray, _: np.random.Generator) -> np.ndarray:
    return np.where(np.arange(pictures.shape[-1]) < pictures.shape[-1] // 2, 0, pictures)


SPOILT: dict[str, Spoil] = {
    "black": lambda pictures, _: np.zeros_like(pictures),
    "white": lambda pictures, _: np.full_like(pictures, 255),
    "noise": lambda pictures, random: random.integers(0, 256, pictures.shape),
    "grain": _grain,
    "salt": _salt,
    "shifted_2": lambda pictures, _: np.roll(pictures, 2, axis=-1),
    "shifted_8": lambda pictures, _: np.roll(pictures, 8, axis=-1),
    "dark": lambda pictures, _: pictures // 2,
    "inverted": lambda pictures, _: 255 - pictures,
    "half_covered": _half_covered,
}
"""Ways in which pictures `[B, SIZE, SIZE]` are spoilt: blank, noisy, shifted by pixels, badly lit, covered."""


def camera() -> Iterator[Row]:
    """The figures of docs/camera.md, but those of PPO from pixels."""
    with tempfile.TemporaryDirectory() as folder:
        runs, teachers = ([Path(folder) / f"{kind}-{seed}" for seed in SEEDS] for kind in ("student", "teacher"))
        for seed, teacher, run in zip(SEEDS, teachers, runs, strict=True):
            yield _from_nothing(seed, teacher, run)
            for sim in ("kinematic", "mujoco"):
                yield success(f"camera/success/{sim}", run, sim, HELD_OUT, NUM_ENVS, seed)
        yield from frames_per_second(runs[0])
        yield from spoilt(runs[0])
        yield success("camera/success/pybullet", runs[0], "pybullet", BULLET_EPISODES, BULLET_NUM_ENVS, 0)
        varied = Path(folder) / "varied"
        _distil(teachers[0], varied, 0, randomise=("view",), total_steps=VARIED_STEPS)
        yield success("camera/success_randomised/pybullet", varied, "pybullet", BULLET_EPISODES, BULLET_NUM_ENVS, 0)


def _distil(teacher: Path, out: Path, seed: int, **settings: Any) -> None:
    distil(distillation(str(teacher), RunDirectory(teacher).read_config(), seed=seed, **settings), out)


def _from_nothing(seed: int, teacher: Path, student: Path) -> Row:
    """Time of a teacher's training, of a distillation and of an evaluation [s]."""
    start = time.perf_counter()
    train(configure(seed=seed), teacher)
    _distil(teacher, student, seed)
    report = _evaluated(student, "kinematic", EPISODES_FROM_NOTHING, NUM_ENVS, seed)
    return row("camera/wall", time.perf_counter() - start, "s", seed=seed, success=report.success_rate)


def success(name: str, run: Path, sim: str, episodes: int, num_envs: int, seed: int) -> Row:
    """Success of a run in a simulator, on held-out targets, with its interval."""
    report = _evaluated(run, sim, episodes, num_envs, seed)
    interval = [round(share, 4) for share in report.success_interval]
    return row(name, report.success_rate, "rate", seed=seed, episodes=episodes, interval=interval)


def _evaluated(run: Path, sim: str, episodes: int, num_envs: int, seed: int) -> Report:
    env, policy = _environment(run, sim, num_envs)
    try:
        return evaluate(env, "trained", policy, seed=FRESH_SEED + seed, episodes=episodes)
    finally:
        env.close()


def _environment(run: Path, sim: str, num_envs: int, kind: type[Env] = Env, **settings: Any) -> tuple[Env, Policy]:
    directory = RunDirectory(run)
    config = override(in_simulator(directory.read_config(), sim), randomise=(), **settings)
    env = kind(config, num_envs)
    return env, load_policy(directory, env)


# --- speed ----------------------------------------------------------------------------------------


def frames_per_second(run: Path) -> Iterator[Row]:
    """Pictures a second that are drawn and given to the policy."""
    env, policy = _environment(run, "kinematic", NUM_ENVS)
    state, act = env.init(env_keys(0, NUM_ENVS)), jit(lambda policy, observation: policy.act(observation))
    jax.block_until_ready(act(policy, env.observe_now(state)))
    start = time.perf_counter()
    for _ in range(FRAMES):
        jax.block_until_ready(act(policy, env.observe_now(state)))
    rate = FRAMES * NUM_ENVS / (time.perf_counter() - start)
    env.close()
    yield row("camera/frames_per_second", rate, "1/s", num_envs=NUM_ENVS)


# --- spoilt pictures ------------------------------------------------------------------------------


@dataclass
class Lens:
    """What spoils the pictures: a function of `SPOILT`, or None."""

    spoil: Spoil | None
    random: np.random.Generator


class SpoiltEnv(Env):
    """An environment whose pictures are spoilt by its `lens`; an action that is not finite ends the measurement."""

    lens = Lens(None, np.random.default_rng(0))

    def render_observation(self, state: EnvState, mask: np.ndarray | None = None) -> np.ndarray | None:
        """See `Env.render_observation`."""
        pictures = super().render_observation(state, mask)
        if pictures is None or self.lens.spoil is None:
            return pictures
        return self.lens.spoil(pictures, self.lens.random).astype(np.uint8)

    def step(
        self, state: EnvState, action: BatchArray, times: int = 1, instead: Array | None = None
    ) -> tuple[EnvState, Transition]:
        """See `Env.step`."""
        if not np.isfinite(np.asarray(action)).all():
            raise FloatingPointError("an action is not finite")
        return super().step(state, action, times, instead)


def spoilt(run: Path) -> Iterator[Row]:
    """Success with each kind of spoilt picture, and with none."""
    env, policy = _environment(run, "kinematic", SPOILT_EPISODES, SpoiltEnv, max_steps=SPOILT_STEPS)
    assert isinstance(env, SpoiltEnv)  # noqa: S101
    for name, spoil in {"none": None, **SPOILT}.items():
        env.lens = Lens(spoil, np.random.default_rng(0))
        report = evaluate(env, "trained", policy, seed=FRESH_SEED, episodes=SPOILT_EPISODES)
        yield row(f"camera/spoilt/{name}", report.success_rate, "rate", episodes=SPOILT_EPISODES)
    env.close()
