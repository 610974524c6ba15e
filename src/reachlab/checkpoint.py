"""The run directory, the only thing that one command hands to the next. Nothing in it is ever unpickled."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
import safetensors.numpy
from safetensors import SafetensorError

from reachlab.config import InputError, RunConfig, from_json, to_json
from reachlab.evaluation import versions

FORMAT = 1
"""Version of the checkpoint format."""

Tree = TypeVar("Tree")


class RunDirectory:
    """Paths, and writing and reading, of one run."""

    def __init__(self, path: Path) -> None:
        """Run directory at `path`, which need not exist."""
        self.path = path
        self.config_file = path / "config.json"
        self.metrics_file = path / "metrics.jsonl"
        self.report_file = path / "report.json"
        self.curve_file = path / "curve.png"
        self.checkpoints = path / "checkpoints"
        self.reports = path / "reports"

    def create(self, config: RunConfig) -> None:
        """Make the directory and write the configuration, the first of all files.

        Raises:
            InputError: it exists, or cannot be made.
        """
        try:
            self.path.mkdir(parents=True)
        except FileExistsError:
            raise InputError(
                f"run directory '{self.path}' exists and is not overwritten: name another with --out."
            ) from None
        except OSError as error:
            raise InputError(f"run directory '{self.path}' cannot be made: {error.strerror}.") from None
        write_json(self.config_file, to_json(config))

    def read_config(self) -> RunConfig:
        """The run's configuration.

        Raises:
            InputError: no such run, or a configuration that is not one.
        """
        if not self.path.is_dir():
            raise InputError(
                f"run directory '{self.path}' does not exist: train one with `reachlab train --out {self.path}`."
            )
        data = _read_json(self.config_file)
        try:
            return from_json(data)
        except InputError as error:
            raise InputError(f"'{self.config_file}' is not usable: {error}") from None

    def write_checkpoint(self, step: int, state: object) -> None:
        """Save a pytree of arrays; a directory `step_<step>` is complete or absent."""
        final = self._checkpoint(step)
        temporary = self.checkpoints / f".{final.name}.tmp"
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        data = safetensors.numpy.save(_flatten(state))
        _write_synced(temporary / "state.safetensors", data)
        manifest = {
            "format": FORMAT,
            "step": step,
            "sha256": {"state.safetensors": hashlib.sha256(data).hexdigest()},
            "versions": versions(),
        }
        write_json(temporary / "manifest.json", manifest)
        temporary.rename(final)
        _sync(self.checkpoints)

    def checkpoint_steps(self) -> list[int]:
        """Steps of the checkpoints, oldest first.

        Raises:
            InputError: there is none.
        """
        found = sorted(int(path.name.removeprefix("step_")) for path in self.checkpoints.glob("step_*"))
        if not found:
            raise InputError(f"run directory '{self.path}' holds no checkpoint: its training did not get so far.")
        return found

    def read_checkpoint(self, part: str, template: Tree, step: int | None = None) -> Tree:
        """The part with that name, in the shape of `template`, of the newest checkpoint or the one after `step`.

        Raises:
            InputError: no checkpoint, a damaged one, or one of another shape.
        """
        checkpoint = self._checkpoint(self.checkpoint_steps()[-1] if step is None else step)
        manifest = _read_json(checkpoint / "manifest.json")
        try:
            data = (checkpoint / "state.safetensors").read_bytes()
            if hashlib.sha256(data).hexdigest() != manifest["sha256"]["state.safetensors"]:
                raise InputError(f"checkpoint '{checkpoint}' is damaged: its checksum does not fit.")
            arrays = safetensors.numpy.load(data)
        except (OSError, SafetensorError, KeyError, TypeError):
            raise InputError(f"checkpoint '{checkpoint}' is damaged: it cannot be read.") from None
        return _unflatten(arrays, part, template, checkpoint)

    def _checkpoint(self, step: int) -> Path:
        return self.checkpoints / f"step_{step:012d}"

    def write_report(self, name: str, report: Mapping[str, Any]) -> None:
        """Save a report among the run's later ones; an earlier one of the same name is replaced."""
        self.reports.mkdir(exist_ok=True)
        write_json(self.reports / f"{name}.json", report)


def write_json(path: Path, data: object) -> None:
    """Write JSON so that the file is the old one or the new one, never half of it."""
    temporary = path.with_name(f".{path.name}.tmp")
    _write_synced(temporary, (json.dumps(data, indent=2) + "\n").encode())
    temporary.rename(path)
    _sync(path.parent)


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"'{path}' is missing: '{path.parent}' is not a complete run.") from None
    except (OSError, ValueError, RecursionError):
        raise InputError(f"'{path}' is not JSON that can be read.") from None


def _write_synced(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _named_leaves(tree: object) -> list[tuple[str, Any]]:
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return [(jax.tree_util.keystr(path, simple=True, separator="/"), leaf) for path, leaf in leaves]


def _is_key(leaf: Any) -> bool:
    return jax.numpy.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _flatten(tree: object) -> dict[str, np.ndarray]:
    return {
        name: np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf, order="C")
        for name, leaf in _named_leaves(tree)
    }


def _unflatten(arrays: Mapping[str, np.ndarray], part: str, template: Tree, where: Path) -> Tree:
    leaves = []
    for name, like in _named_leaves({part: template}):
        array = arrays.get(name)
        wanted = jax.eval_shape(jax.random.key_data, like) if _is_key(like) else like
        if array is None or array.shape != wanted.shape or array.dtype != wanted.dtype:
            raise InputError(f"checkpoint '{where}' does not fit the run's configuration at {name!r}.")
        leaves.append(jax.random.wrap_key_data(jax.numpy.asarray(array)) if _is_key(like) else jax.numpy.asarray(array))
    return jax.tree.unflatten(jax.tree.structure(template), leaves)
