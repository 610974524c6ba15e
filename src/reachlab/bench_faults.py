"""Faults of files, made on purpose: saves cut off at every step, damaged and hostile files, disks without room.

Each measurement gives how often the fault was tried and what went wrong, one line each; nothing should.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import resource
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.checkpoint import ARRAYS, MANIFEST, RunDirectory, seal
from reachlab.config import InputError, RunConfig, configure
from reachlab.storage import read_json

CALLS = ("open", "write", "fsync", "close", "mkdir", "rename", "unlink", "rmdir")
"""Calls of the operating system that a save consists of."""

SLOWEST = 1.0
"""A hostile file is refused within this time [s]."""

MOST_MEMORY = 256 * 2**20
"""Reading hostile files takes at most this much memory [bytes]."""

SIZE = 64
"""Numbers in the state of these measurements."""

Damage = Callable[[Path], object]


@dataclass(frozen=True)
class Trial:
    """How often a fault was tried, and what went wrong, a line each."""

    tried: int
    wrong: list[str]


class Crash(BaseException):
    """The process died here."""


def state_of(step: int) -> dict[str, np.ndarray]:
    """State that tells of its step."""
    return {"learner": np.arange(SIZE, dtype=np.float32) + step, "clock": np.array([step])}


def make_run(folder: Path, steps: tuple[int, ...] = (1, 2)) -> RunDirectory:
    """Run with a checkpoint at each of the steps."""
    run = RunDirectory(folder)
    run.create(configure())
    for step in steps:
        run.write_checkpoint(step, state_of(step))
    return run


def _read(folder: Path) -> tuple[RunConfig, int]:
    """Configuration and step of what a run gives; a state that is of no step is a mistake of ours.

    Raises:
        InputError: it gives nothing.
    """
    run = RunDirectory(folder)
    config = run.read_config()
    learner = np.asarray(run.read_checkpoint("learner", np.zeros(SIZE, np.float32)))
    step = int(learner[0])
    if not np.array_equal(learner, state_of(step)["learner"]):
        raise AssertionError("a damaged state was read")
    return config, step


@contextlib.contextmanager
def calls_replaced(around: Callable[[str, Callable[..., Any], tuple[Any, ...], dict[str, Any]], Any]) -> Iterator[None]:
    """Let `around(name, call, arguments, named)` stand for each call of `CALLS`."""
    real = {name: getattr(os, name) for name in CALLS}

    def standing_in(name: str) -> Callable[..., Any]:
        return lambda *arguments, **named: around(name, real[name], arguments, named)

    try:
        for name in CALLS:
            setattr(os, name, standing_in(name))
        yield
    finally:
        for name, call in real.items():
            setattr(os, name, call)


# --- saves that are cut off -----------------------------------------------------------------------


def cut_saves() -> Trial:
    """A save cut off before, after and in the middle of every call: a whole checkpoint is always there."""
    wrong, tried = [], 0
    with tempfile.TemporaryDirectory() as folder:
        original = make_run(Path(folder) / "original", (1, 2, 3)).path
        for number in range(_calls_of_a_save(Path(folder) / "counted", original)):
            for when in ("before", "after", "half of"):
                tried += 1
                copy = Path(folder) / f"{number}-{when}"
                shutil.copytree(original, copy)
                _crash(copy, number, when)
                if problem := _after_crash(copy):
                    wrong.append(f"{when} call {number}: {problem}")
    return Trial(tried, wrong)


def _calls_of_a_save(folder: Path, original: Path) -> int:
    shutil.copytree(original, folder)
    made = []
    with calls_replaced(lambda name, call, arguments, named: (made.append(name), call(*arguments, **named))[1]):
        RunDirectory(folder).write_checkpoint(4, state_of(4), keep=2)
    return len(made)


def _crash(folder: Path, number: int, when: str) -> None:
    """Save until the call of that number; from then on this process is dead and makes no call."""
    made = 0

    def around(name: str, call: Callable[..., Any], arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
        nonlocal made
        made += 1
        if made <= number:
            return call(*arguments, **named)
        if made == number + 1 and when == "after":
            call(*arguments, **named)
        if made == number + 1 and when == "half of" and name == "write":
            call(arguments[0], arguments[1][: len(arguments[1]) // 2])
        raise Crash

    with calls_replaced(around), contextlib.suppress(Crash):
        RunDirectory(folder).write_checkpoint(4, state_of(4), keep=2)


def _after_crash(folder: Path) -> str | None:
    try:
        _, step = _read(folder)
        RunDirectory(folder).write_checkpoint(5, state_of(5))
        _, later = _read(folder)
    except (InputError, OSError, AssertionError) as error:
        return str(error)
    left = [path.name for path in (folder / "checkpoints").glob(".*")]
    return None if step in (3, 4) and later == 5 and not left else f"steps {step} and {later}, left: {left}"


# --- damage ---------------------------------------------------------------------------------------


def corruptions(count: int, seed: int = 0) -> Trial:
    """Random damage of a run's files: refused in one sentence, or the run reads as one of its own states."""
    draw, wrong = random.Random(seed), []  # noqa: S311 (no secret)
    with tempfile.TemporaryDirectory() as folder:
        run = make_run(Path(folder) / "run")
        files = [run.config_file, *sorted(run.checkpoints.glob("*/*"))]
        whole = {file: file.read_bytes() for file in files}
        good = run.read_config()
        for number in range(count):
            damaged = _damage(draw, whole)
            for file, data in damaged.items():
                file.unlink() if data is None else file.write_bytes(data)
            if problem := _problem(run.path, good):
                wrong.append(f"{number}, {[str(file.relative_to(folder)) for file in damaged]}: {problem}")
            for file in damaged:
                file.write_bytes(whole[file])
    return Trial(count, wrong)


def _damage(draw: random.Random, whole: dict[Path, bytes]) -> dict[Path, bytes | None]:
    """One to three files' new content."""
    chosen = draw.sample(list(whole), draw.choice((1, 1, 2, 3)))
    kinds: list[Callable[[bytes], bytes | None]] = [
        lambda data: _with(data, draw.randrange(len(data)), lambda byte: byte ^ (1 << draw.randrange(8))),
        lambda data: _with(data, draw.randrange(len(data)), lambda _: draw.randrange(256)),
        lambda data: data[: draw.randrange(len(data))],
        lambda data: data + draw.randbytes(draw.randrange(1, 99)),
        lambda data: data[: len(data) // 2] + bytes(len(data) - len(data) // 2),
        lambda data: draw.randbytes(len(data)),
        lambda _: whole[draw.choice(list(whole))],
        lambda _: None,
    ]
    return {file: draw.choice(kinds)(whole[file]) for file in chosen}


def _with(data: bytes, place: int, change: Callable[[int], int]) -> bytes:
    return data[:place] + bytes([change(data[place])]) + data[place + 1 :]


def _problem(folder: Path, good: RunConfig) -> str | None:
    try:
        config, step = _read(folder)
    except InputError as error:
        return None if _is_sentence(str(error)) else f"no sentence: {error}"
    except Exception as error:  # whatever else comes out is what is looked for
        return f"{type(error).__name__}: {error}"
    return None if config == good and step in (1, 2) else f"another configuration, or step {step}"


def _is_sentence(text: str) -> bool:
    return "\n" not in text and text.endswith(".")


# --- disks without room ---------------------------------------------------------------------------


@contextlib.contextmanager
def no_space(after: int) -> Iterator[None]:
    """A disk with no room for any write after so many."""
    made = 0

    def around(name: str, call: Callable[..., Any], arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
        nonlocal made
        made += name == "write"
        if name == "write" and made > after:
            raise OSError(28, "No space left on device")
        return call(*arguments, **named)

    with calls_replaced(around):
        yield


@contextlib.contextmanager
def read_only() -> Iterator[None]:
    """A disk that cannot be written to."""

    def around(name: str, call: Callable[..., Any], arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
        if name in ("mkdir", "rename", "unlink", "rmdir", "write"):
            raise OSError(30, "Read-only file system")
        return call(*arguments, **named)

    with calls_replaced(around):
        yield


@contextlib.contextmanager
def file_limit(size: int) -> Iterator[None]:
    """No file may grow beyond `size` [bytes]; the kernel's own limit, whose signal Python ignores."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


FAILING: dict[str, Callable[[], contextlib.AbstractContextManager[None]]] = {
    **{f"no space after {after} writes": lambda after=after: no_space(after) for after in (0, 1)},
    "read only": read_only,
    **{f"no file beyond {size} bytes": lambda size=size: file_limit(size) for size in (0, 1, 100, 400, 1000)},
}
"""Disks on which no checkpoint can be written."""


def failing_saves(count: int) -> Trial:
    """Saves on such disks: refused, earlier checkpoints as they were to the byte, and the next save holds."""
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            name = list(FAILING)[number % len(FAILING)]
            run = make_run(Path(folder) / str(number))
            before = _contents(run.path)
            try:
                with FAILING[name]():
                    run.write_checkpoint(3, state_of(3))
                wrong.append(f"{name}: it was written")
            except OSError as error:
                # On a disk that cannot be written to nothing can be cleared away either.
                run.clean()
                if _contents(run.path) != before or not error.strerror:
                    wrong.append(f"{name}: something changed, or {error!r} does not say why")
            run.write_checkpoint(4, state_of(4))
            if _read(run.path)[1] != 4:
                wrong.append(f"{name}: the next save does not hold")
    return Trial(count, wrong)


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- hostile files --------------------------------------------------------------------------------

NEWEST = "checkpoints/step_000000000002"


def _edit(name: str, change: Callable[[dict[str, Any]], object]) -> Damage:
    """Change a JSON file; a manifest is sealed again, as who means harm would."""

    def damage(run: Path) -> None:
        data = read_json(run / name)
        change(data)
        (run / name).write_text(json.dumps(seal(data) if name.endswith(MANIFEST) else data))

    return damage


def _write(name: str, data: bytes) -> Damage:
    return lambda run: (run / name).write_bytes(data)


def _replace(name: str, make: Callable[[Path], object]) -> Damage:
    """Put something else in a file's or folder's place."""

    def damage(run: Path) -> None:
        path = run / name
        path.rename(run.parent / "aside")
        make(path)

    return damage


def _sparse(size: int) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        with path.open("wb") as file:
            file.truncate(size)

    return make


def _arrays(data: bytes) -> Damage:
    """Put other arrays in place, with a manifest that fits them."""
    import hashlib

    def damage(run: Path) -> None:
        (run / NEWEST / ARRAYS).write_bytes(data)
        fit = {"sizes": {ARRAYS: len(data)}, "sha256": {ARRAYS: hashlib.sha256(data).hexdigest()}}
        _edit(f"{NEWEST}/{MANIFEST}", lambda manifest: manifest.update(fit))(run)

    return damage


def _header(header: bytes, payload: bytes = b"") -> Damage:
    return _arrays(len(header).to_bytes(8, "little") + header + payload)


def _tensor(**fields: Any) -> Damage:
    entry = {"dtype": "F32", "shape": [SIZE], "data_offsets": [0, 4 * SIZE]} | fields
    return _header(json.dumps({"learner": entry}).encode(), bytes(4 * SIZE))


def _stand_ins(name: str) -> dict[str, Damage]:
    """What may stand where a file is expected."""
    return {
        f"{name} is a pipe": _replace(name, os.mkfifo),
        f"{name} is a folder": _replace(name, os.mkdir),
        f"{name} is a link to a device": _replace(name, lambda path: path.symlink_to("/dev/zero")),
        f"{name} is a link to another file": _replace(name, lambda path: path.symlink_to(path.parents[-1] / "etc")),
        f"{name} is a link to itself": _replace(name, lambda path: path.symlink_to(path)),
        f"{name} is enormous": _replace(name, _sparse(2**42)),
        f"{name} is a gigabyte of zeros": _replace(name, _sparse(2**30)),
    }


HUGE = 10**30
DEEP = b"[" * 200_000

HOSTILE: dict[str, Damage] = {
    **_stand_ins("config.json"),
    **_stand_ins(f"{NEWEST}/{MANIFEST}"),
    **_stand_ins(f"{NEWEST}/{ARRAYS}"),
    "the checkpoint is a link": _replace(NEWEST, lambda path: path.symlink_to(path.parent / "step_000000000001")),
    "the checkpoint is a pipe": _replace(NEWEST, os.mkfifo),
    "the configuration is deep": _write("config.json", DEEP),
    "the configuration is deep in objects": _write("config.json", b'{"a":' * 100_000),
    "the configuration is binary": _write("config.json", bytes(range(256))),
    "the configuration is a number of a million digits": _write("config.json", b"9" * 1_000_000),
    "the configuration holds NaN": _edit("config.json", lambda c: c["ppo"].update(gamma=float("nan"))),
    "the configuration holds Infinity": _edit("config.json", lambda c: c["rules"].update(tool_scale=float("inf"))),
    "a count is huge": _edit("config.json", lambda c: c["ppo"].update(lanes=HUGE)),
    "a seed is huge": _edit("config.json", lambda c: c.update(seed=HUGE)),
    "a count is negative": _edit("config.json", lambda c: c["ppo"].update(rollout_steps=-1)),
    "a count is a truth": _edit("config.json", lambda c: c["ppo"].update(lanes=True)),
    "a name is an object": _edit("config.json", lambda c: c.update(robot={"a": 1})),
    "a width is huge": _edit("config.json", lambda c: c["ppo"].update(hidden=[HUGE])),
    "widths are text": _edit("config.json", lambda c: c["ppo"].update(hidden=["64"])),
    "fifty thousand layers": _edit("config.json", lambda c: c["ppo"].update(hidden=[64] * 50_000)),
    "fifty thousand settings": _edit("config.json", lambda c: c.update({f"x{i}": i for i in range(50_000)})),
    "the manifest is deep": _write(f"{NEWEST}/{MANIFEST}", DEEP),
    "the manifest holds NaN": _write(f"{NEWEST}/{MANIFEST}", b'{"format": NaN}'),
    "the manifest is a list": _write(f"{NEWEST}/{MANIFEST}", b"[1]"),
    "the manifest is text": _write(f"{NEWEST}/{MANIFEST}", b'"x"'),
    "the manifest's format is newer": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m.update(format=99)),
    "the manifest's step is huge": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m["counters"].update(steps=HUGE)),
    "the manifest's streak is negative": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m["counters"].update(streak=-1)),
    "the manifest's counters are a list": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m.update(counters=[])),
    "the manifest's threads are text": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m.update(threads="2")),
    "the manifest's size is huge": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m.update(sizes={ARRAYS: HUGE})),
    "the manifest's size is text": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m.update(sizes={ARRAYS: "1"})),
    "the manifest names other files": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m.update(sizes={"../x": 1})),
    "the manifest's configuration is another": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m["config"].update(seed=9)),
    "the manifest's configuration is none": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m.update(config={})),
    "the manifest says more": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m.update(more=1)),
    "the arrays are pickled": _arrays(b"\x80\x04\x95\x10\x00\x00\x00\x00\x00\x00\x00\x8c\x05posix\x94."),
    "the arrays are empty": _arrays(b""),
    "the header is longer than the file": _arrays((2**19).to_bytes(8, "little") + b"{}"),
    "the header is enormous": _arrays((2**63).to_bytes(8, "little") + b"{}"),
    "the header is deep": _header(DEEP),
    "the header is no JSON": _header(b"\xff" * 64),
    "an array is larger than the file": _tensor(shape=[2**40], data_offsets=[0, 2**42]),
    "an array's shape overflows": _tensor(shape=[2**33, 2**33]),
    "an array's offsets are turned round": _tensor(data_offsets=[4 * SIZE, 0]),
    "an array's offsets are negative": _tensor(data_offsets=[-4, 4 * SIZE]),
    "an array's type is unknown": _tensor(dtype="PICKLE"),
    "an array's type is another": _tensor(dtype="I32"),
    "an array has another shape": _tensor(shape=[SIZE // 2, 2]),
    "an array is not finite": _header(
        json.dumps({"learner": {"dtype": "F32", "shape": [SIZE], "data_offsets": [0, 4 * SIZE]}}).encode(),
        np.full(SIZE, np.nan, np.float32).tobytes(),
    ),
}
"""Files that mean harm: each makes the newest checkpoint, or the configuration, unusable."""


def hostile_files() -> Trial:
    """Every hostile file: refused in a sentence or passed over for an older checkpoint, quickly, in little memory."""
    wrong = []
    before = _peak_memory()
    for name, damage in HOSTILE.items():
        with tempfile.TemporaryDirectory() as folder:
            run = make_run(Path(folder) / "run")
            good = run.read_config()
            damage(run.path)
            start = time.perf_counter()
            problem = _problem(run.path, good)
            took = time.perf_counter() - start
            if problem is None and took > SLOWEST:
                problem = f"{took:.1f} s"
            if problem is None and _gives_newest(run.path):
                problem = "it was read"
            if problem:
                wrong.append(f"{name}: {problem}")
    if (used := _peak_memory() - before) > MOST_MEMORY:
        wrong.append(f"{used:,} bytes of memory")
    return Trial(len(HOSTILE), wrong)


def _gives_newest(folder: Path) -> bool:
    with contextlib.suppress(InputError):
        return _read(folder)[1] == 2
    return False


def _peak_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
