"""One checkpoint: a folder that holds the training state as named arrays, and a manifest that says what they are.

It is complete or absent: written beside its place, synchronised to the disk, then renamed. Nothing is ever unpickled.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from reachlab.envs.earlier_configs import from_json
from reachlab.runs.earlier_states import FORMAT
from reachlab.runs.files import UNREADABLE, read_json, remove, sync, write_json, write_synced
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import difference
from reachlab.settings.validation import Checked, Count, Fraction, InputError, NonNegative, NonNegativeInt

ARRAYS, MANIFEST = "state.safetensors", "manifest.json"
"""Files of a checkpoint: the training state, and what is known of it."""

ROBOT = "robot.json"
"""File of a run, beside its checkpoints, that holds the hash of the files of its arm."""

Tree = TypeVar("Tree")


@dataclass(frozen=True)
class Counters(Checked):
    """Where a training stands, beside its arrays."""

    steps: NonNegativeInt
    """Environment steps taken."""
    streak: NonNegativeInt = 0
    """Validations in a row that reached the success rate that was asked for."""
    success: Fraction = 0.0
    """Success rate of this state's validation, or without one of the last training episodes, see `training_success`."""
    validated: bool = False
    """Whether `success` is of a validation."""
    next_validation: NonNegativeInt = 0
    """Steps before which none is due, since the last one was far from it."""
    training_success: Fraction = 0.0
    """Success rate of the last training episodes that were enough to tell one."""
    episodes: NonNegativeInt = 0
    """Training episodes since then."""
    successes: NonNegativeInt = 0
    """Those of them that ended in success."""
    loop_s: NonNegative = 0.0
    """Time of the iterations so far, with validations [s]."""
    busy_s: NonNegative = 0.0
    """Time of collecting and updating so far [s]."""
    train_s: NonNegative = 0.0
    """Time of training so far, with compilation [s]."""


@dataclass(frozen=True)
class Manifest(Checked):
    """What is known of a checkpoint."""

    format: int
    counters: Counters
    config: dict[str, Any]
    threads: Count
    """Threads that JAX computed with: only with the same number does training repeat bit for bit."""
    versions: dict[str, str]
    sizes: dict[str, int]
    sha256: dict[str, str]

    @property
    def identity(self) -> dict[str, Any]:
        """What names the checkpoint in a report: its environment steps and the SHA-256 of its arrays."""
        return {"steps": self.counters.steps, "sha256": self.sha256[ARRAYS]}


def seal(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """A manifest in its plain form, with the checksum of all that it says."""
    said = {name: value for name, value in manifest.items() if name != "seal"}
    return said | {"seal": hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()}


# --- among others ---------------------------------------------------------------------------------


def folder_of(checkpoints: Path, step: int) -> Path:
    """Folder of the checkpoint after `step` environment steps."""
    return checkpoints / f"step_{step:012d}"


def find(checkpoints: Path) -> list[Path]:
    """Folders of checkpoints, the newest first; they may be damaged."""
    return sorted((p for p in checkpoints.glob("step_*") if re.fullmatch(r"step_\d{12}", p.name)), reverse=True)


def clean(checkpoints: Path) -> None:
    """Remove what interrupted saves have left."""
    for left in checkpoints.glob(".step_*"):
        remove(left)


def prune(checkpoints: Path, keep: int, step: int) -> None:
    """Remove all checkpoints but the newest `keep` up to that of `step`, which was written just now, and the best.

    Those of later steps were damaged, else training would have gone on from them: they count for nothing, and stay.
    """
    found = find(checkpoints)
    best = max(found, key=_rank, default=None)
    for folder in [folder for folder in found if folder <= folder_of(checkpoints, step)][keep:]:
        if folder != best:
            # Out of sight first: half a checkpoint is never there under its name.
            remove(folder.rename(folder.with_name(f".{folder.name}.tmp")))


def _rank(folder: Path) -> tuple[bool, bool, float]:
    """Order from worse to better: damaged, judged by training episodes, judged by a validation; then by success."""
    try:
        manifest = read_manifest(folder)
        whole = all((folder / name).stat().st_size == size for name, size in manifest.sizes.items())
    except (InputError, OSError):
        return False, False, 0.0
    return whole, whole and manifest.counters.validated, whole * manifest.counters.success


# --- writing --------------------------------------------------------------------------------------


def write(checkpoints: Path, state: object, counters: Counters, config: dict[str, Any]) -> None:
    """Save a pytree of arrays, and a run's configuration in its plain form.

    Raises:
        OSError, InputError: it cannot be written; what was there is as it was.
    """
    final = folder_of(checkpoints, counters.steps)
    temporary = final.with_name(f".{final.name}.tmp")
    try:
        clean(checkpoints)
        _fill(temporary, state, counters, config)
        _put(temporary, final)
    except OSError:
        with contextlib.suppress(OSError):
            remove(temporary)
        raise


def _fill(folder: Path, state: object, counters: Counters, config: dict[str, Any]) -> None:
    from reachlab.jax_setup import threads
    from reachlab.runs.arrays import to_bytes
    from reachlab.runs.provenance import versions

    data = to_bytes(state)
    folder.mkdir()
    write_synced(folder / ARRAYS, data)
    manifest = Manifest(
        format=FORMAT,
        counters=counters,
        config=config,
        threads=threads(),
        versions=versions(),
        sizes={ARRAYS: len(data)},
        sha256={ARRAYS: hashlib.sha256(data).hexdigest()},
    )
    write_json(folder / MANIFEST, seal(asdict(manifest)))


def _put(temporary: Path, final: Path) -> None:
    """Give a checkpoint that is complete its name; an earlier one of the same step is replaced."""
    old = final.with_name(f".{final.name}.old")
    if final.exists():
        final.rename(old)
    temporary.rename(final)
    remove(old)
    sync(final.parent)


# --- reading --------------------------------------------------------------------------------------


def load(folder: Path, config: RunConfig, template: Tree) -> tuple[Manifest, Tree]:
    """Manifest and arrays of a checkpoint, these in the shape of `template`; other arrays are not loaded.

    Raises:
        InputError: it is damaged, or does not fit the configuration or the template.
    """
    from reachlab.runs import arrays

    manifest = verify(folder, config)
    with _damage_told(folder):
        return manifest, arrays.load(folder / ARRAYS, template, manifest.format)


def verify(folder: Path, config: RunConfig) -> Manifest:
    """Manifest of a checkpoint that is whole and of a run with this configuration.

    Raises:
        InputError: it is not.
    """
    from reachlab.runs import arrays

    manifest = read_manifest(folder)
    with _damage_told(folder):
        saved = from_json(manifest.config)
    hashed = (folder.parents[1] / ROBOT).is_file()  # then a file may lie elsewhere now: the arm is told by its hash
    if hashed and Path(saved.robot).suffix and Path(config.robot).suffix:
        saved = replace(saved, robot=config.robot, package=config.package)
    if other := difference(config, saved):
        raise InputError(
            f"checkpoint '{folder}' does not fit the run's configuration: {other[0]} is {other[2]!r} in the checkpoint"
            f" and {other[1]!r} in the run."
        )
    with _damage_told(folder):
        if arrays.digest(folder / ARRAYS, manifest.sizes[ARRAYS]) != manifest.sha256[ARRAYS]:
            raise InputError("its checksum does not fit")
    return manifest


def read_manifest(folder: Path) -> Manifest:
    """A checkpoint's manifest.

    Raises:
        InputError: it is damaged, of another format or of another checkpoint.
    """
    if folder.is_symlink() or not folder.is_dir():
        raise InputError(f"checkpoint '{folder}' is damaged: it is not a directory.")
    data = read_json(folder / MANIFEST)
    with _damage_told(folder):
        if data != seal(data):
            raise InputError("its manifest was changed")
        del data["seal"]
        manifest = Manifest(**(data | {"counters": Counters(**data["counters"])}))
    if not 1 <= manifest.format <= FORMAT:
        raise InputError(f"checkpoint '{folder}' has format {manifest.format}, this version reads 1 to {FORMAT}.")
    if folder != folder_of(folder.parent, manifest.counters.steps):
        raise InputError(f"checkpoint '{folder}' is damaged: it is that of step {manifest.counters.steps:,}.")
    return manifest


@contextlib.contextmanager
def _damage_told(folder: Path) -> Iterator[None]:
    """Say of errors inside that the checkpoint is damaged, and how."""
    try:
        yield
    except InputError as error:
        raise InputError(f"checkpoint '{folder}' is damaged: {str(error).rstrip('.')}.") from None
    except UNREADABLE:
        raise InputError(f"checkpoint '{folder}' is damaged: it cannot be read.") from None
