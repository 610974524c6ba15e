"""Reports of evaluations: each is a JSON file, and beside it a file with arrays of its episodes."""

from __future__ import annotations

import glob
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open

from reachlab.runs.files import UNREADABLE, open_plain, remove, write_json, write_whole
from reachlab.runs.lock import in_turn
from reachlab.settings.validation import InputError

REPORT = "report"
"""Name under which a file of episodes holds their report, as JSON in its metadata."""


def write_report(folder: Path, name: str, report: Mapping[str, Any], episodes: Mapping[str, Any]) -> None:
    """Save a report, and arrays `[N, ...]` with a row for each of its episodes.

    Earlier ones of the same name are replaced. Each file is whole at every moment, and whoever writes a name later
    replaces both files of it. The file of the episodes also holds their report, so that a reader never combines two
    evaluations.

    Raises:
        InputError: they cannot be written.
    """
    from reachlab.runs.arrays import to_bytes

    try:
        folder.mkdir(exist_ok=True)
        with in_turn(folder):
            for left in folder.glob(f".{glob.escape(name)}.*.tmp"):  # of a writer that was killed
                remove(left)
            write_whole(folder / f"{name}.safetensors", to_bytes(dict(episodes), {REPORT: json.dumps(report)}))
            write_json(folder / f"{name}.json", report)
    except OSError as error:
        raise InputError(f"report '{folder / name}.json' cannot be written: {error.strerror}.") from None


def read_reports(folder: Path) -> Iterator[tuple[dict[str, Any], dict[str, np.ndarray]]]:
    """Each report whose episodes were kept, with the arrays of these, in the order of their names.

    Of a run's own policy they are those of the newest checkpoint that was evaluated.

    Raises:
        InputError: a file is damaged.
    """
    found = [_read(file) for file in sorted(folder.glob("*.safetensors"))]
    steps = [_steps(report) for report, _ in found]
    newest = max((one for one in steps if one is not None), default=None)
    yield from (one for one, of in zip(found, steps, strict=True) if of in (None, newest))


def _steps(report: dict[str, Any]) -> int | None:
    """Steps after which the policy of a report was saved; None of an agent that is none of a run."""
    checkpoint = report.get("checkpoint")
    return checkpoint.get("steps") if isinstance(checkpoint, dict) else None


def _read(file: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    try:
        os.close(open_plain(file, os.O_RDONLY))  # safetensors would wait for a pipe
        with safe_open(file, framework="numpy") as opened:
            report = dict(json.loads(opened.metadata()[REPORT]))
            return report, {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118 (not a dict)
    except UNREADABLE:
        raise InputError(f"'{file}' is damaged: evaluate again with `reachlab eval`.") from None
