"""Which settings have an effect: those that nothing that was chosen uses are refused, and not shown in help."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any

from reachlab.settings.config import PPOConfig
from reachlab.sims import SIMULATORS

CLOSENESS = ("closeness_weight", "closeness_scale", "effort_weight")

PPO = tuple(entry.name for entry in dataclasses.fields(PPOConfig))

USES: dict[str, Mapping[Any, Collection[str]]] = {
    "action": {
        **dict.fromkeys(("tool_delta", "tool_step"), ("tool_scale", *PPO)),
        **dict.fromkeys(("joint_delta", "joint_residual", "picture_points"), ("joint_scale", *PPO)),
        "heading": ("joint_scale",),  # which is learnt by imitation
    },
    "reward": {
        **dict.fromkeys(("sparse", "goal", "goal_distance"), ()),
        "dense": ("approach_weight",),
        "precise": ("approach_weight", *CLOSENESS, "hold_speed"),
        "closeness": CLOSENESS,
    },
    "targets": {
        "table": ("target_height", "target_turn"),
        "box": ("target_low", "target_high", "target_turn"),
        "any": (),
    },
    "goal_paths": {**dict.fromkeys(("line", "circle", "smooth"), ("goal_speed",)), "jumps": ("goal_jump",)},
    "stop_early": {True: ("stop_success", "stop_streak", "validation_episodes", "validation_interval"), False: ()},
}
"""Settings that choices use, by the setting that chooses; all others have an effect whatever is chosen. An entry that a
user adds to a table may use any of them."""

MILD = ("stop_early",)
"""Choices of which it is only said that a setting has no effect: the training is the one that was asked for."""


def _uses() -> dict[str, Mapping[Any, Collection[str]]]:
    return USES | {"sim": {name: entry.settings for name, entry in SIMULATORS.items()}}


def unused(settings: Mapping[str, Any]) -> dict[str, str]:
    """Of settings by name those without an effect, each with the setting whose choice does not use it."""
    found: dict[str, str] = {}
    for choice, uses in _uses().items():
        if choice not in settings:
            continue
        chosen = settings[choice] if isinstance(settings[choice], tuple) else (settings[choice],)
        if any(name not in uses for name in chosen):
            continue
        used = {name for one in chosen for name in uses[one]}
        found |= {name: choice for names in uses.values() for name in names if name not in used and name in settings}
    if settings.get("hold_steps"):
        found.pop("hold_speed", None)
    return found


def users(setting: str, choice: str) -> str:
    """The choices that use a setting, in words."""
    names = [name for name, used in _uses()[choice].items() if setting in used]
    return choice if names == [True] else f"{choice} {' or '.join(names)}"
