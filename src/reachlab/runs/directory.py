"""The run directory, the only thing that one command hands to the next. Nothing in it is ever unpickled."""

from __future__ import annotations

import contextlib
import glob
import hashlib
import json
import logging
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from reachlab.runs.files import read_json, remove, sync, write_json, write_synced, write_whole
from reachlab.runs.lock import in_turn, refuse_if_held
from reachlab.runs.manifest import ARRAYS, FORMAT, MANIFEST, Counters, Manifest, read_manifest, seal
from reachlab.settings.config import RunConfig
from reachlab.settings.plain import difference, from_json, to_json
from reachlab.settings.validation import InputError

KEEP = 3
"""Newest checkpoints that are kept, unless said otherwise."""

REPORT = "report"
"""Name under which a file of episodes holds their report, as JSON in its metadata."""

Tree = TypeVar("Tree")
T = TypeVar("T")

log = logging.getLogger(__name__)


class RunDirectory:
    """Paths, and writing and reading, of one run."""

    def __init__(self, path: Path) -> None:
        """Run directory at `path`, which need not exist."""
        self.path = path
        self.config_file = path / "config.json"
        self.metrics_file = path / "metrics.jsonl"
        self.report_file = path / "report.json"
        self.curve_file = path / "curve.png"
        self.offending_file = path / "not_finite.safetensors"
        self.checkpoints = path / "checkpoints"
        self.reports = path / "reports"

    def create(self, config: RunConfig) -> None:
        """Make the directory with the configuration in it, the first of all files.

        Raises:
            InputError: it exists, or cannot be made.
        """
        self.refuse_existing()
        temporary = None
        try:
            temporary = self.path.with_name(f".{self.path.name}.{os.getpid()}.tmp")
            temporary.mkdir(parents=True)
            write_json(temporary / self.config_file.name, to_json(config))
            os.rename(temporary, self.path)  # noqa: PTH104 (see `storage`)
            sync(self.path.parent)
        except (OSError, ValueError) as error:  # a ValueError where the path has no name, as '.' in a removed folder
            if temporary:
                with contextlib.suppress(OSError):
                    remove(temporary)
            why = error.strerror if isinstance(error, OSError) else error
            raise InputError(f"run directory '{self.path}' cannot be made: {why}.") from None

    def refuse_existing(self) -> None:
        """Refuse a path at which something is.

        Raises:
            InputError: something is there, or that cannot be found out.
        """
        try:
            taken = self.path.exists() or self.path.is_symlink()
        except OSError as error:
            raise InputError(f"run directory '{self.path}' cannot be made: {error.strerror}.") from None
        if taken:
            refuse_if_held(self.path)
            raise InputError(f"run directory '{self.path}' exists and is not overwritten: name another with --out.")

    def read_config(self) -> RunConfig:
        """The run's configuration.

        Raises:
            InputError: no such run, or a configuration that is not one.
        """
        if not self.path.is_dir():
            raise InputError(
                f"run directory '{self.path}' does not exist: train one with `reachlab train --out {self.path}`."
            )
        data = read_json(self.config_file)
        try:
            return from_json(data)
        except InputError as error:
            raise InputError(f"'{self.config_file}' is not usable: {error}") from None

    def read_unfinished(self, config: RunConfig) -> None:
        """Make sure that a run can be gone on with in these settings.

        Raises:
            InputError: no such run, one of other settings, or another process trains it.
        """
        if other := difference(self.read_config(), config):
            raise InputError(
                f"run '{self.path}' was begun with {other[0]} {other[1]!r} and cannot go on with {other[2]!r}:"
                f" leave the setting out, or train a new run with --out."
            )
        refuse_if_held(self.path)

    @property
    def finished(self) -> bool:
        """Whether training has come to its report."""
        return self.report_file.is_file()

    # --- checkpoints ------------------------------------------------------------------------------

    def write_checkpoint(self, step: int, state: object, counters: Counters | None = None, keep: int = KEEP) -> None:
        """Save a pytree of arrays; a directory `step_<step>` is complete or absent.

        Afterwards the newest `keep` are there, and the best of all.

        Raises:
            OSError, InputError: it cannot be written; what was there is as it was.
        """
        final = self._checkpoint(step)
        temporary = self.checkpoints / f".{final.name}.tmp"
        try:
            self.checkpoints.mkdir(exist_ok=True)
            self.clean()
            self._fill(temporary, state, counters or Counters(step))
            _put(temporary, final)
        except OSError:
            with contextlib.suppress(OSError):
                remove(temporary)
            raise
        with contextlib.suppress(OSError):
            self._prune(keep)

    def checkpoint_steps(self) -> list[int]:
        """Steps of the checkpoints that are whole, oldest first; others are named in a warning.

        Raises:
            InputError: no checkpoint, or none that is whole.
        """
        steps, failures = [], []
        for folder in self._found():
            try:
                self._verify(folder)
            except InputError as error:
                failures.append(error)
            else:
                steps.append(int(folder.name.removeprefix("step_")))
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

        def load(folder: Path) -> tuple[dict[str, Any], Tree]:
            loaded = self._load(folder, part, template)
            return read_manifest(folder).identity, loaded

        return self._newest(load) if step is None else load(self._checkpoint(step))

    def read_state(self, template: Tree) -> tuple[Counters, Tree]:
        """Counters and whole state of the newest usable checkpoint; see `read_checkpoint`."""

        def load(folder: Path) -> tuple[Counters, Tree]:
            parts = {name: self._load(folder, name, part) for name, part in vars(template).items()}
            return Counters(**read_manifest(folder).counters), type(template)(**parts)

        return self._newest(load)

    def newest_manifest(self) -> Manifest | None:
        """Manifest of the newest checkpoint that has one; None if there is no checkpoint."""
        for folder in self._found():
            with contextlib.suppress(InputError):
                return read_manifest(folder)
        return None

    def clean(self) -> None:
        """Remove what saves that were cut off have left."""
        for left in self.checkpoints.glob(".step_*"):
            remove(left)

    def _checkpoint(self, step: int) -> Path:
        return self.checkpoints / f"step_{step:012d}"

    def _found(self) -> list[Path]:
        """Checkpoints, the newest first."""
        return sorted(
            (p for p in self.checkpoints.glob("step_*") if re.fullmatch(r"step_\d{12}", p.name)), reverse=True
        )

    def _newest(self, load: Callable[[Path], T]) -> T:
        failures: list[InputError] = []
        for folder in self._found():
            try:
                loaded = load(folder)
            except InputError as error:
                failures.append(error)
                continue
            for failure in failures:
                log.warning("reachlab: %s Used instead: '%s'.", failure, folder)
            return loaded
        raise self._none(failures)

    def _none(self, failures: Sequence[InputError]) -> InputError:
        """Why no checkpoint can be used."""
        missing = InputError(f"run directory '{self.path}' holds no checkpoint: its training did not get so far.")
        return next(iter(failures), missing)

    def _load(self, folder: Path, part: str, template: Tree) -> Tree:
        from reachlab.runs import arrays

        self._verify(folder)
        try:
            return arrays.load(folder / ARRAYS, part, template)
        except InputError as error:
            raise InputError(f"checkpoint '{folder}' {error}.") from None
        except arrays.UNREADABLE:
            raise InputError(f"checkpoint '{folder}' is damaged: it cannot be read.") from None

    def _verify(self, folder: Path) -> None:
        """Make sure that a checkpoint is whole and of this run.

        Raises:
            InputError: it is not.
        """
        from reachlab.runs import arrays

        manifest, file = read_manifest(folder), folder / ARRAYS
        if other := difference(self.read_config(), _saved_config(manifest, folder)):
            raise InputError(
                f"checkpoint '{folder}' does not fit the run's configuration: {other[0]} is {other[2]!r} there and"
                f" {other[1]!r} in '{self.config_file}'."
            )
        try:
            if arrays.digest(file, manifest.sizes[ARRAYS]) != manifest.sha256[ARRAYS]:
                raise InputError("its checksum does not fit")
        except InputError as error:
            raise InputError(f"checkpoint '{folder}' is damaged: {error}.") from None
        except arrays.UNREADABLE:
            raise InputError(f"checkpoint '{folder}' is damaged: it cannot be read.") from None

    def _fill(self, folder: Path, state: object, counters: Counters) -> None:
        from reachlab.jax_setup import threads
        from reachlab.runs.arrays import to_bytes
        from reachlab.runs.versions import versions

        data = to_bytes(state)
        os.mkdir(folder)  # noqa: PTH102 (see `storage`)
        write_synced(folder / ARRAYS, data)
        manifest = Manifest(
            format=FORMAT,
            counters=asdict(counters),
            config=read_json(self.config_file),
            threads=threads(),
            versions=versions(),
            sizes={ARRAYS: len(data)},
            sha256={ARRAYS: hashlib.sha256(data).hexdigest()},
        )
        write_json(folder / MANIFEST, seal(vars(manifest)))

    def _prune(self, keep: int) -> None:
        older = self._found()[keep:]
        best = max(self._found(), key=_rank, default=None)
        for folder in older:
            if folder != best:
                # Out of sight first: half of a checkpoint is never seen.
                hidden = folder.with_name(f".{folder.name}.tmp")
                os.rename(folder, hidden)  # noqa: PTH104
                remove(hidden)

    def write_report(self, name: str, report: Mapping[str, Any], episodes: Mapping[str, Any]) -> None:
        """Save a report among the run's later ones, and arrays `[N, ...]` with a row for each of its episodes.

        Earlier ones of the same name are replaced. Each file is whole at every moment, and whoever writes a name later
        replaces both files of it. The file of the episodes holds the report that they belong to as well, so that who
        reads it alone never mixes two evaluations.

        Raises:
            InputError: they cannot be written.
        """
        from reachlab.runs.arrays import to_bytes

        try:
            self.reports.mkdir(exist_ok=True)
            with in_turn(self.reports):
                for left in self.reports.glob(f".{glob.escape(name)}.*.tmp"):  # of a writer that was killed
                    remove(left)
                rows = to_bytes(dict(episodes), {REPORT: json.dumps(report)})
                write_whole(self.reports / f"{name}.safetensors", rows)
                write_json(self.reports / f"{name}.json", report)
        except OSError as error:
            raise InputError(f"report '{self.reports / name}.json' cannot be written: {error.strerror}.") from None


def _put(temporary: Path, final: Path) -> None:
    """Show a checkpoint that is complete; one of the same step gives way."""
    if final.exists():
        old = final.with_name(f".{final.name}.old")
        os.rename(final, old)  # noqa: PTH104
        os.rename(temporary, final)  # noqa: PTH104
        remove(old)
    else:
        os.rename(temporary, final)  # noqa: PTH104
    sync(final.parent)


def _saved_config(manifest: Manifest, folder: Path) -> RunConfig:
    try:
        return from_json(manifest.config)
    except InputError as error:
        raise InputError(f"checkpoint '{folder}' is damaged: {error}") from None


def _rank(folder: Path) -> tuple[int, tuple[bool, float]]:
    """Order of checkpoints from worse to better; one that cannot be read is worse than any, a later one better."""
    try:
        return 1, read_manifest(folder).rank
    except InputError:
        return 0, (False, 0.0)
