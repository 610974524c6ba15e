"""A task that needs memory: a target is shown for a moment, and where the tool is says nothing of it.

reachlab train --import cue.py --task cue --memory 16 --out runs/cue
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.situation import Goal, Situation
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.settings.config import LearnerConfig, LoopConfig, PPOConfig
from reachlab.settings.preset_record import Preset
from reachlab.settings.tables import Lazy
from reachlab.settings.validation import Positive, Range
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS, Action
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.schema import Observation, Term
from reachlab.tasks.task import Bounds, Task, TaskSetup
from reachlab.tasks.terms import within
from reachlab.tasks.tutorial import Tutorial

TURN = 0.5
"""How far the first joint turns to either target [rad]."""

THERE = 1e-3
"""A target that is no farther to the side is on neither [m]: which one it would be is a matter of rounding."""


@dataclass(frozen=True)
class Cue(Tutorial):
    """Settings of turning to the side on which a target was shown."""

    preset: ClassVar[Preset] = Preset(
        loop=LoopConfig(num_envs=128, rollout_steps=51, total_steps=2_000_000),
        learner=LearnerConfig(hidden=(32,), learning_rate=3e-3, anneal_steps=1_000_000),
        ppo=PPOConfig(gamma=0.9, epochs=4),
    )

    observation: str = "side"
    action: str = "turn"
    reward: str = "closeness"
    closeness_scale: Positive = 0.05
    at_goal: str = "continue"
    end_outside: bool = False
    success_distance: Positive = 0.05
    max_steps: Annotated[int, Range(1, 10**5)] = 51
    goal_steps: Annotated[int, Range(1, 10**5)] | None = 1

    @classmethod
    def task(cls) -> Task:
        """The tool is turned to the left or to the right."""
        return replace(super().task(), goal_box=_box, sample_goal=_sample)


def _sides(setup: TaskSetup) -> Array:
    """Positions `[2, 3]` m of the tool to the left and to the right."""
    home = jnp.array(setup.robot.home)
    turned = jnp.stack([home.at[0].set(home[0] + turn) for turn in (TURN, -TURN)])
    return forward_kinematics(setup.robot.chain, turned).position


def _box(setup: TaskSetup) -> Bounds:
    with jax.ensure_compile_time_eval():
        sides = np.asarray(_sides(setup), np.float32)
    return sides.min(axis=0), sides.max(axis=0)


def _sample(setup: TaskSetup, key: Array) -> Goal:
    return Goal.at(_sides(setup)[jax.random.bernoulli(key).astype(jnp.int32)])


def _side(setup: TaskSetup, now: Situation) -> Array:
    """On which side of the tool the target is; 0 where it is not seen."""
    del setup
    way = (now.goal.position - now.tool_position)[..., 1:2]
    return jnp.where(jnp.abs(way) > THERE, jnp.sign(way), 0.0)


def _turn(setup: TaskSetup, now: Situation, action: Array) -> Array:
    """The first joint is turned from home, wherever it was: what is not remembered is lost."""
    home = jnp.broadcast_to(jnp.array(setup.robot.home), now.command.shape)
    return home.at[:, 0].add(TURN * action[:, 0])


def _towards(setup: TaskSetup, now: Situation, believed: Situation) -> Array:
    del now
    return _side(setup, believed)


OBSERVATIONS["side"] = Observation(
    "on which side the target is, while it is seen", (Term("side", "1", _side, lambda _: within(np.ones(1))),)
)
ACTIONS["turn"] = Action("the turn of the first joint", lambda _: within(np.ones(1)), _turn, _towards)
TASKS["cue"] = Lazy("turn to where a target was shown for a moment", "cue:Cue")
