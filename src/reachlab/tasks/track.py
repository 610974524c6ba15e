"""Task `track`: follow a point that moves, under full dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar

from reachlab.settings.preset_record import Preset
from reachlab.settings.rules import TaskSettings
from reachlab.settings.validation import (
    BY_ARM,
    InProportion,
    Length,
    NonNegative,
    NonNegativeInt,
    Point,
    Positive,
    Range,
)
from reachlab.tasks.precise import WITHOUT_CONTROLLER, Precise

if TYPE_CHECKING:
    from reachlab.tasks.task import Task


@dataclass(frozen=True)
class Track(TaskSettings):
    """Settings of following a point."""

    preset: ClassVar[Preset] = replace(
        Precise.preset,
        loop=replace(Precise.preset.loop, total_steps=3_000_000),
        learner=replace(Precise.preset.learner, anneal_steps=3_000_000),
        ppo=replace(Precise.preset.ppo, gamma=0.8),
        rules=(WITHOUT_CONTROLLER,),
    )
    evaluated: ClassVar[tuple[str, ...]] = (
        *("goal_paths", "goal_speed", "goal_jump", "goal_velocity", "target_low", "target_high", "settle_steps"),
        *TaskSettings.evaluated,
    )

    observation: str = "track"
    action: str = "joint_residual"
    reward: str = "closeness"
    approach_weight: Annotated[NonNegative, InProportion(5.0, inverse=True)] = 15.0
    success_distance: Annotated[Positive, InProportion(0.1)] = 0.01
    max_steps: Annotated[int, Range(1, 10**5)] = 250
    start_noise: NonNegative = 0.3
    joint_scale: Positive | None = None
    closeness_scale: Positive = 0.003
    effort_weight: NonNegative = 0.001
    target_low: Point | None = None
    """Lower corner of the box in which the goal moves [m]; by default the robot's own."""
    target_high: Point | None = None
    """Upper corner of the box in which the goal moves [m]; by default the robot's own."""
    goal_paths: Annotated[tuple[str, ...], Length(16)] = ("line", "circle", "smooth")
    """The paths of which an episode has one, of circle, jumps, line and smooth."""
    goal_speed: tuple[NonNegative, NonNegative] = (0.0, 0.2)
    """Least and largest speed, of which an episode has one in between [m/s]."""
    goal_jump: Annotated[Positive, InProportion(0.3)] = BY_ARM
    """How far the goal jumps [m]; by default 0.3 m, in proportion to the arm's workspace."""
    goal_velocity: bool = True
    """The policy and its controller know the goal's velocity."""
    settle_steps: NonNegativeInt = 50
    """Steps at the beginning of an episode that do not count."""

    @classmethod
    def task(cls) -> Task:
        """The flange follows a point."""
        from reachlab.tasks import following, reach
        from reachlab.tasks.targets import box_corners
        from reachlab.tasks.task import Control, Task

        return Task(
            tool="flange",
            # The residual never fades, for the tool is never just there; its gain is as much as the errors take.
            control=Control("feed_forward", residual_gain=0.05, fade=0.0),
            goal_box=box_corners,
            sample_goal=following.sample_goal,
            sample_start=reach.sample_start,
            move=following.move,
            known=following.known,
            begin=following.begin,
            update=following.update,
            counted=following.counted,
            check=following.check,
            asks=_asks,
            succeeds=_succeeds,
        )

    def contradiction(self) -> str | None:
        """What of these settings cannot be together."""
        low, high = self.goal_speed
        if not self.goal_paths:
            return "goal_paths names no path: choose one of those that `reachlab list` shows, or several."
        if low > high:
            return f"goal_speed has a least speed above the largest, {low:g} against {high:g} m/s: exchange them."
        if self.settle_steps >= self.max_steps:
            return (
                f"no step would count after settle_steps {self.settle_steps} in an episode of max_steps"
                f" {self.max_steps}: choose fewer --settle-steps or more --max-steps."
            )
        return None

    gives = frozenset({"velocity"})
    """What there is to observe and to control by."""


def _asks(rules: Track, period: float) -> str:
    from reachlab.tasks.paths import PATHS

    ways = "; ".join(PATHS[name].summary for name in rules.goal_paths)
    low, high = rules.goal_speed
    return (
        f"follow a point for {rules.max_steps:,} steps ({rules.max_steps * period:.2g} s), which moves at {low:g} to"
        f" {high:g} m/s in the arm's box: {ways}"
    )


def _succeeds(rules: Track, period: float) -> str:
    return (
        f"the root mean square of the distance after the first {rules.settle_steps * period:.2g} s is below"
        f" {1000 * rules.success_distance:.4g} mm"
    )
