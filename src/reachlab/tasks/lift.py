"""Task `lift`: an object on the table is gripped, carried to a place in the air, and held there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from reachlab.tasks.handling import Handling

if TYPE_CHECKING:
    from reachlab.tasks.task import Task


@dataclass(frozen=True)
class Lift(Handling):
    """Settings of lifting an object."""

    observation: str = "lift"

    @classmethod
    def task(cls) -> Task:
        """An object is gripped and held in the air."""
        from reachlab.tasks.objects import above, handled, sample_above
        from reachlab.tasks.task import Control

        return handled(
            "grip an object and hold it at a place above the table",
            Control("lift", residual_gain=0.2, fade=0.05),
            goal_box=above,
            sample_goal=sample_above,
            needs=frozenset({"objects", "gripping"}),
        )

    grips = True
    """The fingers are driven."""
