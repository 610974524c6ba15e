"""Policies that come with reachlab, one for each arm and task: run directories without the state of training."""

from __future__ import annotations

import os
from pathlib import Path

from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import read_json
from reachlab.settings.validation import InputError, choose

SHIPPED = Path(__file__).parent / "policies"
"""Their folder: one for each arm, with one for each task."""


def shipped() -> dict[str, RunDirectory]:
    """The policies by name, as `panda/precise`; `make policies` trains them again."""
    found = sorted(file.parent for file in SHIPPED.glob("*/*/config.json"))
    return {folder.relative_to(SHIPPED).as_posix(): RunDirectory(folder) for folder in found}


def find_run(run: str | Path) -> RunDirectory:
    """Run directory at a path, or that of a policy which comes with reachlab, by its name.

    Raises:
        InputError: nothing is there, and the name is an arm's, or nearly that of a policy; or it is no path, or that
            of a sweep.
    """
    if not isinstance(run, str | os.PathLike):
        raise InputError(
            f"a run is given by its directory or by a policy's name, as 'runs/first' or 'panda/lift', got"
            f" {type(run).__name__}."
        )
    path = Path(run)
    of_arm = {name: policy for name, policy in shipped().items() if path.parts[:1] == Path(name).parts[:1]}
    if path.exists() or len(path.parts) > 2 or not of_arm:
        directory = RunDirectory(path)
        refuse_sweep(directory)
        return directory
    return of_arm[choose("policy", path.as_posix(), of_arm)]


def refuse_sweep(run: RunDirectory) -> None:
    """Refuse the folder of a sweep, which has settings as that of a run has.

    Raises:
        InputError: it is one.
    """
    if run.sweep_file.is_file():
        raise InputError(f"'{run.path}' is a sweep: its runs are the folders in '{run.path / 'trials'}'.")


def is_shipped(run: RunDirectory) -> bool:
    """Whether a run is one that comes with reachlab: nothing is written into it."""
    return run.path.is_relative_to(SHIPPED)


def told(run: RunDirectory) -> str:
    """What a shipped policy reaches, the command that trained it, and its hash."""
    config, report = run.read_config(), read_json(run.report_file)
    error = report["tracking"] or {f"{name}_mm": value for name, value in report["final_error_mm"].items()}
    return (
        f"{100 * report['success_rate']:.4g} % of {report['episodes']:,} held-out goals of seed {report['seed']}, error"
        f" {error['median_mm']:.2g} mm (median); reachlab train --task {config.task} --robot {config.robot}; sha256"
        f" {report['checkpoint']['sha256'][:16]}"
    )
