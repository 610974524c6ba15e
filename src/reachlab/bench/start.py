"""Suite `start`: wall time of whole commands, with an empty and a warm compilation cache."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from reachlab.bench.table import Row, row
from reachlab.bench.timing import REPEATS, command_time, run_command


def start() -> Iterator[Row]:
    """Wall time of whole commands, with an empty and a warm compilation cache, and whether a run repeats."""
    yield row("help_wall", min(command_time(sys.executable, "-m", "reachlab", "--help") for _ in range(REPEATS)), "s")
    yield row("import_wall", min(command_time(sys.executable, "-c", "import reachlab") for _ in range(REPEATS)), "s")
    yield row("list_wall", min(command_time(sys.executable, "-m", "reachlab", "list") for _ in range(REPEATS)), "s")
    words = ("eval", "iiwa14/tutorial")
    yield row("eval_wall", min(run_command(*words)[0] for _ in range(REPEATS)), "s", episodes=1000)
    with tempfile.TemporaryDirectory() as folder:
        cache = {"JAX_COMPILATION_CACHE_DIR": str(Path(folder) / "cache")}
        weights = []
        for name in ("cold", "warm"):
            out = Path(folder) / name
            wall, result = run_command("train", "--seed", "0", "--out", str(out), environment=cache)
            yield row(f"train_wall/{name}", wall, "s", steps=result["steps"], report_episodes=result["episodes"])
            weights += [file.read_bytes() for file in out.glob("checkpoints/*/state.safetensors")]
        yield row("same_weights", float(weights[0] == weights[1]), "1 = two processes, identical")
