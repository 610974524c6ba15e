"""Task `precise`: hold a point in the air, under full dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar

from reachlab.settings.config import LearnerConfig, LoopConfig, PPOConfig, SimConfig
from reachlab.settings.preset_record import Preset, Rule
from reachlab.settings.validation import InProportion, NonNegative, NonNegativeInt, Positive, Range
from reachlab.tasks.tutorial import TOUCHED, Tutorial

if TYPE_CHECKING:
    from reachlab.tasks.task import Task

WITHOUT_CONTROLLER = Rule(
    lambda c: c.rules.action != "joint_residual",
    {
        "effort_weight": 0.1,
        "gamma": 0.97,
        "learning_rate": 1e-3,
        "total_steps": 4_500_000,
        "anneal_steps": 4_500_000,
    },
)
"""A policy that has to hold the tool without a controller to correct learns more slowly."""


@dataclass(frozen=True)
class Precise(Tutorial):
    """Settings of holding a point."""

    preset: ClassVar[Preset] = Preset(
        sim="mujoco",
        randomise=("dynamics",),
        physics=SimConfig(control_period=0.02),
        loop=LoopConfig(total_steps=4_000_000, stop_early=False, report_episodes=2000, num_envs=256, rollout_steps=100),
        learner=LearnerConfig(hidden=(128, 128), learning_rate=3e-3, final_learning_rate=1e-5, anneal_steps=4_000_000),
        ppo=PPOConfig(epochs=4, minibatches=4, gamma=0.93, final_std=0.1),
        rules=(WITHOUT_CONTROLLER, *TOUCHED),
    )

    observation: str = "state"
    action: str = "joint_residual"
    reward: str = "precise"
    approach_weight: Annotated[NonNegative, InProportion(5.0, inverse=True)] = 15.0
    effort_weight: NonNegative = 0.003
    success_distance: Annotated[Positive, InProportion(0.1)] = 0.01
    at_goal: str = "continue"
    max_steps: Annotated[int, Range(1, 10**5)] = 100
    targets: str = "box"
    start_noise: NonNegative = 0.3
    hold_steps: NonNegativeInt = 10
    """Success is that the tool was within the success distance, and the joints slow, for so many steps in a row; with
    0, touching the target is enough."""

    @classmethod
    def task(cls) -> Task:
        """The flange is held at a point in the air."""
        return replace(super().task(), tool="flange")

    def contradiction(self) -> str | None:
        """What of these settings cannot be together."""
        if self.at_goal == "hold" and self.hold_steps:
            return (
                f"at_goal 'hold' holds the arm at the target, and hold_steps {self.hold_steps} asks the policy to do"
                " so: set at_goal to 'continue', or hold_steps to 0."
            )
        if self.hold_steps > self.max_steps:
            return (
                f"the tool cannot be held for hold_steps {self.hold_steps} in an episode of max_steps"
                f" {self.max_steps}: choose fewer --hold-steps or more --max-steps."
            )
        return super().contradiction()

    @property
    def holds(self) -> bool:
        """Whether the goal has to be held for a while, rather than touched."""
        return self.hold_steps > 0
