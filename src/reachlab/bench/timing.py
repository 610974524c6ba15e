"""How times are taken: of a call, and of a whole command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import jax

REPEATS = 10
"""Timed repetitions; the best counts, since other work on the machine can only slow one down."""


def shortest_time(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Shortest time of a call [s], after one that does not count."""
    jax.block_until_ready(call())
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - start)
    return min(times)


def run_command(*words: str, environment: dict[str, str] | None = None) -> tuple[float, Any]:
    """Wall time of `reachlab` with these words [s], and the JSON that it prints."""
    started = time.perf_counter()
    done = subprocess.run(  # noqa: S603 (our own program)
        [sys.executable, "-m", "reachlab", *words, "--json"],
        env={**os.environ, **(environment or {})},
        capture_output=True,
        text=True,
        check=True,
    )
    return time.perf_counter() - started, json.loads(done.stdout)


def command_time(*words: str) -> float:
    """Wall time of any command [s]."""
    started = time.perf_counter()
    subprocess.run(words, check=True, capture_output=True)  # noqa: S603 (our own program)
    return time.perf_counter() - started
