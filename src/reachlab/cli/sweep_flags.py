"""Flags of `reachlab sweep`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from reachlab.cli.flags import Address, Engine, Optional
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import Checked, Count, NonNegativeInt

_UNSAID = tyro.conf.arg(metavar="INT", help_behavior_hint="")


@dataclass(frozen=True)
class Sweep(Checked):
    """Search settings: train with many, and find those with the best result."""

    space: Annotated[Path | None, tyro.conf.Positional] = None
    """TOML file with the settings that vary, see docs/scale.md."""
    # Without a name, its own settings are in the first group of flags, and its parts are groups under their own names.
    run: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)
    trials: Annotated[Count | None, _UNSAID] = None
    """Settings that are tried, by default 20, or all if there are fewer."""
    workers: Count = 2
    """Trainings at a time, of one thread each."""
    goal: Annotated[str | None, tyro.conf.arg(metavar="STR", help_behavior_hint="")] = None
    """Figure of the report that is sought, by default success_rate; `reachlab list` shows them all."""
    seeds: Annotated[Count | None, _UNSAID] = None
    """Trainings of each setting, by default one; it counts as the poorer end of the interval of their mean."""
    validations: Annotated[NonNegativeInt | None, _UNSAID] = None
    """Validations of each training on the way, by default 7, by which poor settings are given up; with 0 none is."""
    engine: Engine = "local"
    address: Address = None
    out: Annotated[Path | None, Optional] = None
    """Directory to make; by default a new one below runs/."""
    resume: Annotated[Path | None, Optional] = None
    """Directory of a sweep to resume, with its own settings; --trials may be more than before."""
    config: Annotated[Path | None, Optional] = None
    """File with all settings, as the config.json of a run; flags change them."""
    json: bool = False
    """Print the result as one JSON object on standard output."""
