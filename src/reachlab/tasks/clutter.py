"""Task `clutter`: hold a point among obstacles without touching anything, under full dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar

from reachlab.settings.config import LearnerConfig, LoopConfig, PPOConfig, SimConfig
from reachlab.settings.preset_record import Preset
from reachlab.settings.validation import NonNegative, Positive, Range
from reachlab.tasks.precise import WITHOUT_CONTROLLER, Precise
from reachlab.tasks.tutorial import TOUCHED

if TYPE_CHECKING:
    from reachlab.tasks.task import Task

Few = Annotated[int, Range(0, 16)]
"""A number of obstacles."""


@dataclass(frozen=True)
class Clutter(Precise):
    """Settings of holding a point among obstacles."""

    preset: ClassVar[Preset] = Preset(
        sim="mujoco",
        randomise=("dynamics",),
        physics=SimConfig(control_period=0.02),
        loop=LoopConfig(total_steps=3_000_000, stop_early=False, report_episodes=2000, num_envs=256, rollout_steps=100),
        learner=LearnerConfig(
            hidden=(128, 128),
            learning_rate=5e-4,
            final_learning_rate=1e-5,
            anneal_steps=3_000_000,
            initial_std=0.3,
        ),
        ppo=PPOConfig(epochs=4, minibatches=4, gamma=0.98, final_std=0.1),
        rules=(WITHOUT_CONTROLLER, *TOUCHED),
    )

    observation: str = "clutter"
    reward: str = "closeness"
    max_steps: Annotated[int, Range(1, 10**5)] = 150
    joint_scale: Positive | None = None
    closeness_scale: Positive = 0.02
    effort_weight: NonNegative = 0.001
    obstacles: tuple[Few, Few] = (0, 4)
    """Fewest and most obstacles of an episode."""
    end_on_contact: bool = True
    """Touching anything ends the episode, in failure."""

    @classmethod
    def task(cls) -> Task:
        """The flange is held at a point among obstacles."""
        from reachlab.tasks import scenes
        from reachlab.tasks.placing import place_free_point
        from reachlab.tasks.task import Control, Scene

        return replace(
            super().task(),
            # A residual action of 1 can stop the arm; with the dampers, lead it round.
            control=Control("joint_servo", residual_gain=1.0, dampers=True),
            sample_goal=scenes.sample_free_goal,
            place=place_free_point,
            scene=lambda setup: Scene(fixed=scenes.places(setup), contacts=True),
            sample_bodies=scenes.sample_scene,
            needs=frozenset({"contacts"}),
            asks=_asks,
            succeeds=_succeeds,
        )

    def contradiction(self) -> str | None:
        """What of these settings cannot be together."""
        fewest, most = self.obstacles
        if fewest > most:
            return f"obstacles has a fewest number above the most, {fewest} against {most}: exchange them."
        if self.targets != "box":
            return "the goal of task 'clutter' is a point in a box: set targets to 'box'."
        return super().contradiction()

    @property
    def gives(self) -> frozenset[str]:
        """What there is to observe and to control by."""
        return frozenset({"joints", "bodies"})

    @property
    def ends_on_contact(self) -> bool:
        """Whether touching anything ends an episode."""
        return self.end_on_contact


def _asks(rules: Clutter, period: float) -> str:
    from reachlab.tasks import reach

    fewest, most = rules.obstacles
    return f"{reach.asks(rules, period)}; there are {fewest} to {most} obstacles, and nothing may be touched"


def _succeeds(rules: Clutter, period: float) -> str:
    from reachlab.tasks import reach

    return f"{reach.succeeds(rules, period)}, and the arm has touched nothing"
