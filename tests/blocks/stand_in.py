"""Stands in for `reachlab`, `python` and `pip` in the commands of pages: the same with little to compute."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from importlib.metadata import metadata
from pathlib import Path

from reachlab.cli.console import note

LITTLE = {"--num-envs": "32", "--rollout-steps": "8", "--total-steps": "1"}
"""Flags of a training of one short iteration; 32 environments are enough for two workers."""

FEW = {
    "train": {**LITTLE, "--report-episodes": "4", "--max-steps": "60"},
    "distil": {"--total-steps": "1", "--guided": "0", "--updates": "2", "--report-episodes": "2"},
    "sweep": {**LITTLE, "--report-episodes": "4", "--max-steps": "60", "--trials": "2"},
    "eval": {"--episodes": "4"},
    "video": {"--episodes": "1", "--fps": "4"},
    "deploy": {"--episodes": "1"},
    "view": {"--episodes": "1"},
}
"""Flags that every command of a kind is given, in place of its own."""

REACHLAB = """
import sys
from reachlab.cli.main import main
from reachlab.envs.presets import DISTILLATION
from reachlab.evaluation import episodes
from reachlab.tasks.scenes import bank
bank.TRAINING = bank.HELD_OUT = 8
DISTILLATION["num_envs"] = episodes.BATCH = 16
sys.exit(main())
"""
"""`python -m reachlab`, with few scenes to draw, and few environments and episodes at a time."""

ENDLESS = {("view",): 60.0, ("deploy", "ros2"): 8.0}
"""Commands that run until they are interrupted, and after how long they are at the latest [s]."""

READY = "Ctrl-C ends it"
"""What such a command says when it is ready to be interrupted, if it says anything."""

WRITES = {"--out"}
"""Flags with which `view` writes a page and ends."""


def shortened(words: list[str]) -> list[str]:
    """Words of a `reachlab` command that has little to compute."""
    kind = words[0] if words else ""
    few = dict(FEW.get(kind, {}))
    if "--resume" in words:
        few = {flag: value for flag, value in few.items() if flag == "--trials"}
    if words[:2] == ["deploy", "ros2"] or (kind == "view" and "--out" not in words):
        few = {}
    for flag, value in few.items():
        if flag in words:
            words = [*words[: words.index(flag)], *words[words.index(flag) + 2 :]]
        words = [*words, flag, value]
    return words


def run_reachlab(words: list[str]) -> int:
    """Exit status of a command; a run that it makes replaces one of that name."""
    out = words[words.index("--out") + 1] if "--out" in words[:-1] else ""
    if out and words[0] in ("train", "distil", "sweep", "export"):
        shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, "-c", REACHLAB, *shortened(words)]
    for kind, patience in ENDLESS.items():
        if tuple(words[: len(kind)]) == kind and not WRITES & set(words):
            return _interrupted(command, patience)
    return subprocess.run(command, check=False).returncode


def _interrupted(command: list[str], patience: float) -> int:
    """0 if a command runs until it is interrupted, and ends in order."""
    with tempfile.NamedTemporaryFile() as said:
        process = subprocess.Popen(command, stdout=said, env=os.environ | {"PYTHONUNBUFFERED": "1"})
        end = time.monotonic() + patience
        while process.poll() is None and time.monotonic() < end and READY not in Path(said.name).read_text("utf-8"):
            time.sleep(0.1)
    if process.poll() is not None:
        note("it ended by itself")
        return 1
    process.send_signal(signal.SIGINT)
    return 0 if process.wait(30) in (0, 130) else 1


def run_python(words: list[str]) -> int:
    """Exit status of a Python program; an example learns for few steps."""
    few = ["--steps", "1200"] if words and words[0].startswith("examples/") else []
    return subprocess.run([sys.executable, *words, *few], check=False).returncode


def check_pip(words: list[str]) -> int:
    """0 if what is to be installed is this package with extras that it has; nothing is installed."""
    offered = set(metadata("reachlab").get_all("Provides-Extra") or [])
    found = re.fullmatch(r"(?:\.|reachlab)(?:\[([\w,]+)\])?", words[-1])
    known = (
        words[:2] == ["install", "-e"]
        and found is not None
        and set(filter(None, (found[1] or "").split(","))) <= offered
    )
    if not known:
        note(f"pip {' '.join(words)} names no extra of this package: {', '.join(sorted(offered))}")
    return int(not known)


PROGRAMS = {"reachlab": run_reachlab, "python": run_python, "pip": check_pip}
"""Programs by name, each a function of its words."""


def install(folder: Path) -> None:
    """Write the programs into a folder, for the front of PATH."""
    folder.mkdir()
    for name in PROGRAMS:
        file = folder / name
        file.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m blocks.stand_in {name} "$@"\n', encoding="utf-8")
        file.chmod(0o755)


if __name__ == "__main__":
    sys.exit(PROGRAMS[sys.argv[1]](sys.argv[2:]))
