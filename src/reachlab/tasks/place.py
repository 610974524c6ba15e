"""Task `place`: an object is taken over a low wall, set down behind it and let go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from reachlab.settings.validation import Range
from reachlab.tasks.lift import Lift

if TYPE_CHECKING:
    from reachlab.tasks.task import Task


@dataclass(frozen=True)
class Place(Lift):
    """Settings of placing an object behind a wall."""

    max_steps: Annotated[int, Range(1, 10**5)] = 200
    wall_height: Annotated[float, Range(0.01, 0.1)] = 0.05
    """Height of the wall across the table [m]."""

    @classmethod
    def task(cls) -> Task:
        """An object is set down behind a wall."""
        from reachlab.tasks import walls
        from reachlab.tasks.objects import handled
        from reachlab.tasks.task import Control

        return handled(
            "take an object over a wall, set it down at a place behind it and let go",
            Control("place", residual_gain=0.2, fade=0.05),
            also=f", with the hand {1000 * walls.LET_GO:g} mm away",
            scene=walls.scene,
            sample_goal=walls.sample_goal,
            sample_bodies=walls.sample_bodies,
            place=walls.place,
            check=walls.check,
            update=walls.update,
            needs=frozenset({"objects", "gripping"}),
        )
