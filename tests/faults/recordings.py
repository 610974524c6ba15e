"""Faults of recordings, made on purpose: processes that are killed while they write a dataset."""

from __future__ import annotations

import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from faults.saves import Trial

EPISODES, KILLS_IN_ONE = 800, 10
"""Episodes of a dataset, and kills after which one is recorded to its end."""

LATEST = 1.0
"""A process is killed at a random moment of this time [s]: after its start, or after it has written a first file."""

POLL = 0.005
"""Time between two looks for that [s]."""

COMMAND = (sys.executable, "-m", "reachlab", "record", "--agent", "ik", "--episodes", str(EPISODES))
COMMAND += ("--cameras", "front", "--size", "32", "--out")
"""What is killed."""


def killed_recordings(count: int, seed: int = 0) -> Trial:
    """Recordings killed again and again, and resumed: what was told as written stays, each episode is there once."""
    draw, wrong, killed, while_writing = random.Random(seed), list[str](), 0, 0
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole"
        subprocess.run([*COMMAND, str(whole)], check=True, capture_output=True)
        while killed < count:
            out, here, told = Path(folder) / f"from-{killed}", 0, list[int]()
            while here < min(KILLS_IN_ONE, count - killed) and _kill(out, draw):
                now = _told(out)
                while_writing += len(now) > len(told)
                wrong += [f"kill {killed + here}: {len(told)} were told, and {len(now)} are left"] * (
                    now[: len(told)] != told
                )
                told, here = now, here + 1
            killed += here
            subprocess.run([*COMMAND, str(out)], check=not (out / "meta" / "info.json").exists(), capture_output=True)
            if _told(out) != list(range(EPISODES)):
                wrong.append(f"{out.name}: {len(_told(out))} episodes, some of them twice")
            if any(not _rows(out, part).equals(_rows(whole, part)) for part in ("data", "meta/episodes")):
                wrong.append(f"{out.name}: other contents")
    if 4 * while_writing < count:
        wrong.append(f"only {while_writing} of {count} had written anything since the kill before")
    return Trial(count, wrong)


def _kill(out: Path, draw: random.Random) -> bool:
    """Record, and end it without a warning, every second time after it has written; whether it was still at work."""
    before, waits = _files(out), draw.random() < 1 / 2
    with subprocess.Popen([*COMMAND, str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        while waits and process.poll() is None and _files(out) == before:
            time.sleep(POLL)
        time.sleep(draw.uniform(0.0, LATEST))
        alive = process.poll() is None
        process.kill()
    return alive


def _files(out: Path) -> int:
    return sum(1 for _ in out.rglob("*.parquet"))


def _told(out: Path) -> list[int]:
    """Numbers of the episodes that a dataset tells of."""
    files = sorted((out / "meta" / "episodes").rglob("*.parquet"))
    return [number for file in files for number in pq.read_table(file)["episode_index"].to_pylist()]


def _rows(out: Path, part: str) -> pa.Table:
    return pa.concat_tables([pq.read_table(file) for file in sorted((out / part).rglob("*.parquet"))])
