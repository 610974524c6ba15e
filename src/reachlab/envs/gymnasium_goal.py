"""Gymnasium's interfaces with goals, for hindsight replay: rewards and ends can be computed again for any goal.

The methods are those of `gymnasium_robotics.core.GoalEnv`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np

from reachlab.envs.gymnasium_shared import Episodes
from reachlab.envs.gymnasium_single import ReachEnv
from reachlab.envs.gymnasium_vector import ReachVectorEnv
from reachlab.envs.presets import configure, preset
from reachlab.robots.kinematics.forward import angle_between
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError, choose
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.rewards import GOAL_REWARDS
from reachlab.tasks.schema import GOALS
from reachlab.tasks.task import Errors

Info = Mapping[str, Any] | Sequence[Mapping[str, Any]]
"""Infos of one step, of a batch of them, or one of each step."""


class Goals:
    """Rewards and ends as functions of where the tool is and where it was to be.

    Goals are positions `[..., 3]` m or, where the task asks for an orientation, poses `[..., 7]`: a position and a
    quaternion wxyz.
    """

    _episodes: Episodes

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Info) -> Any:
        """Rewards `[...]`: those that a step gives which led there."""
        del info
        setup = self._episodes.env.setup
        rules, errors = setup.rules, _errors(achieved_goal, desired_goal)
        return GOAL_REWARDS[rules.reward](setup.task.near(rules, errors), setup.task.gap(rules, errors))

    def compute_terminated(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Info) -> Any:
        """Whether the task ends the episode `[...]`."""
        del info
        setup = self._episodes.env.setup
        rules, place = setup.rules, np.asarray(achieved_goal)[..., :3]
        low, high = np.array(setup.robot.workspace, np.float32)
        reached = setup.task.near(rules, _errors(achieved_goal, desired_goal))
        outside = ((place < low) | (place > high)).any(axis=-1)
        return (outside & rules.ends_outside) | (reached & rules.ends_at_goal)

    def compute_truncated(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: Info) -> Any:
        """Whether the clock does `[...]`; never where the infos do not tell how many steps were taken."""
        if isinstance(info, Mapping):
            steps = info.get("elapsed_steps", 0)
        else:
            steps = [one.get("elapsed_steps", 0) for one in info or ({},)]
        ended = self.compute_terminated(achieved_goal, desired_goal, info)
        return (np.asarray(steps) >= self._episodes.env.setup.rules.max_steps) & ~ended


class ReachGoalEnv(Goals, ReachEnv):
    """One arm that has to reach a goal; the observation is a dict with `achieved_goal` and `desired_goal`."""

    def __init__(self, task: str = "tutorial", render_mode: str | None = None, **settings: Any) -> None:
        """Environment of a task preset, see `ReachEnv`.

        Raises:
            InputError: see `ReachEnv`; or rewards or ends could not be computed again.
        """
        super().__init__(render_mode=render_mode, **_checked({"task": task, **settings}))


class ReachGoalVectorEnv(Goals, ReachVectorEnv):
    """A batch of arms with goals of their own, stepped together; see `ReachGoalEnv`."""

    def __init__(self, num_envs: int = 1, **settings: Any) -> None:
        """Batch of environments, see `ReachVectorEnv`.

        Raises:
            InputError: see `ReachGoalEnv`.
        """
        super().__init__(num_envs, **_checked({"task": "tutorial", **settings}))


def _checked(settings: dict[str, Any]) -> dict[str, Any]:
    """The settings without those that the id brings along and the task does not have.

    Raises:
        InputError: rewards and ends do not follow from goals.
    """
    usual, known = gymnasium.spec("reachlab/ReachGoal-v0").kwargs, flatten(to_json(preset(settings["task"])))
    kept = {name: value for name, value in settings.items() if name in known or usual.get(name) != value}
    rules = configure(**{name: value for name, value in kept.items() if name in known}).rules
    names = [name for name, design in OBSERVATIONS.items() if design.terms[-1].name == GOALS[-1]]
    choose("observation of a goal environment", rules.observation, names)
    choose("reward of a goal environment", rules.reward, GOAL_REWARDS)
    if rules.holds and rules.ends_at_goal:
        raise InputError(
            "a goal environment cannot end an episode once the goal was held for hold_steps, which its last step does"
            " not tell: set at_goal to 'continue', or hold_steps to 0."
        )
    if rules.ends_on_contact:
        raise InputError("a goal environment cannot end on contact, which no goal tells: set end_on_contact to False.")
    return kept


def _errors(achieved_goal: np.ndarray, desired_goal: np.ndarray) -> Errors:
    """Errors `[...]` of goals; of positions alone the angles are zero."""
    achieved, desired = np.asarray(achieved_goal), np.asarray(desired_goal)
    if {achieved.shape[-1:], desired.shape[-1:]} not in ({(3,)}, {(7,)}):
        raise InputError(
            f"goals must be positions [..., 3], or those and orientations [..., 7], got {achieved.shape} and"
            f" {desired.shape}."
        )
    distance = np.linalg.norm(achieved[..., :3] - desired[..., :3], axis=-1)
    one, other = achieved[..., 3:], desired[..., 3:]
    return Errors(distance, angle_between(one, other) if one.shape[-1] else np.zeros_like(distance))
