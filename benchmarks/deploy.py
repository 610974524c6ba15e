"""Suite `deploy`: what exports compute on every arm, and how long a control step takes."""

from __future__ import annotations

import json
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from reachlab.bench.table import Row, row
from reachlab.deploy.c_library import CPolicy, compiler
from reachlab.deploy.check import load_controller
from reachlab.deploy.export import TOLERANCES, compare, export
from reachlab.deploy.onnx_network import OnnxNetwork
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.setup import in_evaluation
from reachlab.learn.learner import Learner
from reachlab.learn.load import load_policy
from reachlab.learn.ppo_method import initial_state
from reachlab.robots.catalogue import ROBOTS
from reachlab.runs.directory import RunDirectory

SITUATIONS, TOGETHER = 10_000, 100
"""Held-out situations in which an export is compared with its policy, and episodes they are taken from."""

STEPS = 100_000
"""Control steps that are timed."""

CASES: dict[str, dict[str, Any]] = {
    "tutorial": {"task": "tutorial"},
    "tutorial_target": {"task": "tutorial", "observation": "target"},
    "precise": {"task": "precise"},
    "precise_goal": {"task": "precise", "observation": "goal+state"},
    "precise_delta": {"task": "precise", "action": "joint_delta"},
    "memory": {"task": "precise", "memory": 64},
    "pose": {"task": "pose"},
    "track": {"task": "track"},
    "clutter": {"task": "clutter"},
}
"""Tasks and observations that are exported for every arm."""

UNITS = {what: unit for what, (_, unit) in TOLERANCES.items()}
"""Units of differences, by what computed something."""

LOUDER = 60
"""The last layer of a policy that has learnt nothing is so many times as large, so that it uses its whole box."""


def deploy() -> Iterator[Row]:
    """Differences of exports from their policies on every arm, and times of a control step on one core."""
    with tempfile.TemporaryDirectory() as place:
        for name, settings in CASES.items():
            worst = defaultdict[str, float](float)
            for robot in ROBOTS:
                folder = Path(place) / name / robot
                found = _differences(lively_run(folder / "run", **settings, robot=robot), folder / "policy")
                worst |= {what: max(value, worst[what]) for what, value in found.items()}
            for what, value in worst.items():
                yield row(f"difference_{name}/{what}", value, UNITS[what], arms=len(ROBOTS), situations=SITUATIONS)
        picture = lively_run(Path(place) / "image" / "run", "tutorial", observation="image+tool")
        for what, value in _differences(picture, Path(place) / "image" / "policy", 1000).items():
            yield row(f"difference_image/{what}", value, UNITS[what], arms=1, situations=1000)
        for name in ("tutorial", "precise", "memory", "pose", "track", "clutter"):
            yield from _times(name, Path(place) / name / "iiwa14" / "policy")


def lively_run(path: Path, task: str, **settings: Any) -> RunDirectory:
    """A run whose policy has learnt nothing, and commands large actions all the same."""
    config = configure(task, num_envs=8, **settings)
    env, run = Env(config, 8), RunDirectory(path)
    run.create(config)
    state = env.compile_whole(lambda seed: initial_state(env, config, seed))(np.uint32(0))
    learner: Learner = state.learner
    policy, random = learner.policy, np.random.default_rng(0)
    actor, size = policy.parameters.actor, policy.normaliser.mean.shape
    mean, variance = 0.1 * random.normal(size=size), random.uniform(0.3, 2.0, size=size)
    lively = replace(
        policy,
        parameters=replace(policy.parameters, actor=[*actor[:-1], (LOUDER * actor[-1][0], actor[-1][1] + 0.05)]),
        normaliser=replace(
            policy.normaliser, mean=jnp.asarray(mean, jnp.float32), variance=jnp.asarray(variance, jnp.float32)
        ),
    )
    run.write_checkpoint(0, replace(state, learner=replace(learner, policy=lively)))
    env.close()
    return run


def _differences(run: RunDirectory, folder: Path, situations: int = SITUATIONS) -> dict[str, float]:
    export(run, folder, "trained")
    config = run.read_config()
    env = Env(in_evaluation(config, config.sim), TOGETHER)
    try:
        return compare(folder, env, load_policy(run, env), situations)
    finally:
        env.close()


def _times(name: str, folder: Path) -> Iterator[Row]:
    """Times of a control step of an arm that follows at once and is given another goal every hundred steps."""
    controller, random = load_controller(folder).Controller(folder), np.random.default_rng(0)
    q, qd, period, goal = controller.home, 0 * controller.home, controller.period, controller.goal_box[0]
    around = [{"position": [0.4, 0.1 * i - 0.15, 0.3], "radius": 0.05} for i in range(4)] if name == "clutter" else None
    took = np.empty(STEPS)
    for step in range(STEPS):
        if step % 100 == 0:
            goal = random.uniform(*controller.goal_box)
            if controller.asks_orientation:
                goal = np.concatenate([goal, controller.home_quaternion])
        start = time.perf_counter()
        command = controller.step(q, qd, goal, step * period, obstacles=around)
        took[step] = time.perf_counter() - start
        q, qd = command, (command - q) / period
    micro = 1e6 * took
    yield row(f"control_step/{name}", float(np.median(micro)), "µs", quantile="median", written="step.py")
    yield row(f"control_step_p999/{name}", float(np.quantile(micro, 0.999)), "µs", steps=STEPS)
    yield row(f"control_step_worst/{name}", float(micro.max() / 1000), "ms", steps=STEPS)
    if compiler():
        yield row(
            f"control_step_c/{name}", _time_in_c(folder, controller), "µs", written="reachlab_policy.c", flags="-O2"
        )
    network = OnnxNetwork(folder)
    seen = np.zeros((1, network.inputs), np.float32)
    took = np.empty(STEPS // 10)
    for i in range(len(took)):
        start = time.perf_counter()
        network.act(seen)
        took[i] = time.perf_counter() - start
    yield row(f"network_alone/{name}", float(1e6 * np.median(took)), "µs", quantile="median", runtime="ONNX Runtime")


def _time_in_c(folder: Path, controller: Any) -> float:
    """Time of a control step of the C sources [µs], with what Python takes to call it left out: a tenth of a µs."""
    facts = json.loads((folder / "policy.json").read_text())
    with tempfile.TemporaryDirectory() as build:
        c = CPolicy(folder, facts["inputs"], len(controller.joints), Path(build), "-O2")
        c.set(c.state, position=controller.home, stop_step=[controller.limits.steps] * len(controller.joints))
        c.set(c.input, q=controller.home, goal_position=controller.goal_box.mean(axis=0))
        took = []
        for _ in range(20):
            start = time.perf_counter()
            for _ in range(500):
                c.call()
            took.append((time.perf_counter() - start) / 500)
    return 1e6 * float(np.median(took))
