"""Sweeps whose trainings, or which themselves, are killed: nothing is lost, doubled or different."""

from __future__ import annotations

import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from faults.saves import Trial

SPACE = "[space]\nlearning_rate = { low = 1e-4, high = 1e-2, log = true }\ngamma = { low = 0.9, high = 0.99 }\n"
"""Settings that vary."""

CHECKPOINTS = ("--checkpoint-interval", "0.5")
"""Saved often, so that a training that is killed again and again gets on."""

TIMEOUT = 1200.0
"""Time in which a sweep has to end [s]."""


def killed_workers(engine: str, duration_s: float, interval_s: float, trials: int, steps: int) -> Trial:
    """Kill a random training of a sweep every so many seconds, then look at every trial.

    Each has to end, those that were finished must stay as they were, and each has to have the weights of a training
    that nobody disturbed.
    """
    chance, wrong, kills = random.Random(0), [], 0
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "sweep"
        command = _command(Path(place), out, trials, steps, "--engine", engine)
        with _started(command, Path(place)) as process:
            begun, finished = time.monotonic(), dict[Path, str]()
            while process.poll() is None and time.monotonic() - begun < TIMEOUT:
                time.sleep(interval_s)
                finished = {**_fingerprints(out), **finished}  # what was finished first counts
                victims = list(_trainings(process.pid))
                if victims and time.monotonic() - begun < duration_s:
                    os.kill(chance.choice(victims), signal.SIGKILL)
                    kills += 1
            if process.poll() is None:
                process.kill()
                wrong.append("the sweep did not end")
        wrong += _judged(out, trials)
        wrong += [f"{path} changed" for path, mark in finished.items() if _fingerprints(out).get(path) != mark]
        wrong += _undisturbed(out, Path(place) / "again")
    return Trial(kills, wrong)


def killed_sweeps(kills: int, trials: int, steps: int) -> Trial:
    """Kill a sweep itself so many times, and resume it each time; then look at its trials."""
    chance, wrong = random.Random(1), []
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "sweep"
        command = _command(Path(place), out, trials, steps)
        for _ in range(kills):
            with _started(command, Path(place)) as process:
                until = time.monotonic() + chance.uniform(2.0, 10.0)
                while process.poll() is None and time.monotonic() < until:
                    time.sleep(0.05)
                process.kill()
            if out.exists():
                command = [sys.executable, "-m", "reachlab", "sweep", "--resume", str(out), "--trials", str(trials)]
        with _started(command, Path(place)) as process:
            if process.wait(TIMEOUT):
                wrong.append("the resumed sweep failed")
        wrong += _judged(out, trials)
        wrong += _undisturbed(out, Path(place) / "again")
    return Trial(kills, wrong)


def _command(place: Path, out: Path, trials: int, steps: int, *more: str) -> list[str]:
    space = place / "space.toml"
    space.write_text(SPACE)
    settings = ["--total-steps", str(steps), "--no-stop-early", "--report-episodes", "100", *CHECKPOINTS]
    asked = ["--trials", str(trials), "--workers", "2", "--out", str(out), "--validations", "0", *more]
    return [sys.executable, "-m", "reachlab", "sweep", str(space), *settings, *asked]


def _started(command: list[str], place: Path) -> subprocess.Popen[bytes]:
    with (place / "said").open("ab") as said:
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=said, stderr=said)


def _trainings(parent: int) -> Iterator[int]:
    """Processes below one that train."""
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            said = (folder / "cmdline").read_bytes()
            ours = _below(int(folder.name), parent)
        except OSError:
            continue
        if ours and (b"reachlab.scale.training" in said or b"ray::run_training" in said):
            yield int(folder.name)


def _below(process: int, parent: int) -> bool:
    while process > 1:
        if process == parent:
            return True
        process = int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[1])
    return False


def _fingerprints(out: Path) -> dict[Path, str]:
    """Of each finished training, what its report and its newest weights are."""
    found = {}
    for report in sorted((out / "trials").glob("*/report.json")):
        newest = max((report.parent / "checkpoints").glob("step_*/state.safetensors"))
        found[report.parent] = hashlib.sha256(report.read_bytes() + newest.read_bytes()).hexdigest()
    return found


def _judged(out: Path, trials: int) -> list[str]:
    """What is wrong with the table of a sweep that has ended."""
    rows = (out / "trials.csv").read_text().splitlines()[1:] if (out / "trials.csv").exists() else []
    numbers = [int(row.split(",")[0]) for row in rows]
    wrong = [] if numbers == list(range(trials)) else [f"trials {numbers} instead of {trials}"]
    wrong += [f"not complete: {row}" for row in rows if row.split(",")[1] != "complete"]
    return wrong + ["trials have other weights than they began with"] * (len(_fingerprints(out)) != trials)


def _undisturbed(out: Path, again: Path) -> list[str]:
    """Trials whose weights are not those of the same settings trained in one go."""
    wrong = []
    for run in sorted(_fingerprints(out)):
        shutil.rmtree(again, ignore_errors=True)
        command = [sys.executable, "-m", "reachlab", "train", "--config", str(run / "config.json")]
        subprocess.run([*command, "--deterministic", "--out", str(again)], check=True, capture_output=True)
        weights = [max(one.glob("checkpoints/step_*/state.safetensors")).read_bytes() for one in (run, again)]
        if weights[0] != weights[1]:
            wrong.append(f"{run.name} has other weights than an undisturbed training")
    return wrong
