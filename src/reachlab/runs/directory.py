"""The run directory, the only thing that one command hands to the next."""

from __future__ import annotations

import contextlib
import difflib
import logging
import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, TypeVar

from reachlab.envs.earlier_configs import from_json
from reachlab.runs import checkpoint
from reachlab.runs.checkpoint import Counters, Manifest
from reachlab.runs.files import read_json, remove, sync, write_json
from reachlab.runs.lock import NAME, refuse_if_held
from reachlab.runs.metrics import read_metrics
from reachlab.runs.saved_reports import read_reports, write_report
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import difference, to_json
from reachlab.settings.validation import InputError

if TYPE_CHECKING:
    import numpy as np

KEEP = 3
"""Newest checkpoints that are kept, unless said otherwise."""

Tree = TypeVar("Tree")

log = logging.getLogger(__name__)


def read_config(file: Path) -> RunConfig:
    """The configuration in a file.

    Raises:
        InputError: there is none, or it cannot be used.
    """
    data = read_json(file)
    try:
        return from_json(data)
    except InputError as error:
        raise InputError(f"'{file}' is not usable: {error}") from None


class RunDirectory:
    """Paths of one run, and what is written to them and read from them."""

    def __init__(self, path: Path) -> None:
        """Run directory at `path`, which need not exist."""
        self.path = path
        self.config_file = path / "config.json"
        self.robot_file = path / checkpoint.ROBOT
        self.metrics_file = path / "metrics.jsonl"
        self.report_file = path / "report.json"
        self.offending_file = path / "not_finite.safetensors"
        self.checkpoints = path / "checkpoints"
        self.reports = path / "reports"
        self.sweep_file = path / "sweep.json"

    def create(self, config: RunConfig) -> None:
        """Make the directory with the configuration and the hash of the robot's files in it, the first of all files.

        Raises:
            InputError: it exists, or cannot be made, or the robot cannot be read.
        """
        from reachlab.robots.catalogue import find_model_file

        self.refuse_existing()
        robot = {"sha256": find_model_file(config.robot, config.package).digest}
        temporary = self.path.parent / f".{self.path.name}.{secrets.token_hex(4)}.tmp"
        try:
            temporary.mkdir(parents=True)
            write_json(temporary / self.config_file.name, to_json(config))
            write_json(temporary / self.robot_file.name, robot)
            temporary.rename(self.path)
            sync(self.path.parent)
        except (OSError, ValueError) as error:  # a ValueError where the path cannot be one, as with a zero in it
            with contextlib.suppress(OSError, ValueError):
                remove(temporary)
            why = error.strerror if isinstance(error, OSError) else error
            raise InputError(f"run directory '{self.path}' cannot be made: {why}.") from None

    def remove_unbegun(self) -> None:
        """Remove a directory of a training that never began, so that the same command can be given again.

        Nothing but its settings is there, and no process holds it.
        """
        own = {self.config_file.name, NAME}
        with contextlib.suppress(OSError, InputError):
            found = {one.name for one in self.path.iterdir() if one != self.metrics_file or one.stat().st_size}
            if own <= found <= own | {self.robot_file.name}:
                refuse_if_held(self.path)
                remove(self.path)

    def refuse_existing(self) -> None:
        """Refuse a path at which something is, but for what a training has left that was interrupted before it began.

        Raises:
            InputError: something is there, or that cannot be found out.
        """
        self.remove_unbegun()
        try:
            taken = self.path.exists() or self.path.is_symlink()
        except OSError as error:
            raise InputError(f"run directory '{self.path}' cannot be made: {error.strerror}.") from None
        if taken:
            refuse_if_held(self.path)
            go_on = self.config_file.is_file() and not self.finished
            more = f", or continue it with --resume {quote(str(self.path))}" if go_on else ""
            raise InputError(
                f"run directory '{self.path}' exists and is not overwritten: name another with --out{more}."
            )

    # --- configuration ----------------------------------------------------------------------------

    def read_config(self, *, check_robot: bool = True) -> RunConfig:
        """The run's configuration.

        Args:
            check_robot: whether its robot has to be the one that it was trained with, see `check_robot`.

        Raises:
            InputError: there is no such run, its configuration cannot be used, or its robot is not the one that it
                was trained with.
        """
        self.check_there()
        config = read_config(self.config_file)
        if check_robot:
            self.check_robot(config)
        return config

    def check_there(self) -> None:
        """Refuse what cannot be a run.

        Raises:
            InputError: there is no such directory.
        """
        if self.path.is_file():
            raise InputError(f"'{self.path}' is a file, where the directory of a run is needed.")
        if not self.path.is_dir():
            beside = [one.parent.name for one in self.path.parent.glob(f"*/{self.config_file.name}")]
            near = difflib.get_close_matches(self.path.name, beside, n=1)
            hint = f" Did you mean '{self.path.with_name(near[0])}'?" if near else ""
            raise InputError(
                f"run directory '{self.path}' does not exist: train one with `reachlab train --out {self.path}`.{hint}"
            )

    def check_robot(self, config: RunConfig) -> None:
        """Refuse a robot whose files have changed since the run was made; runs of earlier versions have no hash.

        Raises:
            InputError: they have, or cannot be read.
        """
        if not self.robot_file.exists():
            return
        from reachlab.robots.catalogue import ROBOTS, find_model_file

        if config.robot not in ROBOTS and not Path(config.robot).exists():
            where = f"put it there, or write where it is now into '{self.config_file}'"
            raise InputError(f"robot file '{config.robot}', of run '{self.path}', does not exist: {where}.")
        file, trained = find_model_file(config.robot, config.package), read_json(self.robot_file)
        if trained == {"sha256": file.digest}:
            return
        how = "install the version of reachlab that trained it" if config.robot in ROBOTS else "restore what was there"
        raise InputError(
            f"run '{self.path}' was trained with another arm: robot file '{file.file}', or a file that it names, has"
            f" changed since. Train a new run, or {how}."
        )

    def read_settings(self) -> dict[str, Any]:
        """The configuration as its file has it, of whatever version; empty where there is no file.

        Raises:
            InputError: the file holds no settings.
        """
        data = read_json(self.config_file) if self.config_file.exists() else {}
        if not isinstance(data, dict):
            raise InputError(f"'{self.config_file}' is not usable: it must hold settings, got {type(data).__name__}.")
        return data

    def read_unfinished(self, config: RunConfig) -> None:
        """Make sure that a run can be resumed with these settings.

        Raises:
            InputError: there is no such run, it has other settings, or another process trains it.
        """
        if other := difference(self.read_config(check_robot=False), config):
            raise InputError(
                f"run '{self.path}' was begun with {other[0]} {other[1]!r} and cannot be resumed with {other[2]!r}:"
                f" leave the setting out, or train a new run with --out."
            )
        refuse_if_held(self.path)

    # --- what came of it --------------------------------------------------------------------------

    @property
    def finished(self) -> bool:
        """Whether training has written its report."""
        return self.report_file.is_file()

    def read_metrics(self) -> list[dict[str, Any]]:
        """Rows of the metrics, one an iteration; see `metrics.read_metrics`."""
        return read_metrics(self.metrics_file)

    def write_report(self, name: str, report: Mapping[str, Any], episodes: Mapping[str, Any]) -> None:
        """Save an evaluation's report and arrays of its episodes; see `reports.write_report`."""
        write_report(self.reports, name, report, episodes)

    def read_reports(self) -> Iterator[tuple[dict[str, Any], dict[str, np.ndarray]]]:
        """Reports of evaluations, each with arrays of its episodes; see `reports.read_reports`."""
        return read_reports(self.reports)

    # --- checkpoints ------------------------------------------------------------------------------

    def write_checkpoint(self, step: int, state: object, counters: Counters | None = None, keep: int = KEEP) -> None:
        """Save a pytree of arrays; afterwards the newest `keep` checkpoints are there, and the best of all.

        Raises:
            OSError, InputError: it cannot be written; what was there is as it was.
        """
        self.checkpoints.mkdir(exist_ok=True)
        checkpoint.write(self.checkpoints, state, counters or Counters(step), read_json(self.config_file))
        with contextlib.suppress(OSError):
            checkpoint.prune(self.checkpoints, keep, step)

    def checkpoint_steps(self) -> list[int]:
        """Steps of the checkpoints that are whole, oldest first; others are named in a warning.

        Raises:
            InputError: no checkpoint, or none that is whole.
        """
        config, steps, failures = self.read_config(check_robot=False), [], []
        for folder in checkpoint.find(self.checkpoints):
            try:
                steps.append(checkpoint.verify(folder, config).counters.steps)
            except InputError as error:
                failures.append(error)
        if not steps:
            raise self._none(failures)
        for failure in failures:
            log.warning("reachlab: %s It is left out.", failure)
        return steps[::-1]

    def read_checkpoint(self, part: str, template: Tree, step: int | None = None) -> Tree:
        """A checkpoint's part with that name, in the shape of `template`: after `step`, or of the newest usable one.

        A newer one that is damaged is named in a warning.

        Raises:
            InputError: no checkpoint, none that is whole, or one of another shape.
        """
        return self.read_identified(part, template, step)[1]

    def read_identified(self, part: str, template: Tree, step: int | None = None) -> tuple[dict[str, Any], Tree]:
        """A checkpoint's identity, see `Manifest.identity`, and its part; see `read_checkpoint`."""
        manifest, parts = self._load({part: template}, step)
        return manifest.identity, parts[part]

    def read_state(self, template: Tree) -> tuple[Counters, Tree]:
        """Counters and whole state of the newest usable checkpoint; see `read_checkpoint`."""
        manifest, state = self._load(template)
        return manifest.counters, state

    @property
    def has_checkpoints(self) -> bool:
        """Whether there are checkpoints, which may be damaged."""
        return bool(checkpoint.find(self.checkpoints))

    def newest_manifest(self) -> Manifest | None:
        """Manifest of the newest checkpoint that has one; None if there is no checkpoint."""
        for folder in checkpoint.find(self.checkpoints):
            with contextlib.suppress(InputError):
                return checkpoint.read_manifest(folder)
        return None

    def _load(self, template: Tree, step: int | None = None) -> tuple[Manifest, Tree]:
        config = self.read_config(check_robot=False)
        if step is not None:
            return checkpoint.load(checkpoint.folder_of(self.checkpoints, step), config, template)
        failures: list[InputError] = []
        for folder in checkpoint.find(self.checkpoints):
            try:
                loaded = checkpoint.load(folder, config, template)
            except InputError as error:
                failures.append(error)
                continue
            for failure in failures:
                log.warning("reachlab: %s Used instead: '%s'.", failure, folder)
            return loaded
        raise self._none(failures)

    def _none(self, failures: list[InputError]) -> InputError:
        """Why no checkpoint can be used."""
        missing = f"run directory '{self.path}' holds no checkpoint: its training did not get so far."
        return failures[0] if failures else InputError(missing)
