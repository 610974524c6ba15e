"""Begins of episodes, bodies and situations that tests make by hand."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from reachlab.control.bodies import Bodies, Shape, absent
from reachlab.control.situation import Goal, Situation
from reachlab.robots.kinematics.forward import Pose
from reachlab.sims.simulator import Begin
from reachlab.tasks.judging import Outcome, judge
from reachlab.tasks.task import Errors, TaskSetup
from reachlab.tasks.tutorial import Tutorial

RULES = Tutorial(tool_scale=0.005, success_distance=0.1, approach_weight=5.0, target_height=-0.0083)
"""The tutorial's rules on its arm."""


def begin(q: Any, goal: Goal | None = None, bodies: Bodies | None = None, dynamics: Any = None) -> Begin:
    """Episodes that begin at joints `[B, n]`, with nothing beside the arms but what is given."""
    count = len(q)
    return Begin(
        key=jnp.zeros(count),
        q=q,
        goal=Goal.at(jnp.zeros((count, 3))) if goal is None else goal,
        bodies=absent(count, 0) if bodies is None else bodies,
        dynamics=jnp.zeros((count, 0)) if dynamics is None else dynamics,
    )


def swept(position: Any, quaternion: Any, half: Any, radius: Any) -> Bodies:
    """Bodies that are boxes of half sides `[..., K, 3]` swept by a ball of a radius `[..., K]`."""
    half, radius = np.asarray(half, np.float32), np.asarray(radius, np.float32)
    box, long = half[..., :1] > 0, half[..., 2:] > 0
    rounded = np.concatenate([radius[..., None], half[..., 2:], np.zeros_like(half[..., :1])], axis=-1)
    return Bodies(
        position=jnp.asarray(position, jnp.float32),
        quaternion=jnp.asarray(quaternion, jnp.float32),
        velocity=jnp.zeros((*radius.shape, 6)),
        size=jnp.asarray(np.where(box, half, rounded)),
        kind=jnp.asarray(np.where(box, Shape.BOX, np.where(long, Shape.CAPSULE, Shape.BALL))[..., 0], jnp.int32),
    )


def situation(q: Any, qd: Any, tool: Pose, goal: Goal, **parts: Any) -> Situation:
    """Arms at joints `[B, n]`, commanded to stay there, with nothing beside them but what is given."""
    usual = {
        "command": q,
        "last_action": q,
        "bodies": absent(len(q), 0),
        "contact": jnp.zeros((len(q), 0), bool),
        "achieved": tool,
        "opening": q[:, :0],
    }
    return Situation(q, qd, tool.position, tool.quaternion, goal, **(usual | parts))


def judged(setup: TaskSetup, begun: Situation, steps: list[Situation]) -> list[Outcome]:
    """Outcomes of an episode's steps, which led from `begun` to each of these situations."""
    errors, outcomes = setup.task.errors(setup, begun), []
    progress = setup.task.begin(setup, errors)
    for number, now in enumerate(steps, start=1):
        outcomes.append(judge(setup, errors, progress, now, jnp.array([number])))
        errors, progress = outcomes[-1].errors, outcomes[-1].progress
    return outcomes


def errors_of(distance: Any) -> Errors:
    """Errors of a distance alone."""
    return Errors(distance, jnp.zeros((len(distance), 0)))
