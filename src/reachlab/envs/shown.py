"""What pictures for people show of a state beside the arm: the goal, whether it is reached, and bodies."""

from __future__ import annotations

import jax
import numpy as np

from reachlab.control.bodies import Bodies
from reachlab.envs.functions import EnvState
from reachlab.jax_setup import jit
from reachlab.render.marks import TARGET_AXES, TOOL_AXES, Axes, Block, Marks
from reachlab.robots.shapes.clearance import capsules_at
from reachlab.tasks.scenes.balls import clearances
from reachlab.tasks.task import TaskSetup

TOUCHING = 0.005
"""Distance within which an arm that touches something touches a body [m]: it has moved on since."""


class Shown:
    """It, by the rules of a task on an arm."""

    def __init__(self, setup: TaskSetup) -> None:
        """Of a task on an arm."""
        self._setup, robot = setup, setup.robot
        self._clearances = jit(
            lambda q, here: clearances(robot.capsules, capsules_at(robot.chain, robot.capsules, q), here), brief=True
        )

    def marks(self, state: EnvState, index: int, path: np.ndarray, trail: np.ndarray) -> Marks:
        """Of one environment of a batch, with the tool's `path [k, 3]` and the goal's `trail [k, 3]` [m]."""
        goal, arm, axes = state.goal, state.arm, ()
        if goal.quaternion.shape[-1]:
            target = (np.asarray(rows)[index] for rows in (goal.position, goal.quaternion))
            tool = (np.asarray(rows)[index] for rows in (arm.tool_position, arm.tool_quaternion))
            axes = Axes(*target, size=TARGET_AXES), Axes(*tool, size=TOOL_AXES)
        near, reached = self._setup.rules.success_distance, self.reached(state, index)
        return Marks(near, reached, path, trail, axes, self.blocks(state, index))

    def blocks(self, state: EnvState, index: int = 0) -> tuple[Block, ...]:
        """The bodies beside one arm as they are drawn, with those that it touches."""
        here: Bodies = jax.tree.map(lambda rows: np.asarray(rows)[index], state.arm.bodies)
        touched = np.zeros(len(here.kind), bool)
        if len(touched) and np.asarray(state.arm.contact)[index].any():
            touched = np.asarray(self._clearances(np.asarray(state.arm.q)[index, None], here))[0] < TOUCHING
        kind, size = here.kind.tolist(), np.asarray(here.mujoco_size)
        moves = np.arange(len(kind)) >= len(kind) - self._setup.task.scene(self._setup).objects
        parts = (here.position, here.quaternion, kind, size, here.present.tolist(), touched.tolist(), moves.tolist())
        return tuple(Block(*one) for one in zip(*parts, strict=True))

    def reached(self, state: EnvState, index: int = 0) -> bool:
        """Whether a goal is reached now: the tool is near enough and, where the task asks for it, was held there."""
        task, rules = self._setup.task, self._setup.rules
        # Of a goal that moves the errors that count are those of the whole episode.
        errors = state.errors if rules.moves else task.counted(state.errors, state.progress)
        return bool(np.asarray(task.near(rules, errors))[index])
