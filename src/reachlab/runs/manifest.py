"""What is known of a checkpoint beside its arrays, sealed by a checksum of its own."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from reachlab.runs.files import read_json
from reachlab.settings.validation import Checked, Count, Fraction, InputError, NonNegative, NonNegativeInt

FORMAT = 1
"""Version of the checkpoint format."""

ARRAYS, MANIFEST = "state.safetensors", "manifest.json"
"""Files of a checkpoint: the training state, and what is known of it."""


@dataclass(frozen=True)
class Counters(Checked):
    """Where a training stands, beside its arrays."""

    steps: NonNegativeInt
    """Environment steps taken."""
    streak: NonNegativeInt = 0
    """Validations in a row that have held."""
    success: Fraction = 0.0
    """Success rate of this state's validation, or without one of the last training episodes, see `training_success`."""
    validated: bool = False
    """Whether `success` is of a validation."""
    training_success: Fraction = 0.0
    """Success rate of the last training episodes that were enough to say one."""
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
    counters: dict[str, Any]
    config: dict[str, Any]
    threads: Count
    """Threads that JAX computed with: bit for bit it goes on only with the same number."""
    versions: dict[str, str]
    sizes: dict[str, int]
    sha256: dict[str, str]

    @property
    def identity(self) -> dict[str, Any]:
        """What names the checkpoint in a report: its environment steps and the SHA-256 of its arrays."""
        return {"steps": Counters(**self.counters).steps, "sha256": self.sha256[ARRAYS]}

    @property
    def rank(self) -> tuple[bool, float]:
        """Order of checkpoints from worse to better: a validation counts for more than training episodes."""
        counters = Counters(**self.counters)
        return counters.validated, counters.success


def seal(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """A manifest with the checksum of all that it says."""
    said = {name: value for name, value in manifest.items() if name != "seal"}
    return said | {"seal": hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()}


def read_manifest(folder: Path) -> Manifest:
    """A checkpoint's manifest.

    Raises:
        InputError: it is damaged, of another format or of another checkpoint.
    """
    if folder.is_symlink() or not folder.is_dir():
        raise InputError(f"checkpoint '{folder}' is damaged: it is no directory.")
    data = read_json(folder / MANIFEST)
    try:
        if data != seal(data):
            raise InputError("its manifest was changed")
        manifest = Manifest(**{name: value for name, value in data.items() if name != "seal"})
        counters = Counters(**manifest.counters)
    except (AttributeError, TypeError, InputError) as error:
        why = str(error).rstrip(".") if isinstance(error, InputError) else "its manifest is none"
        raise InputError(f"checkpoint '{folder}' is damaged: {why}.") from None
    if manifest.format != FORMAT:
        raise InputError(f"checkpoint '{folder}' has format {manifest.format}, this version reads {FORMAT}.")
    if folder.name != f"step_{counters.steps:012d}":
        raise InputError(f"checkpoint '{folder}' is damaged: it is that of step {counters.steps:,}.")
    return manifest
