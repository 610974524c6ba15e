"""Suite `handled`: objects that are pushed, lifted, placed and slid, and how well they are held."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import jax
import numpy as np

from reachlab.agents.acting import make_act
from reachlab.bench.table import Row, row
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.evaluation.report import examine
from reachlab.learn.load import load_policy
from reachlab.robots.catalogue import ROBOTS
from reachlab.runs.shipped import shipped
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override

HANDLED = ("push", "lift", "place", "slide")

EPISODES, SEED, BATCH = 2000, 6000, 250

VARIED = {"": (), ", varied": ("objects",), ", varied and seen late": ("objects", "sight")}
"""What varies, by what is said of it."""

NEAR = 0.01
"""What success within a centimetre is, where it is within two by the task's rules [m]."""

HELD = 256
"""Cubes that are held."""


def handled() -> Iterator[Row]:
    """The rows of suite `handled`: what was counted/task, robot, agent and what varies."""
    for task in HANDLED:
        for robot in ROBOTS:
            for name, varied in VARIED.items():
                config = configure(task, robot=robot, randomise=varied)
                yield from _judged(config, f"{task}, {robot}{name}")
    yield from _physics()


def _judged(config: RunConfig, name: str) -> Iterator[Row]:
    env, run = Env(config, BATCH), shipped().get(f"{config.robot}/{config.task}")
    policies = {"script": ("ik", None)} | ({"policy": ("trained", load_policy(run, env))} if run else {})
    for column, (agent, policy) in policies.items():
        report, _ = examine(env, agent, policy, seed=SEED, episodes=EPISODES, checkpoint=None)
        yield row(f"success/{name}, {column}", report.success_rate, "rate", interval=report.success_interval)
        yield row(f"time to reach/{name}, {column}", report.to_json()["time_to_reach_s"] or np.nan, "s")
    env.close()
    if config.task in ("push", "lift"):
        close = Env(override(config, success_distance=NEAR), BATCH)
        for column, (agent, policy) in policies.items():
            report, _ = examine(close, agent, policy, seed=SEED, episodes=EPISODES, checkpoint=None)
            yield row(f"within 10 mm/{name}, {column}", report.success_rate, "rate")
        close.close()


def _physics() -> Iterator[Row]:
    """How a cube is held for three seconds, and what steps of 1 ms change."""
    for steps, varied in itertools.product((4, 5, 10, 20), ((), ("objects",))):
        config = configure("lift", robot="panda", physics_steps=steps, max_steps=300, randomise=varied)
        env = Env(config, HELD)
        state, key = env.init(episode_keys(SEED, REPORT_STREAM, 0, HELD)), jax.random.key(0)
        act, ways, deepest = make_act(env, "ik"), [], np.zeros(HELD)
        for step in range(300):
            state, _, key = act(None, state, key)
            if step >= 149:
                bodies, arm = state.arm.bodies, state.arm
                ways.append(np.asarray(bodies.position)[:, -1] - np.asarray(arm.tool_position))
                deepest = np.maximum(deepest, np.asarray(bodies.size)[:, -1, 1] - np.asarray(arm.opening)[:, 0] / 2)
        success = np.asarray(state.errors.distance) < config.rules.success_distance
        column = f"steps of {1000 * config.physics.control_period / steps:.3g} ms{', varied' * bool(varied)}"
        creep = np.linalg.norm(ways[-1] - ways[0], axis=1)[success]
        yield row(f"held/{column}", success.mean(), "rate")
        yield row(f"creep in 3 s, median/{column}", 1000 * float(np.median(creep)), "mm")
        yield row(f"creep in 3 s, most/{column}", 1000 * float(creep.max()), "mm")
        yield row(f"penetration, most/{column}", 1000 * float(deepest[success].max()), "mm")
        env.close()
