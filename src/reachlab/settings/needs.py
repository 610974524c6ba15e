"""What settings need beside them to have an effect, and what rules on settings are asked about."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Facts:
    """What the rules have to know of the names in a configuration.

    Attributes:
        pictures: the observation holds the camera's picture.
        dynamics: the simulator can vary the arm.
        scale: the setting by which actions are multiplied, if there is one.
        turns: an action can bring the tool into any orientation.
        asks_orientation: the goal has an orientation.
        needs_pose: the observation needs a goal with an orientation.
        needs_velocity: it needs one that moves.
        needs_obstacles: it needs a task with obstacles.
        moves: the task's goal moves.
        obstructed: the task has obstacles.
        contacts: the simulator has some, and tells contacts.
    """

    pictures: bool
    dynamics: bool
    scale: str | None
    turns: bool
    asks_orientation: bool
    needs_pose: bool
    needs_velocity: bool
    needs_obstacles: bool
    moves: bool
    obstructed: bool
    contacts: bool


@dataclass(frozen=True)
class Asked:
    """What a rule is asked about: every setting by name, those that were changed, and the facts."""

    settings: Mapping[str, Any]
    changed: set[str]
    facts: Facts

    def __getitem__(self, name: str) -> Any:
        """Value of a setting."""
        return self.settings[name]


@dataclass(frozen=True)
class Need:
    """What a setting needs to have an effect: in words, and as a question."""

    words: str
    met: Callable[[Asked], bool]
    vital: bool = True
    """Whether a training without that effect is not the one that was asked for: it is refused, else this is said."""


MUJOCO = Need("sim mujoco", lambda s: s["sim"] == "mujoco")
PYBULLET = Need("sim pybullet", lambda s: s["sim"] == "pybullet")
TABLE = Need("targets table", lambda s: s["targets"] == "table")
BOX = Need("targets box", lambda s: s["targets"] == "box")
TURNED = Need("target_turn or targets any", lambda s: s.facts.asks_orientation)
CLOSE = Need("reward precise or closeness", lambda s: s["reward"] in ("precise", "closeness"))
MOVES = Need("a task whose goal moves, as track", lambda s: s.facts.moves)
OBSTRUCTED = Need("a task with obstacles, as clutter", lambda s: s.facts.obstructed)
STOP_EARLY = Need("stop_early", lambda s: s["stop_early"], vital=False)

NEEDS: dict[str, Need] = {
    "tool_scale": Need("an action of the tool, as tool_delta", lambda s: s.facts.scale == "tool_scale"),
    "joint_scale": Need("an action of the joints, as joint_delta", lambda s: s.facts.scale == "joint_scale"),
    "target_height": TABLE,
    "target_low": BOX,
    "target_high": BOX,
    "target_turn": Need("targets box or table", lambda s: s["targets"] != "any" or s["target_turn"] is None),
    "success_angle": TURNED,
    "angle_weight": TURNED,
    "hold_speed": Need("hold_steps above 0 or reward precise", lambda s: s["hold_steps"] or s["reward"] == "precise"),
    "approach_weight": Need("reward dense or precise", lambda s: s["reward"] in ("dense", "precise")),
    "closeness_weight": CLOSE,
    "closeness_scale": Need(
        "reward precise or closeness, and closeness_weight above 0",
        lambda s: s["reward"] in ("precise", "closeness") and s["closeness_weight"] > 0,
    ),
    "effort_weight": CLOSE,
    "obstacles": OBSTRUCTED,
    "end_on_contact": OBSTRUCTED,
    "goal_paths": MOVES,
    "goal_velocity": MOVES,
    "settle_steps": MOVES,
    "goal_jump": Need(
        "a task whose goal moves, as track, and jumps among goal_paths",
        lambda s: s.facts.moves and "jumps" in s["goal_paths"],
    ),
    "goal_speed": Need(
        "a task whose goal moves, as track, and a path beside jumps", lambda s: s.facts.moves and _is_fast(s)
    ),
    "physics_steps": MUJOCO,
    "collisions": MUJOCO,
    "gravity_compensation": MUJOCO,
    "gui": PYBULLET,
    "slow": PYBULLET,
    "stop_success": STOP_EARLY,
    "stop_streak": STOP_EARLY,
    "validation_episodes": STOP_EARLY,
    "validation_interval": STOP_EARLY,
}
"""What settings need to have an effect; those that are not here always have one."""


def _is_fast(s: Asked) -> bool:
    """Whether a goal goes along some path, rather than jump from place to place."""
    return any(name != "jumps" for name in s["goal_paths"])
