"""Task `push`: an object on the table is pushed to a place, and rests there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from reachlab.tasks.handling import Handling

if TYPE_CHECKING:
    from reachlab.tasks.task import Task


@dataclass(frozen=True)
class Push(Handling):
    """Settings of pushing an object."""

    @classmethod
    def task(cls) -> Task:
        """An object is pushed along the table."""
        from reachlab.tasks.objects import handled
        from reachlab.tasks.task import Control

        control = Control("push", residual_gain=0.2, fade=0.05, seen="push_seen")
        return handled("push an object along the table to a place", control)

    @property
    def gives(self) -> frozenset[str]:
        """What there is to observe and to control by."""
        return super().gives | {"flat"}

    def contradiction(self) -> str | None:
        """What of these settings cannot be together."""
        if self.object_shape == "ball":
            return "a ball that is pushed rolls on: choose --object-shape box or cylinder."
        if self.object_shape == "puck":
            return "a puck is too low to be pushed by these fingers: choose --object-shape box or cylinder."
        return super().contradiction()
