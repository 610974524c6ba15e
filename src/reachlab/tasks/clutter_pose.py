"""Task `clutter_pose`: `clutter`, and the tool is turned as asked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from reachlab.settings.validation import NonNegative, Positive
from reachlab.tasks.clutter import Clutter

if TYPE_CHECKING:
    from reachlab.tasks.task import Task


@dataclass(frozen=True)
class ClutterPose(Clutter):
    """Settings of holding a pose in clutter."""

    observation: str = "clutter_pose"
    success_angle: Positive = 0.05
    """Tool to target within this angle too is a success [rad]."""
    angle_weight: NonNegative = 0.1
    """Distance that a radian of the angle to the target counts as in rewards and corrections [m/rad]."""

    @classmethod
    def task(cls) -> Task:
        """The flange is held in a pose in clutter."""
        from reachlab.tasks import reach
        from reachlab.tasks.given_goals import place_pose

        among = super().task()
        return replace(
            among,
            place=place_pose,
            errors=reach.pose_errors,
            gap=reach.pose_gap,
            near=reach.near_pose,
            needs=among.needs | {"turning"},
        )

    gives = Clutter.gives | {"orientation"}
    """What there is to observe and to control by."""
