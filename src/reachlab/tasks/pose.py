"""Task `pose`: hold a position and an orientation, under full dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar

from reachlab.settings.preset_record import Preset
from reachlab.settings.validation import NonNegative, Positive, Range
from reachlab.tasks.precise import Precise

if TYPE_CHECKING:
    from reachlab.tasks.task import Task


@dataclass(frozen=True)
class Pose(Precise):
    """Settings of holding a pose."""

    preset: ClassVar[Preset] = replace(
        Precise.preset,
        loop=replace(Precise.preset.loop, total_steps=3_000_000),
        learner=replace(Precise.preset.learner, learning_rate=5e-4, anneal_steps=3_000_000, initial_std=0.2),
        ppo=replace(Precise.preset.ppo, gamma=0.95, final_std=0.05),
    )
    evaluated: ClassVar[tuple[str, ...]] = ("target_turn", *Precise.evaluated)

    observation: str = "pose"
    reward: str = "closeness"
    # Half a turn of the tool takes the wrist longer than any way takes the arm.
    max_steps: Annotated[int, Range(1, 10**5)] = 200
    joint_scale: Positive | None = None
    closeness_scale: Positive = 0.02
    effort_weight: NonNegative = 0.001
    success_angle: Positive = 0.05
    """Tool to target within this angle too is a success [rad]."""
    angle_weight: NonNegative = 0.1
    """Distance that a radian of the angle to the target counts as in rewards and corrections [m/rad]."""
    target_turn: tuple[NonNegative, NonNegative, NonNegative] = (0.5236, 0.5236, 2.0944)
    """Targets on the table or in a box: the held orientation turned by up to this roll, pitch and yaw about the world's
    axes [rad]."""

    @classmethod
    def task(cls) -> Task:
        """The flange is held in a pose."""
        from reachlab.tasks import reach
        from reachlab.tasks.given_goals import place_pose
        from reachlab.tasks.task import Control

        return replace(
            super().task(),
            # The joints are known: they need no way round anything.
            control=Control("joint_servo", residual_gain=0.3),
            place=place_pose,
            errors=reach.pose_errors,
            gap=reach.pose_gap,
            near=reach.near_pose,
            needs=frozenset({"turning"}),
        )

    gives = frozenset({"orientation", "joints"})
    """What there is to observe and to control by."""
