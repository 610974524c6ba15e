"""Faults of files, made on purpose: saves cut off at every step, damaged files, disks without room.

Each measurement gives how often the fault was tried and what went wrong, one line each; nothing should.
"""

from __future__ import annotations

import contextlib
import os
import random
import resource
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.envs.presets import configure
from reachlab.runs.checkpoint import clean
from reachlab.runs.directory import RunDirectory
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError

CALLS = ("open", "write", "fsync", "close", "mkdir", "rename", "replace", "unlink", "rmdir")
"""Calls of the operating system that a save consists of."""

SIZE = 64
"""Numbers in the state of these measurements."""


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
    run.create(configure(seed=3))
    for step in steps:
        run.write_checkpoint(step, state_of(step))
    return run


def read_run(folder: Path) -> tuple[RunConfig, int]:
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
        _, step = read_run(folder)
        RunDirectory(folder).write_checkpoint(5, state_of(5))
        _, later = read_run(folder)
    except (InputError, OSError, AssertionError) as error:
        return str(error)
    left = [path.name for path in (folder / "checkpoints").glob(".*")]
    return None if step in (3, 4) and later == 5 and not left else f"steps {step} and {later}, left: {left}"


# --- damage ---------------------------------------------------------------------------------------


def corruptions(count: int, seed: int = 0) -> Trial:
    """Random damage of a run's files: refused in one sentence, or the run reads as one of its own states."""
    draw, wrong = random.Random(seed), []
    with tempfile.TemporaryDirectory() as folder:
        run = make_run(Path(folder) / "run")
        files = [run.config_file, *sorted(run.checkpoints.glob("*/*"))]
        whole = {file: file.read_bytes() for file in files}
        good = run.read_config()
        for number in range(count):
            damaged = _damage(draw, whole)
            for file, data in damaged.items():
                file.unlink() if data is None else file.write_bytes(data)
            if problem := problem_of(run.path, good):
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


def problem_of(folder: Path, good: RunConfig) -> str | None:
    """What is wrong with how a damaged run reads; None if it is refused in a sentence, or reads as one of its own."""
    try:
        config, step = read_run(folder)
    except InputError as error:
        return None if _is_sentence(str(error)) else f"no sentence: {error}"
    except Exception as error:  # whatever else comes out is the problem
        return f"{type(error).__name__}: {error}"
    return None if config == good and step in (1, 2) else f"another configuration, or step {step}"


def _is_sentence(text: str) -> bool:
    return "\n" not in text and text.endswith((".", "?"))


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
        if name in ("mkdir", "rename", "replace", "unlink", "rmdir", "write"):
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
                clean(run.checkpoints)
                if _contents(run.path) != before or not error.strerror:
                    wrong.append(f"{name}: something changed, or {error!r} does not say why")
            run.write_checkpoint(4, state_of(4))
            if read_run(run.path)[1] != 4:
                wrong.append(f"{name}: the next save does not hold")
    return Trial(count, wrong)


def _contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
