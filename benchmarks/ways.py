"""Suite `ways`: scenes in which avoiding matters: without it, with dampers, the policy, the planner, and both."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jax import Array

from reachlab.agents import AGENTS, AgentEntry
from reachlab.agents.acting import Act
from reachlab.agents.policy import Policy
from reachlab.bench.table import Row, row
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.evaluation.report import FRESH_SEED, evaluate
from reachlab.jax_setup import jit
from reachlab.learn.load import load
from reachlab.robots.loading import load_robot
from reachlab.tasks import actions
from reachlab.tasks.scenes import bank
from reachlab.tasks.scenes.kinds import KINDS

ROBOTS = tuple(os.environ.get("ROBOTS", "panda ur5e").split())
"""Arms that find ways."""

SCENES = tuple(os.environ.get("SCENES", " ".join([*KINDS, "balls"])).split())
"""Kinds of scene in which they do; `moving` is another, in which nothing plans."""

TASK = os.environ.get("TASK", "clutter")
"""What is asked for: points, or poses with `clutter_pose`."""

POLICY = os.environ.get("POLICY", "{robot}/{task}")
"""Run whose policy is tried."""

SPEED = float(os.environ.get("SPEED", "0.3"))
"""How fast the bodies of scene moving are [m/s]."""

EPISODES, FEWER = 2000, 500
"""Held-out episodes of those that plan, and of the others."""

UNDAMPED = "ik, no avoidance"
"""Name of the agent that avoids nothing."""

UNAWARE = "ik, velocities unknown"
"""Name of the agent that takes all bodies to be at rest."""

AGENTS_TRIED = tuple(os.environ.get("AGENTS", f"{UNDAMPED};ik;trained;planner;hybrid").split(";"))
"""Agents that find them; by default the policy is the one that comes with reachlab, trained among balls."""

TIMED = 200
"""Scenes that are drawn to time it."""


def undamped(env: Env) -> Act:
    """The step of an agent that moves its joints straight to the goal's, whatever is in the way."""
    setup = replace(env.setup, task=replace(env.setup.task, control=replace(env.setup.task.control, dampers=False)))

    @jit
    def decided(state: EnvState) -> tuple[Array, Array]:
        now = env.situation(state)
        action = actions.ACTIONS[setup.rules.action].towards(setup, now, now)
        return action, actions.command(setup, now, actions.bounded(setup, action))

    return _acting(env, decided)


def unaware(env: Env) -> Act:
    """The step of an agent that knows where bodies are, and not how they move."""

    @jit
    def decided(state: EnvState) -> tuple[Array, Array]:
        now = env.situation(state)
        still = replace(now.bodies, velocity=jnp.zeros_like(now.bodies.velocity))
        now = now._replace(bodies=still)
        action = actions.ACTIONS[env.setup.rules.action].towards(env.setup, now, now)
        return action, actions.command(env.setup, now, actions.bounded(env.setup, action))

    return _acting(env, decided)


def _acting(env: Env, decided: Callable[[EnvState], tuple[Array, Array]]) -> Act:
    """The step of an agent whose action and command `[B, n]` follow from the state."""

    def act(policy: Any, state: EnvState, key: Array, mask: Any = None, instead: Any = None) -> Any:
        del policy, mask
        action, command = decided(state)
        command = command if instead is None else jnp.where(jnp.isnan(instead), command, instead)
        return *env.step(state, action, instead=command), key

    return act


def ways() -> Iterator[Row]:
    """The rows of suite `ways`: measurement/robot scene agent."""
    AGENTS[UNDAMPED] = AgentEntry("ik without dampers", "benchmarks.ways:undamped", remembers=True)
    AGENTS[UNAWARE] = AgentEntry("ik that takes bodies to be at rest", "benchmarks.ways:unaware", remembers=True)
    try:
        for robot in ROBOTS:
            learnt = {"trained", "hybrid"} & set(AGENTS_TRIED)
            policy = load(POLICY.format(robot=robot, task=TASK)).policy if learnt else None
            for scene in SCENES:
                moves = scene == "moving"
                if scene != "balls" and not moves:
                    yield _drawing_time(robot, scene)
                speed = {"body_speed": SPEED} if moves else {}
                config = configure(TASK, robot=robot, scene=(scene,), randomise=(), max_steps=250, **speed)
                env = Env(config, FEWER)
                for agent in AGENTS_TRIED:
                    yield from _rows(env, f"{robot} {scene} {agent}", agent, policy)
                env.close()
    finally:
        del AGENTS[UNDAMPED], AGENTS[UNAWARE]


def _drawing_time(robot: str, scene: str) -> Row:
    arm = load_robot(robot, None, kind="flange", base=None, packages=())
    scenes = bank.drawn_scenes(arm, scene, TIMED)
    next(scenes)  # compiled
    begun = time.perf_counter()
    count = sum(1 for _ in scenes)
    return row(f"time to draw 2,000 scenes/{robot} {scene}", 2000 * (time.perf_counter() - begun) / count, "s")


def _rows(env: Env, name: str, agent: str, policy: Policy | None) -> Iterator[Row]:
    moves = env.setup.task.scene(env.setup).moved > 0
    episodes = EPISODES if moves or agent in ("planner", "hybrid") else FEWER
    report = evaluate(env, agent, policy, seed=FRESH_SEED, episodes=episodes)
    yield row(f"held without contact/{name}", report.success_rate, "rate", episodes=episodes, ends=report.ends)
    yield row(f"episodes with contact/{name}", report.contact or 0.0, "rate", episodes=episodes)
    if report.time_to_reach_s is not None:
        yield row(f"time to reach, planning counted/{name}", report.time_to_reach_s, "s")
    for quantile, seconds in (report.planning_s or {}).items():
        yield row(f"planning time, {quantile}/{name}", 1000 * (seconds or 0.0), "ms")
    if agent == "ik" and report.straight is not None:
        yield row(f"no avoiding asked for/{name}", report.straight, "rate", episodes=episodes)
