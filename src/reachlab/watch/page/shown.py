"""What a page shows of a run: policy, arm and task as functions of the page, or else why Python computes them."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jax
import numpy as np

from reachlab.agents import AGENTS
from reachlab.agents.acting import Function, name_of
from reachlab.agents.policy import Policy
from reachlab.emit.program import Program, constants_of
from reachlab.envs.core import Env
from reachlab.envs.setup import in_evaluation
from reachlab.learn.load import load_policy
from reachlab.robots.catalogue import ROBOTS
from reachlab.runs.directory import RunDirectory
from reachlab.runs.shipped import find_run
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError, choose
from reachlab.sims.simulator import Begin
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.watch.page.episode import DRAWN, PLAYED, drawn, programs, sampled
from reachlab.watch.page.physics import engine_of
from reachlab.watch.player import knows_home_alone

ENGINES = ("kinematic", "mujoco")
"""Simulators that a page has."""

SCRIPT = "script"
"""What the page's `ik` is called where there is an object."""

RULES = ("success_distance", "hold_steps", "max_steps", "ends_outside", "ends_on_contact", "settle_steps")
"""Settings of a task that the page's own scripts ask for; where a task has none it is 0."""

NOTHING: Mapping[str, Any] = MappingProxyType({})
"""Changed settings, where none are."""


@dataclass(frozen=True)
class Shown:
    """A run of a page, or an environment with who acts in it.

    Attributes:
        name: what it is called.
        env: its environment, of one episode.
        policy: the policy; None where only baselines act.
        agent: who acts first, of `AGENTS`, or a function of observations.
        seed: of the held-out episodes.
        begin: of the seed's first episodes `[DRAWN, …]`, where the page computes them.
        functions: what the page computes it with; empty where Python computes it.
        why: why that is so, as the end of a sentence; empty where the page does.
        failed: seeds and numbers of held-out episodes that failed in evaluations whose reports are in the run.
    """

    name: str
    env: Env
    policy: Policy | None
    agent: str | Function = "trained"
    seed: int = 1
    begin: Begin | None = None
    functions: tuple[Program, ...] = ()
    why: str = ""
    failed: tuple[tuple[int, int], ...] = ()

    @property
    def agent_name(self) -> str:
        """What who acts first is called."""
        return name_of(self.agent)

    @property
    def title(self) -> str:
        """Maker and type of an arm of the catalogue, else its name."""
        name = self.env.setup.robot.name
        return ROBOTS[name].title if name in ROBOTS else name

    @property
    def scene(self) -> str:
        """Name of what is drawn of the arm: of another file of its name, or with another gripper, it is another one."""
        robot = self.env.setup.robot
        return f"{robot.name} {hashlib.sha256(repr(robot).encode()).hexdigest()[:16]}"


def load_shown(
    path: Path,
    *,
    sim: str | None = None,
    agent: str = "trained",
    seed: int = 1,
    step: int | None = None,
    changed: Mapping[str, Any] = NOTHING,
) -> Shown:
    """The policy of a run's newest checkpoint, or after `step`, and who acts first; the page computes it if it can.

    Settings of the task may be `changed`.

    Raises:
        InputError: the run cannot be read, or there is no such simulator or agent.
    """
    choose("agent", agent, AGENTS)
    run = find_run(path)
    env = Env(in_evaluation(run.read_config(), sim, **changed), 1)
    name = path.name if step is None else f"{path.name}, {step:,} steps"
    one = shown_in(env, agent, load_policy(run, env, step), seed=seed, name=name)
    failed = () if changed else failures(run, env.config.sim, one.agent_name)  # reports are of the goals of training
    return replace(one, failed=tuple(failed))


def shown_in(env: Env, agent: str | Function, policy: Policy | None, *, seed: int, name: str) -> Shown:
    """An agent in an environment of one episode, computed by the page if it can."""
    agent = "ik" if agent == SCRIPT else agent  # they are the same
    why = why_streamed(env.config, agent) or "the page has no policy" * (policy is None)
    if why or policy is None:
        return Shown(name, env, policy, agent, seed, why=why)
    begin = sampled(env, [(seed, number) for number in range(DRAWN)])
    try:
        return Shown(name, env, policy, agent, seed, begin, tuple(programs(env, policy, begin)))
    except InputError as error:
        return Shown(name, env, policy, agent, seed, why=str(error).rstrip("."))


def why_streamed(config: RunConfig, agent: str | Function) -> str:
    """Why a page cannot compute what is shown by itself; empty where nothing is known that hinders it."""
    reasons = {
        f"the page has no {config.sim}": config.sim not in ENGINES,
        "the page draws no pictures for a policy": OBSERVATIONS[config.rules.observation].pictured,
        "the page computes no policy of another library": not isinstance(agent, str),
        f"the page has no agent {name_of(agent)}": agent not in PLAYED,
        "the page always sees the target": config.rules.hides_goal,
        "the page measures no wrench": config.rules.wrench,
        "the page does not hold the meshes that collide with the table": config.physics.collisions,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def failures(run: RunDirectory, sim: str, agent: str) -> Iterator[tuple[int, int]]:
    """Seeds and numbers of the episodes in which an agent failed, of evaluations whose reports are in the run."""
    for report, episodes in run.read_reports():
        if (report["sim"], report["agent"], report["randomised"]) == (sim, agent, []):
            yield from ((report["seed"], int(number)) for number in np.flatnonzero(~episodes["success"]))


def facts_of(one: Shown) -> dict[str, Any]:
    """Facts that the page has to know of a run."""
    setup = one.env.setup
    low, high = setup.robot.workspace
    box = setup.task.goal_box(setup)
    objects, limits = setup.task.scene(setup).objects, setup.robot.commands
    known = {"trained": "trained"} if one.policy is not None else {}
    named = {one.agent_name: one.agent_name} | known | {"ik": SCRIPT if objects else "ik"}
    return {
        "agents": named,
        "agent": one.agent_name,
        "why": one.why,
        "task": one.env.config.task,
        "robot": one.scene,
        "title": one.title,
        "asks": setup.task.asks(setup.rules, setup.period),
        "control_period": setup.period,
        "joints": setup.robot.joint_names,
        "limits": {"lower": limits.lower, "upper": limits.upper},
        "speed": limits.speed,
        "slides": setup.robot.chain.slides,
        "objects": objects,
        "actuators": setup.robot.actuators,
        "goal": {
            "low": box[0].tolist(),
            "high": box[1].tolist(),
            "moves": setup.rules.moves,
            "orientation": setup.rules.asks_orientation,
        },
        "rules": {name: getattr(setup.rules, name, 0) for name in RULES},
        "workspace": {"low": low, "high": high},
        "top": setup.robot.table_top,
        "knows_home_alone": knows_home_alone(one.env),
    } | (_computed(one, one.functions) if one.functions else {"physics": None})


def _computed(one: Shown, functions: Sequence[Program]) -> dict[str, Any]:
    """What it needs beside that to compute a run itself."""
    (least, most), (engine, exact) = one.env.action_bounds, engine_of(one.env)
    begins = {"held out": one.begin}
    if failed := one.failed[:DRAWN]:
        begins["failures"] = jax.tree.map(lambda x: x[: len(failed)], sampled(one.env, failed))
    return {
        "physics": engine,
        "exact": encoded(exact),
        "action": {"low": least.tolist(), "high": most.tolist()},
        "memory": one.env.functions.memory,
        "begins": {
            name: {"count": len(begin.q), "arrays": encoded(drawn(one.env, begin))}
            for name, begin in begins.items()
            if begin
        },
        "constants": encoded(constants_of(functions)),
    }


def encoded(arrays: Mapping[str, np.ndarray]) -> dict[str, dict[str, str]]:
    """Arrays by name as text, each with its type."""
    kinds = {"i": "<i4", "b": "|b1"}
    sent = {name: np.ascontiguousarray(one, kinds.get(one.dtype.kind, one.dtype)) for name, one in arrays.items()}
    return {
        name: {"type": one.dtype.str[1:], "data": base64.b64encode(one.tobytes()).decode()}
        for name, one in sent.items()
    }
