"""What a person waits for, beside another version: `AGAINST=../before/src python -m benchmarks waiting`."""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import reachlab
from reachlab.bench.table import Row, row
from reachlab.robots.catalogue import ROBOTS

TURNS = int(os.environ.get("TURNS", "7"))
"""How often each is timed. The versions take turns, since these machines change while they are measured."""

FIRST = (
    "import gymnasium, reachlab;"
    "env = gymnasium.make('reachlab/Reach-v0', task='{}'); env.reset(seed=0); env.step(env.action_space.sample())"
)

COMMANDS: dict[str, tuple[str, ...]] = {
    "train": ("-m", "reachlab", "train", "--seed", "0"),
    "train precise": ("-m", "reachlab", "train", "--task", "precise", "--seed", "0"),
    "train track": ("-m", "reachlab", "train", "--task", "track", "--seed", "0"),
    "eval": ("-m", "reachlab", "eval", "panda/precise", "--episodes", "1000"),
    "robot": ("-m", "reachlab", "robot", "arm.xml"),
    "first clutter": ("-c", FIRST.format("clutter")),
    "first push": ("-c", FIRST.format("push")),
    "help": ("-m", "reachlab", "--help"),
    "list": ("-m", "reachlab", "list"),
}
"""Words after `python`, by name."""

ASKED = os.environ.get("COMMANDS", "train;eval;robot;first clutter;first push;help;list").split(";")


def waiting() -> Iterator[Row]:
    """Medians of whole commands, with empty caches and again; beside a version whose `src` is AGAINST, in turns."""
    own = Path(reachlab.__file__).parents[1]
    sources = {"now": own} | ({"before": Path(os.environ["AGAINST"]).resolve()} if "AGAINST" in os.environ else {})
    for name in ASKED:
        took: dict[tuple[str, str], list[float]] = {key: [] for key in product(("cold", "warm"), sources)}
        for _, (version, source) in product(range(TURNS), sources.items()):
            with tempfile.TemporaryDirectory() as folder:
                shutil.copy(ROBOTS["ur5e"].file, Path(folder, "arm.xml"))
                for cache in ("cold", "warm"):
                    took[cache, version].append(_time(COMMANDS[name], source, folder))
        for (cache, version), times in took.items():
            yield row(f"{name}, {cache}/{version}", statistics.median(times), "s", least=min(times), most=max(times))
        for cache in ("cold", "warm") if "before" in sources else ():
            ratios = [now / before for now, before in zip(took[cache, "now"], took[cache, "before"], strict=True)]
            yield row(f"{name}, {cache}/ratio", statistics.median(ratios), "s", least=min(ratios), most=max(ratios))


def _time(words: tuple[str, ...], source: Path, folder: str) -> float:
    """Wall time [s] of a command of the version in `source`, in a folder that holds its caches too."""
    own = {"PYTHONPATH": str(source), "XDG_CACHE_HOME": str(Path(folder, "cache"))}
    started = time.perf_counter()
    subprocess.run([sys.executable, *words], env={**os.environ, **own}, cwd=folder, check=True, capture_output=True)  # noqa: S603 (our own program)
    return time.perf_counter() - started
