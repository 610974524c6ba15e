"""Flags of `reachlab record`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from reachlab.cli.flags import Agent, Subjects
from reachlab.settings.validation import Count, Range, Seed


@dataclass(frozen=True)
class Record(Subjects):
    """Record episodes as a LeRobot dataset, to train other policies on; the same command resumes one."""

    agent: Agent = "trained"
    episodes: Count = 100
    """Episodes to record; none of them is one of an evaluation, whatever its seed."""
    out: Path = Path("dataset")
    """Folder to make."""
    cameras: tuple[str, ...] = ("front",)
    """Cameras whose pictures are recorded, see `reachlab list cameras`; --cameras alone for no pictures."""
    size: Annotated[int, Range(16, 512)] = 96
    """Height and width of pictures, an even number [pixels]."""
    seed: Seed = 0
    """Seed of the targets."""
    randomise: tuple[str, ...] | None = None
    """What varies from episode to episode: dynamics, delay, view, objects, sight; by default what does in training."""
    failures: bool = False
    """Record episodes without success too."""
    json: bool = False
    """Print what was recorded as one JSON object on standard output."""
