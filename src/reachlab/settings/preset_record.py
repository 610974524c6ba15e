"""Presets of tasks: the settings of its training, and those that follow from other choices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from reachlab.settings.config import LearnerConfig, LoopConfig, PPOConfig, RunConfig, SimConfig


@dataclass(frozen=True)
class Rule:
    """Settings by name that go with some configurations."""

    when: Callable[[RunConfig], bool]
    settings: Mapping[str, Any]


@dataclass(frozen=True)
class Preset:
    """Settings that a task starts from, beside its own.

    Attributes:
        sim, robot: simulator and arm.
        randomise: what varies in training.
        physics, loop, learner, ppo: of the simulation and the training.
        rules: what goes with other choices, in the order in which they are applied.
        student: settings of who learns from a policy of the task, where they are not the policy's.
    """

    sim: str = "kinematic"
    robot: str = RunConfig.robot
    randomise: tuple[str, ...] = ()
    physics: SimConfig = field(default_factory=SimConfig)
    loop: LoopConfig = field(default_factory=LoopConfig)
    learner: LearnerConfig = field(default_factory=LearnerConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    rules: tuple[Rule, ...] = ()
    student: Mapping[str, Any] = field(default_factory=dict)
