"""Presets: which settings go with a task, a simulator, an observation, an action or a reward, as one list of rules."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from reachlab.settings.config import DistilRunConfig, RunConfig
from reachlab.settings.json_form import flatten, override, to_json

CHOICES = ("sim", "observation", "action", "reward")
"""Settings that, like the task, decide the defaults of others."""

Config = TypeVar("Config", bound=RunConfig)


@dataclass(frozen=True)
class Rule:
    """Settings that go with some configurations."""

    when: Callable[[RunConfig], bool]
    settings: Mapping[str, Any]


def _touches(config: RunConfig) -> bool:
    """Whether touching the goal is enough."""
    return not config.rules.hold_steps


DYNAMIC_TASKS = ("precise", "pose", "track", "clutter")
"""Tasks under full dynamics."""

RULES: list[Rule] = [
    Rule(
        lambda c: c.task in DYNAMIC_TASKS,
        {
            "sim": "mujoco",
            "randomise": ("dynamics",),
            "observation": "state",
            "action": "joint_residual",
            "reward": "precise",
            "approach_weight": 15.0,
            "effort_weight": 0.003,
            "success_distance": 0.01,
            "at_goal": "continue",
            "max_steps": 100,
            "targets": "box",
            "start_noise": 0.3,
            "hold_steps": 10,
            "control_period": 0.02,
            "total_steps": 4_000_000,
            "stop_early": False,
            "report_episodes": 2000,
            "num_envs": 256,
            "rollout_steps": 100,
            "epochs": 4,
            "minibatches": 4,
            "gamma": 0.93,
            "hidden": (128, 128),
            "final_std": 0.1,
            "learning_rate": 3e-3,
            "final_learning_rate": 1e-5,
            "anneal_steps": 4_000_000,
        },
    ),
    # Half a turn of the tool takes the wrist longer than any way takes the arm.
    Rule(
        lambda c: c.task == "pose",
        {
            "observation": "pose",
            "reward": "closeness",
            "target_turn": (0.5236, 0.5236, 2.0944),
            "max_steps": 200,
            "joint_scale": None,
            "closeness_scale": 0.02,
            "effort_weight": 0.001,
            "gamma": 0.95,
            "learning_rate": 5e-4,
            "initial_std": 0.2,
            "final_std": 0.05,
            "total_steps": 3_000_000,
            "anneal_steps": 3_000_000,
        },
    ),
    Rule(
        lambda c: c.task == "track",
        {
            "observation": "track",
            "reward": "closeness",
            "max_steps": 250,
            "hold_steps": 0,
            "end_outside": False,
            "joint_scale": None,
            "closeness_scale": 0.003,
            "effort_weight": 0.001,
            "gamma": 0.8,
            "total_steps": 3_000_000,
            "anneal_steps": 3_000_000,
        },
    ),
    Rule(
        lambda c: c.task == "clutter",
        {
            "observation": "clutter",
            "end_on_contact": True,
            "obstacles": (0, 4),
            "max_steps": 150,
            "joint_scale": None,
            "reward": "closeness",
            "closeness_scale": 0.02,
            "effort_weight": 0.001,
            "gamma": 0.98,
            "learning_rate": 5e-4,
            "initial_std": 0.3,
            "final_std": 0.1,
            "total_steps": 3_000_000,
            "anneal_steps": 3_000_000,
        },
    ),
    # A policy that has to hold the tool without inverse kinematics to help it learns more slowly.
    Rule(
        lambda c: c.task in DYNAMIC_TASKS and c.rules.action != "joint_residual",
        {
            "effort_weight": 0.1,
            "gamma": 0.97,
            "learning_rate": 1e-3,
            "total_steps": 4_500_000,
            "anneal_steps": 4_500_000,
        },
    ),
    # Where time is real a command takes longer to be followed.
    Rule(lambda c: c.sim == "mujoco", {"control_period": 0.02, "validation_episodes": 1000}),
    # Every environment of PyBullet is a client of its own.
    Rule(lambda c: c.sim == "pybullet", {"num_envs": 16, "rollout_steps": 256, "validation_episodes": 200}),
    # Where success alone is rewarded, its credit has a long way back.
    Rule(
        lambda c: _touches(c) and c.rules.reward == "sparse",
        {"action_repeat": 8, "gamma": 0.9, "anneal_steps": 8_000_000},
    ),
    # A step with a picture costs a hundred times a step without one.
    Rule(
        lambda c: _touches(c) and c.rules.observation in ("image", "image+tool"),
        {
            "num_envs": 256,
            "rollout_steps": 16,
            "action_repeat": 16,
            "gamma": 0.8,
            "epochs": 4,
            "minibatches": 8,
            "learning_rate": 7e-4,
            "anneal_steps": 8_000_000,
            "total_steps": 8_000_000,
            "stop_success": 0.98,
            "stop_streak": 1,
            "validation_episodes": 200,
            "validation_interval": 20,
            "report_episodes": 200,
        },
    ),
]
"""Rules in the order in which they are applied: later ones outrank earlier ones, and what was chosen all."""

DISTILLATION: dict[str, Any] = {
    "total_steps": 40 * 4096,
    "stop_early": False,
    "num_envs": 128,
    "rollout_steps": 8,
    "action_repeat": 4,
    "report_episodes": 200,
    "learning_rate": 3e-3,
    "final_learning_rate": 1e-4,
    "max_grad_norm": 1.0,
}
"""Settings with which a distillation starts, beside those of its teacher's task."""


def preset(task: str = "tutorial", **chosen: Any) -> RunConfig:
    """Configuration of a task with the settings of `CHOICES` that were `chosen`, and the defaults that follow.

    Raises:
        InputError: a value that is not allowed.
    """
    config = override(RunConfig(task=task), **chosen)
    for rule in RULES:
        if rule.when(config):
            config = override(config, **{name: value for name, value in rule.settings.items() if name not in chosen})
    return config


def preset_of(config: RunConfig, **changed: str) -> RunConfig:
    """The preset that a configuration started from, with the choices that are `changed`."""
    settings = flatten(to_json(config))
    return preset(config.task, **({name: settings[name] for name in CHOICES} | changed))


def configure(task: str = "tutorial", **settings: Any) -> RunConfig:
    """Preset with the named settings changed, e.g. `configure("tutorial", reward="sparse", seed=3)`.

    Args:
        task: name of the task.
        settings: settings by name, as the flags of `reachlab train` with underscores.

    Raises:
        InputError: a name that is no setting, or a value that is not allowed.
    """
    chosen = {name: settings[name] for name in CHOICES if settings.get(name) is not None}
    return override(preset(task, **chosen), **settings)


def in_simulator(config: Config, sim: str) -> Config:
    """A configuration in another simulator, with that one's defaults where it has those of its own."""
    if sim == config.sim:
        return config
    here, there = (flatten(to_json(preset_of(config, sim=name))) for name in (config.sim, sim))
    own = flatten(to_json(config))
    follow = {name for name in there if here[name] != there[name] and own[name] == here[name]}
    return override(config, **{name: there[name] for name in follow})


def distillation(teacher: str, taught: RunConfig, **settings: Any) -> DistilRunConfig:
    """Configuration of a student of the teacher in the run directory `teacher`, which was trained as `taught`.

    Args:
        teacher: run directory of the teacher.
        taught: its settings, as `load(teacher).config`.
        settings: settings of the student by name, where they differ.

    Raises:
        InputError: a name that is no setting, or a value that is not allowed.
    """
    parts = {entry.name: getattr(taught, entry.name) for entry in dataclasses.fields(RunConfig)}
    settings = {"observation": "image", **DISTILLATION} | settings
    settings.setdefault("anneal_steps", settings["total_steps"])
    return override(DistilRunConfig(**parts, teacher=teacher, teacher_observation=taught.rules.observation), **settings)
