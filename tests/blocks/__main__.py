"""Run the commands of README and docs; prints what was run, and what was not and why.

What differs from what a reader does: trainings take one iteration, evaluations have few and short episodes, a sweep has
two trials, an example takes 1,200 steps, what runs until Ctrl-C is interrupted when it is ready, and `pip install` is
checked for the names of its extras. A command that was run before, on another page of the same lane, is not run
again. Whatever is not run is marked on its page, `<!-- not run: why -->` above the block or
`<!-- not run (words): why -->` for the commands with these words, or is in `LEFT_OUT`.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from blocks.pages import ROOT, Block, blocks, fenced, lanes, others
from blocks.stand_in import install
from reachlab.cli.console import say
from reachlab.jax_setup import VARIABLE

PATIENCE = 600
"""Time that a block may take [s]."""


@dataclass
class Tally:
    """What became of the commands of a lane so far."""

    seen: set[str] = field(default_factory=set)
    left_out: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    blocks: int = 0
    without: int = 0


def prepare(folder: Path) -> dict[str, str]:
    """Environment for commands in a folder with what pages speak of: the examples, a robot file, a sweep's space."""
    install(folder / "bin")
    (folder / "examples").symlink_to(ROOT / "examples")
    (folder / "path" / "to").mkdir(parents=True)
    import pybullet_data

    panda = Path(pybullet_data.getDataPath()) / "franka_panda"
    (folder / "path" / "to" / "arm.urdf").write_bytes((panda / "panda.urdf").read_bytes())
    (folder / "path" / "to" / "meshes").symlink_to(panda / "meshes")
    (space,) = fenced((ROOT / "docs" / "scale.md").read_text(encoding="utf-8"), "toml")
    (folder / "space.toml").write_text(space[0], encoding="utf-8")
    paths = {"PATH": f"{folder / 'bin'}:{os.environ['PATH']}", "PYTHONPATH": f"{ROOT / 'src'}:{ROOT / 'tests'}"}
    # One thread: two lanes share the cores.
    return os.environ | paths | {"WANDB_MODE": "offline", "BROWSER": "true", "TF_CPP_MIN_LOG_LEVEL": "3", VARIABLE: "1"}


def run(block: Block, folder: Path, env: dict[str, str], tally: Tally) -> None:
    """Run what is new and not left out of a block, as one script of the shell."""
    tally.blocks += 1
    kept = [command for command in block.commands if block.reason(command) is None]
    tally.without += not kept
    tally.left_out += [f"{block.page}: {c}  ({why})" for c in block.commands if (why := block.reason(c)) is not None]
    new = [command for command in kept if command.partition(" #")[0].strip() not in tally.seen]
    tally.seen |= {command.partition(" #")[0].strip() for command in new}
    script = "\n".join(["set -e", *new])
    begin = time.monotonic()
    said = _fault(["bash", "-c", script], folder, env)
    if said:
        tally.failures.append(f"{block.page}:\n{script}\n{said}")
    say(f"{time.monotonic() - begin:5.1f} s  {block.page}: {new[0] if new else 'nothing new'}")


def _fault(words: list[str], folder: Path, env: dict[str, str]) -> str:
    """What went wrong with a command, in words; nothing if it ended well."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(words, cwd=folder, env=env, stdout=pipe, stderr=pipe, text=True, start_new_session=True)
    try:
        _, errors = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)  # what it has started too
        process.communicate()
        return f"it takes more than {PATIENCE} s"
    return "" if process.returncode == 0 else f"exit status {process.returncode}: {errors[-1500:]}"


def run_lane(pages: Iterable[Path]) -> Tally:
    """What became of the commands of pages, run one after the other in a new folder."""
    tally = Tally()
    with tempfile.TemporaryDirectory() as place:
        env = prepare(Path(place))
        for page in pages:
            for block in blocks(page.name, page.read_text(encoding="utf-8")):
                run(block, Path(place), env, tally)
    return tally


def main(lanes: Sequence[Sequence[Path]], others: Sequence[Path] = ()) -> int:
    """Exit status of running pages in their lanes, and others in the one that is free: 1 where a command fails."""
    left = deque(others)
    with ThreadPoolExecutor(len(lanes)) as pool:
        tallies = list(pool.map(run_lane, [chain(lane, _taken(left)) for lane in lanes]))
    left_out = [line for tally in tallies for line in tally.left_out]
    failures = [line for tally in tallies for line in tally.failures]
    total, without = sum(tally.blocks for tally in tallies), sum(tally.without for tally in tallies)
    commands = set[str]().union(*(tally.seen for tally in tallies))
    computed = resource.getrusage(resource.RUSAGE_CHILDREN)
    say("\n".join(["", *left_out, "", *failures]))
    say(
        f"{total} blocks, {total - without} run, {without} left out as a whole; {len(commands)} different commands run,"
        f" {len(left_out)} left out; {len(failures)} blocks failed."
        f" It took {computed.ru_utime + computed.ru_stime:.0f} s of processor time."
    )
    return int(bool(failures))


def _taken(left: deque[Path]) -> Iterator[Path]:
    """Pages that nobody has taken yet, one whenever it is asked for."""
    with contextlib.suppress(IndexError):  # another lane may take the last one at any moment
        while True:
            yield left.popleft()


if __name__ == "__main__":
    named = [ROOT / word for word in sys.argv[1:]]
    sys.exit(main([named]) if named else main(lanes(), others()))
