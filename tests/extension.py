"""What somebody might add: an entry of each table, with nothing else changed. See `test_extension`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.agents import AgentEntry
from reachlab.agents.policy import Policy
from reachlab.control.situation import Goal, Situation
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.robots.catalogue import KnownRobot
from reachlab.settings.config import LoopConfig
from reachlab.settings.preset_record import Preset
from reachlab.settings.rules import TaskSettings
from reachlab.settings.tables import Lazy
from reachlab.sims import SimulatorEntry
from reachlab.sims.kinematic import KinematicSimulator
from reachlab.sims.simulator import BatchArray, Moved, SimState
from reachlab.tasks.actions import Action
from reachlab.tasks.judging import Outcome
from reachlab.tasks.observations import GOAL, TOOL
from reachlab.tasks.precise import Precise
from reachlab.tasks.schema import Observation, Term
from reachlab.tasks.task import Task, TaskSetup

ARM = """
<mujoco><worldbody><body name="base" pos="0 0 0.4"><joint axis="0 0 1" range="-150 150"/>
  <inertial pos="0 0 0" mass="3" diaginertia="0.02 0.02 0.02"/>
  <body name="upper"><joint axis="0 1 0" range="-100 100"/>
    <inertial pos="0.2 0 0" mass="2" diaginertia="0.02 0.02 0.02"/>
    <geom type="capsule" size="0.03" fromto="0 0 0 0.4 0 0"/>
    <body name="lower" pos="0.4 0 0"><joint axis="0 1 0" range="-120 120"/>
      <inertial pos="0.15 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0"/><site name="tip" pos="0.3 0 0"/></body></body></body>
</worldbody></mujoco>"""


def robot(folder: Path) -> KnownRobot:
    """An arm of three joints, whose file says nothing of speeds, torques and boxes."""
    (folder / "three_link.xml").write_text(ARM)
    return KnownRobot(
        file=folder / "three_link.xml",
        title="three links",
        tools={"tip": "tip"},
        home=(0.0, -0.5, 1.0),
        workspace=((0.2, -0.6, 0.0), (0.8, 0.6, 0.9)),
    )


def _above(setup: TaskSetup) -> tuple[np.ndarray, np.ndarray]:
    """A flat box at half the workspace's height."""
    low, high = np.array(setup.robot.workspace, np.float32)
    low[2] = high[2] = (low[2] + high[2]) / 2
    return low, high


def _sample_goal(setup: TaskSetup, key: Array) -> Goal:
    low, high = _above(setup)
    return Goal.at(jnp.asarray(low) + jax.random.uniform(key, (3,)) * (high - low))


def _asks(rules: Hover, period: float) -> str:
    return f"hover within {rules.success_distance} m for {rules.max_steps * period} s"


@dataclass(frozen=True)
class Hover(Precise):
    """Settings of hovering above the table."""

    preset: ClassVar[Preset] = Preset(loop=LoopConfig(num_envs=32))

    reward: str = "closeness"

    @classmethod
    def task(cls) -> Task:
        return replace(super().task(), goal_box=_above, sample_goal=_sample_goal, asks=_asks)


TASK = Lazy("hover above the table", "extension:Hover")


class Sluggish(KinematicSimulator):
    """Joints go half the way to their command in a step."""

    def step(self, state: SimState | Moved, command: BatchArray) -> Moved:
        return super().step(state, (state.q + command) / 2)


SIMULATOR = SimulatorEntry("joints go half the way", "extension:Sluggish")

OBSERVATION = Observation(
    "goal and tool, and the tool's height above the floor in halves of a metre",
    (GOAL, TOOL, Term("height", "0.5 m", lambda _, now: now.tool_position[..., 2:] / 0.5, lambda _: box(4.0))),
)


def box(size: float) -> tuple[np.ndarray, np.ndarray]:
    return np.full(1, -size, np.float32), np.full(1, size, np.float32)


def _command(setup: TaskSetup, now: Situation, action: Array) -> Array:
    chain = setup.robot.chain
    return jnp.clip(now.command + 0.05 * action, jnp.array(chain.lower), jnp.array(chain.upper))


ACTION = Action(
    "five hundredths of a radian a joint",
    lambda setup: (-np.ones(setup.robot.chain.n, np.float32), np.ones(setup.robot.chain.n, np.float32)),
    _command,
    lambda _setup, now, _believed: jnp.zeros_like(now.q),
)


def reward(rules: TaskSettings, outcome: Outcome) -> dict[str, Array]:
    """Minus the square of the distance, a tenth of it."""
    del rules
    return {"squared": -0.1 * jnp.square(outcome.errors.distance)}


def nudge(env: Env, policy: Policy | None, state: EnvState, key: Array, picture: Any) -> Array:
    """The largest action."""
    del policy, key, picture
    return jnp.broadcast_to(jnp.asarray(env.action_bounds[1]), state.last_action.shape)


AGENT = AgentEntry("the largest action at every step", "extension:nudge")


class Notebook:
    """A sink that writes rows into a list, and at the end into the run directory."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self.result: dict[str, Any] | None = {}

    def open(self, folder: Path) -> None:
        self.file = folder / "notebook.json"

    def write(self, row: Mapping[str, Any]) -> None:
        self.rows.append(dict(row))

    def close(self, result: Mapping[str, Any] | None) -> None:
        self.result = None if result is None else dict(result)
        self.file.write_text(json.dumps([self.rows, self.result]))


SINK = Lazy("a list in the run directory", "extension:Notebook")
