"""Files that mean harm: pipes, devices, depths, lies about sizes; none of them may hang, flood or be believed."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from faults.saves import SIZE, Trial, make_run, problem_of, read_run
from reachlab.runs.checkpoint import ARRAYS, MANIFEST, seal
from reachlab.runs.files import read_json
from reachlab.settings.validation import InputError

SLOWEST = 5.0
"""A hostile file is refused within this time [s]."""

MOST_MEMORY = 256 * 2**20
"""Reading hostile files takes at most this much memory [bytes]."""

Damage = Callable[[Path], object]

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
    "a count is huge": _edit("config.json", lambda c: c["ppo"].update(num_envs=HUGE)),
    "a seed is huge": _edit("config.json", lambda c: c.update(seed=HUGE)),
    "a count is negative": _edit("config.json", lambda c: c["ppo"].update(rollout_steps=-1)),
    "a count is a truth": _edit("config.json", lambda c: c["ppo"].update(num_envs=True)),
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
    "the manifest's configuration is empty": _edit(f"{NEWEST}/{MANIFEST}", lambda m: m.update(config={})),
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
            problem = problem_of(run.path, good)
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
        return read_run(folder)[1] == 2
    return False


def _peak_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
