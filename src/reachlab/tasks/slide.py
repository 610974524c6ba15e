"""Task `slide`: a puck is struck so that it comes to rest at a place out of reach."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar

from reachlab.settings.preset_record import Preset
from reachlab.settings.validation import InProportion, Positive, Range
from reachlab.tasks.handling import Handling

if TYPE_CHECKING:
    from reachlab.tasks.task import Task


LOWEST = 0.025
"""Least radius of a puck, which is two thirds as high [m]: fingers go down to 15 mm above the table."""

Beyond = Annotated[float, Range(0.0, 2.0, open_low=True)]
"""How far a goal is out of reach [m]: beyond 2 m no arm of these strikes a puck."""


@dataclass(frozen=True)
class Slide(Handling):
    """Settings of sliding a puck."""

    # What a strike comes to shows a second and a half later; the script's numbers are those of the Panda.
    preset: ClassVar[Preset] = replace(
        Handling.preset, robot="panda", randomise=(), ppo=replace(Handling.preset.ppo, gamma=0.99)
    )

    observation: str = "slide"
    success_distance: Annotated[Positive, InProportion(0.1)] = 0.05
    closeness_scale: Positive = 0.05
    object_shape: str = "puck"
    object_size: Annotated[float, Range(0.015, 0.05)] = 0.03
    object_friction: Annotated[float, Range(0.02, 2.0)] = 0.05
    beyond: tuple[Beyond, Beyond] = (0.1, 0.4)
    """How far the goals are out of the arm's reach, at least and at most [m]."""

    def contradiction(self) -> str | None:
        """What of these settings cannot be together."""
        low, high = self.beyond
        if low > high:
            return f"beyond has a least distance above the largest, {low:g} against {high:g} m: exchange them."
        if self.object_shape == "ball":
            return "a ball that is struck rolls on: choose --object-shape puck, cylinder or box."
        if self.object_shape == "puck" and self.object_size < LOWEST:
            return f"a puck of object_size {self.object_size:g} is too low to be struck: choose at least {LOWEST:g}."
        return super().contradiction()

    @classmethod
    def task(cls) -> Task:
        """A puck slides to a place."""
        from reachlab.tasks import out_of_reach
        from reachlab.tasks.objects import handled
        from reachlab.tasks.task import Control

        return handled(
            "strike a puck so that it slides to a place out of reach",
            Control("slide", residual_gain=0.2, fade=0.05),
            goal_box=out_of_reach.goal_box,
            sample_goal=out_of_reach.sample_goal,
            scene=out_of_reach.scene,
        )
