"""The programs that a first training compiles, and how long each takes; commands with nothing compiled, and again."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from reachlab.bench.table import Row, row

TASKS = ("tutorial", "precise", "clutter", "push", "lift")
"""Tasks whose trainings are looked at: of one iteration."""

LONG = 0.1
"""Programs that take less altogether are summed up [s]."""

SAID = {
    "trace": re.compile(r"Finished tracing (\S+) for jit in ([\d.e-]+)"),
    "lower": re.compile(r"Finished jaxpr to MLIR module conversion (?:jit\()?([^ )]+)\)? in ([\d.e-]+)"),
    "compile": re.compile(r"Finished XLA compilation of (?:jit\()?([^ )]+)\)? in ([\d.e-]+)"),
}
"""What JAX says of a program. Where functions are traced within each other, or at once, their times overlap."""


def programs() -> Iterator[Row]:
    """Of each task the programs of a training, with an empty cache and with a full one."""
    for task in TASKS:
        with tempfile.TemporaryDirectory() as folder:
            for cache in ("cold", "warm"):
                yield from _programs(task, cache, Path(folder))


def _programs(task: str, cache: str, folder: Path) -> Iterator[Row]:
    words = ("train", "--task", task, "--total-steps", "1", "--no-stop-early", "--report-episodes", "100")
    done = subprocess.run(  # noqa: S603 (our own program)
        [sys.executable, "-m", "reachlab", *words, "--out", str(folder / cache)],
        env={**os.environ, "JAX_COMPILATION_CACHE_DIR": str(folder / "cache"), "JAX_LOG_COMPILES": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    took: dict[str, dict[str, float]] = {}
    for stage, said in SAID.items():
        for name, seconds in said.findall(done.stderr):
            of_program = took.setdefault(name, dict.fromkeys(SAID, 0.0))
            of_program[stage] += float(seconds)
    for name, stages in sorted(took.items(), key=lambda one: -sum(one[1].values())):
        if sum(stages.values()) >= LONG:
            yield row(f"{task}/{cache}/{name}", sum(stages.values()), "s", **stages)
    together = {stage: sum(stages[stage] for stages in took.values()) for stage in SAID}
    yield row(f"{task}/{cache}/all", sum(together.values()), "s", programs=len(took), **together)
