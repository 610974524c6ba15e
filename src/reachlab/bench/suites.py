"""Measurements on this machine, in suites: what the README claims, by commands that stay."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from reachlab.bench.camera import camera, pixels
from reachlab.bench.precise import precise
from reachlab.bench.simulators import Row, row, simulators
from reachlab.bench.soak import soak
from reachlab.bench.trust import trust
from reachlab.envs.core import Env, EnvState
from reachlab.envs.streams import lane_keys
from reachlab.evaluation.report import FRESH_SEED
from reachlab.jax_setup import jit
from reachlab.learn.method import compile_iteration, initial_state
from reachlab.robots.chain import Chain
from reachlab.robots.kinematics import forward_kinematics, inverse_kinematics, jacobian
from reachlab.robots.loading import Robot, load_robot
from reachlab.runs.versions import versions
from reachlab.settings import names
from reachlab.settings.config import configure
from reachlab.settings.validation import choose

REPEATS = 10
"""Timed repetitions; the best counts, since other work on the machine can only slow one down."""

ENV_BATCHES = (256, 1024, 4096, 16384)
"""Batch sizes among which the best is looked for."""

ENV_STEPS = 64
"""Steps of every lane in one timed call."""

TRAIN_ITERATIONS = 40
"""Iterations of training that are timed; the median counts."""

POSES = 10_000
"""Random joint vectors of the kinematics suite."""

DIFFERENCE = 1e-6
"""Step of the central differences [rad]."""

SEEDS = range(5)
HELD_OUT = 2000
"""Seeds of the learning suite, and held-out episodes of each: seed s has the targets of seed `FRESH_SEED` + s."""

THOUSAND = 1000
"""From here on tables show numbers without decimals."""


def run_suite(name: str) -> list[Row]:
    """Rows `{name, value, unit, config}` of a suite.

    Raises:
        InputError: there is no such suite.
    """
    return list(SUITES[choose("suite", name, SUITES)]())


def to_markdown(rows: Sequence[Row]) -> str:
    """Table of measurements: what is called `a/b` stands in line `a` and column `b`; with the machine and versions."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for one in rows:
        line, _, column = one["name"].partition("/")
        cells.setdefault((line, one["unit"]), {})[column] = _cell(one)
    columns = list(dict.fromkeys(column for line in cells.values() for column in line))
    lines = [["", *columns], ["---", *["---:"] * len(columns)]]
    for (line, unit), values in cells.items():
        name = line if unit == "rate" else f"{line} [{unit}]"
        lines.append([name, *[values.get(column, "–") for column in columns]])
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    brackets = " In brackets: the lowest seed." if any("lowest_seed" in one["config"] for one in rows) else ""
    made = ", ".join(f"{name} {number}" for name, number in versions().items() if name != "machine")
    return f"{table}\n\nOn {_machine()}; {made}.{brackets}\n"


def _cell(one: Row) -> str:
    if one["unit"] != "rate":
        return f"{one['value']:.3g}" if abs(one["value"]) < THOUSAND else f"{one['value']:,.0f}"
    lowest = one["config"].get("lowest_seed")
    return f"{100 * one['value']:.2f} %" + (f" ({100 * lowest:.2f})" if lowest is not None else "")


def _best(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Shortest time of a call [s], after one that does not count."""
    jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - start)
    return min(times)


# --- speed ----------------------------------------------------------------------------------------


def speed() -> Iterator[Row]:
    """Environment and training steps a second."""
    rows = [(_env_steps_per_second(lanes), lanes) for lanes in ENV_BATCHES]
    best, lanes = max(rows)
    yield row("env_steps_per_second/kinematic", best, "1/s", num_envs=lanes, machine=_machine())
    config = configure()
    env = Env(config, config.ppo.num_envs)
    state = jit(lambda seed: initial_state(env, config, seed))(config.seed)
    step = compile_iteration(env, config, state)
    times = []
    for _ in range(TRAIN_ITERATIONS):
        start = time.perf_counter()
        state, watched = step(state)
        jax.block_until_ready(watched)
        times.append(time.perf_counter() - start)
    steps_per_second = config.ppo.iteration_steps / float(np.median(times))
    yield row("train_steps_per_second/kinematic", steps_per_second, "1/s", num_envs=config.ppo.num_envs)


def _env_steps_per_second(lanes: int) -> float:
    """Random actions in the tutorial's task with resets; sums of every output come back, so none is skipped."""
    env = Env(configure(), lanes)
    low, high = env.action_bounds

    def step(state: EnvState, key: Array) -> tuple[EnvState, Array]:
        action = jax.random.uniform(key, (lanes, len(low)), minval=low, maxval=high)
        state, transition = env.step(state, action)
        begun = env.reset(state, transition.done)
        return begun, jnp.stack([jnp.sum(x) for x in jax.tree.leaves((transition, env.observe(begun)))])

    run = jit(lambda state, key: jax.lax.scan(step, state, jax.random.split(key, ENV_STEPS)))
    state = jit(env.init)(lane_keys(0, lanes))
    return lanes * ENV_STEPS / _best(lambda: run(state, jax.random.key(0)))


# --- kinematics -----------------------------------------------------------------------------------


def kinematics() -> Iterator[Row]:
    """Accuracy of forward kinematics, Jacobian and inverse kinematics."""
    robot = load_robot("iiwa14")
    chain = robot.chain
    generator = np.random.default_rng(0)
    q64 = generator.uniform(chain.lower, chain.upper, (POSES, chain.n))
    q = jnp.asarray(q64, jnp.float32)
    position, quaternion = _mujoco_poses(robot, np.asarray(q, np.float64))
    pose = jit(lambda q: forward_kinematics(chain, q))(q)
    error = np.linalg.norm(np.asarray(pose.position) - position, axis=-1).max()
    angle = _angles(np.asarray(pose.quaternion, np.float64), quaternion).max()
    yield row("forward_kinematics_error", error, "m", poses=POSES, against="MuJoCo")
    yield row("forward_kinematics_angle_error", angle, "rad", poses=POSES, against="MuJoCo")
    yield row("jacobian_error", _jacobian_error(robot, q), "relative", poses=POSES, against="central differences")
    yield from _inverse(chain, robot, q)


def _mujoco_poses(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tool positions and quaternions of MuJoCo, in float64."""
    model = mujoco.MjModel.from_xml_path(str(robot.file))
    data, site = mujoco.MjData(model), model.site(robot.tool).id
    positions, quaternions = np.empty((len(q), 3)), np.empty((len(q), 4))
    for i, joints in enumerate(q):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        positions[i] = data.site_xpos[site]
        mujoco.mju_mat2Quat(quaternions[i], data.site_xmat[site])
    return positions, quaternions


def _angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between unit quaternions [rad]; by the arc sine, since the arc cosine is blind near zero."""
    a, b = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (a, b))
    chord = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return 4 * np.arcsin(chord / 2)


def _jacobian_error(robot: Robot, q: Array) -> float:
    """Largest error of a Jacobian's linear part against MuJoCo's positions, relative to its largest entry."""
    ours = np.asarray(jit(lambda q: jacobian(robot.chain, q))(q))[:, :3]
    centre = np.asarray(q, np.float64)
    numeric = np.empty_like(ours, dtype=np.float64)
    for joint in range(robot.chain.n):
        step = DIFFERENCE * np.eye(robot.chain.n)[joint]
        ahead, behind = _mujoco_poses(robot, centre + step)[0], _mujoco_poses(robot, centre - step)[0]
        numeric[:, :, joint] = (ahead - behind) / (2 * DIFFERENCE)
    return float((np.abs(ours - numeric).max((1, 2)) / np.abs(numeric).max((1, 2))).max())


def _inverse(chain: Chain, robot: Robot, q: Array) -> Iterator[Row]:
    pose = jit(lambda q: forward_kinematics(chain, q))(q)
    home = jnp.asarray(robot.home)
    solve = jit(lambda pose, key: inverse_kinematics(chain, pose, home, key))
    solution = solve(pose, jax.random.key(0))
    position, quaternion = _mujoco_poses(robot, np.asarray(solution.q, np.float64))
    wanted_position, wanted_quaternion = _mujoco_poses(robot, np.asarray(q, np.float64))
    near = np.linalg.norm(position - wanted_position, axis=-1) <= 1e-4
    aligned = _angles(quaternion, wanted_quaternion) <= 1e-3
    inside = (np.asarray(solution.q) >= chain.lower).all() and (np.asarray(solution.q) <= chain.upper).all()
    yield row("ik_success", (near & aligned).mean(), "rate", poses=POSES, within="0.1 mm and 1e-3 rad")
    yield row("ik_claimed", np.asarray(solution.converged).mean(), "rate", poses=POSES)
    yield row("ik_sound", float(inside and np.isfinite(np.asarray(solution.q)).all()), "1 = limits kept, no NaN")
    seconds = _best(lambda: solve(pose, jax.random.key(0)), repeats=2)
    yield row("ik_time_per_pose", seconds / POSES * 1e6, "µs", poses=POSES, num_envs=POSES)


# --- learning and start ---------------------------------------------------------------------------


def learning() -> Iterator[Row]:
    """Success on held-out targets of five seeds, in the default and in the author's setting, with wall times."""
    settings = {"default": [], "author": ["--observation", "target", "--reward", "sparse"]}
    with tempfile.TemporaryDirectory() as folder:
        for name, flags in settings.items():
            for seed in SEEDS:
                out = Path(folder) / f"{name}-{seed}"
                wall, result = _command("train", "--seed", str(seed), "--out", str(out), *flags)
                held_out = ("--episodes", str(HELD_OUT), "--seed", str(FRESH_SEED + seed))
                _, report = _command("eval", str(out), *held_out)
                config = {"seed": seed, "steps": result["steps"], "held_out": HELD_OUT}
                yield row(f"success/tutorial-{name}/kinematic", report["success_rate"], "rate", **config)
                yield row(f"time_to_100/tutorial-{name}/kinematic", wall, "s", whole_command=True, **config)


def start() -> Iterator[Row]:
    """Wall time of whole commands, with an empty and a warm compilation cache, and whether a run repeats."""
    yield row("help_wall", min(_timed(sys.executable, "-m", "reachlab", "--help") for _ in range(REPEATS)), "s")
    yield row("import_wall", min(_timed(sys.executable, "-c", "import reachlab") for _ in range(REPEATS)), "s")
    with tempfile.TemporaryDirectory() as folder:
        cache = {"JAX_COMPILATION_CACHE_DIR": str(Path(folder) / "cache")}
        weights = []
        for name in ("cold", "warm"):
            out = Path(folder) / name
            wall, result = _command("train", "--seed", "0", "--out", str(out), environment=cache)
            yield row(f"train_wall/{name}", wall, "s", steps=result["steps"], report_episodes=result["episodes"])
            weights += [file.read_bytes() for file in out.glob("checkpoints/*/state.safetensors")]
        yield row("same_weights", float(weights[0] == weights[1]), "1 = two processes, identical")


def _command(*words: str, environment: dict[str, str] | None = None) -> tuple[float, Any]:
    """Wall time of a command of ours [s] and its JSON."""
    started = time.perf_counter()
    done = subprocess.run(  # noqa: S603 (our own program)
        [sys.executable, "-m", "reachlab", *words, "--json"],
        env={**os.environ, **(environment or {})},
        capture_output=True,
        text=True,
        check=True,
    )
    return time.perf_counter() - started, json.loads(done.stdout)


def _timed(*words: str) -> float:
    started = time.perf_counter()
    subprocess.run(words, check=True, capture_output=True)  # noqa: S603 (our own program)
    return time.perf_counter() - started


def _machine() -> str:
    return f"{os.cpu_count()} cores of {_processor()}, {versions()['machine']}"


def _processor() -> str:
    """Name of the processor, or its architecture where the system does not tell."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text(encoding="utf-8").splitlines() if information.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(iter(names), platform.machine())


SUITES: dict[str, Callable[[], Iterator[Row]]] = dict(
    zip(
        names.SUITES,
        (speed, kinematics, learning, start, simulators, precise, soak, trust, camera, pixels),
        strict=True,
    )
)
"""Suites by name."""
