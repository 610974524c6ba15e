"""Flags of `reachlab record`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from reachlab.cli.flags import Agent, Subjects
from reachlab.settings.config import RecordConfig


@dataclass(frozen=True)
class Record(Subjects):
    """Record episodes as a LeRobot dataset, to train other policies on; the same command resumes one."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """A run, a policy or a model, named as for `eval`; baselines need none."""
    agent: Agent = "trained"
    out: Path = Path("dataset")
    """Folder to make."""
    settings: RecordConfig = field(default_factory=RecordConfig)
    randomise: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[STR ...]", help_behavior_hint="")] = None
    """What varies from episode to episode: dynamics, delay, lag, view, objects, sight; by default as in training."""
    json: bool = False
    """Print what was recorded as one JSON object on standard output."""
