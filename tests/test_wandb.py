"""Weights & Biases, offline: what it keeps of a run, and what is said where it cannot be used."""

from __future__ import annotations

import json
import os
import signal
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any

import pytest

from reachlab.cli import main as cli
from reachlab.envs.presets import configure
from reachlab.learn.interrupts import Interrupted
from reachlab.learn.train import train
from reachlab.runs import wandb_sink
from reachlab.runs.metrics import read_metrics
from reachlab.settings.validation import InputError

wandb = pytest.importorskip("wandb")

EACH = 64
"""Environment steps of an iteration."""

TINY: dict[str, Any] = {
    "num_envs": 8,
    "rollout_steps": 8,
    "total_steps": 4 * EACH,
    "hidden": (8,),
    "report_episodes": 4,
    "max_steps": 20,
}

HEAD, BLOCK, PART = 7, 2**15, 7
"""Of W&B's file [bytes]: its own head, the blocks of LevelDB's log format, and the head of a part of a record."""

WHOLE, LAST = 1, 4
"""Kinds of parts that end a record."""


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A session of W&B without the user's settings, in an empty working directory."""
    for name in [name for name in os.environ if name.startswith("WANDB_")]:
        monkeypatch.delenv(name)
    for name in ("WANDB_CONFIG_DIR", "WANDB_CACHE_DIR", "NETRC"):
        monkeypatch.setenv(name, str(tmp_path / "home" / name))
    monkeypatch.setenv("WANDB_MODE", "offline")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    yield
    wandb.teardown()


def records(file: Path) -> Iterator[Any]:
    """Records of one of W&B's own files."""
    from wandb.proto.wandb_internal_pb2 import Record  # type: ignore[attr-defined]

    data, at, record = file.read_bytes(), HEAD, b""
    while at + PART <= len(data):
        if (left := BLOCK - at % BLOCK) < PART:
            at += left
            continue
        size, kind = struct.unpack_from("<HB", data, at + 4)  # after four bytes of a checksum
        record += data[at + PART : at + PART + size]
        at += PART + size
        if kind in (WHOLE, LAST):
            yield Record.FromString(record)
            record = b""


@dataclass
class Kept:
    """What one of W&B's files holds, without W&B's own numbers."""

    run: Any = None
    settings: dict[str, Any] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    summary: dict[str, Any] = field(default_factory=dict)


def kept(run: Path) -> list[Kept]:
    """What W&B's files of a run hold, oldest first."""
    found = []
    for file in sorted(run.glob("wandb/offline-run-*/*.wandb")):
        found.append(Kept())
        for record in records(file):
            if record.HasField("run"):
                found[-1].run = record.run
            if record.HasField("history"):
                found[-1].rows.append(values(record.history.item))
            found[-1].settings |= values(record.run.config.update)
            found[-1].summary |= values(record.summary.update)
    return found


def values(items: Any) -> dict[str, Any]:
    found = {".".join(item.nested_key) or item.key: json.loads(item.value_json) for item in items}
    return {name: value for name, value in found.items() if not name.startswith("_")}


def test_wandb_keeps_the_numbers_the_settings_and_the_report(capsys: pytest.CaptureFixture[str]) -> None:
    words = "--num-envs 8 --rollout-steps 8 --total-steps 256 --hidden 8 --report-episodes 4 --max-steps 20"
    assert cli.main(["train", *words.split(), "--wandb", "--json", "--out", "first"]) == cli.DONE
    report = json.loads(capsys.readouterr().out)
    (first,) = kept(Path("first"))
    assert (first.run.project, first.run.display_name) == ("reachlab", "first")
    assert first.rows == read_metrics(Path("first/metrics.jsonl"))
    assert first.settings == json.loads(Path("first/config.json").read_text())
    assert first.summary["report"] == report
    assert [path.name for path in Path().iterdir()] == ["first"], "nothing lies in the working directory"


def test_a_resumed_run_keeps_its_id_and_its_newest_file_holds_every_row_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WANDB_PROJECT", "arms")
    config = configure(**TINY, stop_early=False)
    with pytest.raises(Interrupted):
        train(config, "run", lambda _: os.kill(os.getpid(), signal.SIGINT), sinks=("wandb",))
    with Path("run/metrics.jsonl").open("a") as file:
        file.write(json.dumps({"steps": 2 * EACH}) + "\n")
    train(config, "run", resume=True, sinks=("wandb",))
    before, after = kept(Path("run"))
    rows = read_metrics(Path("run/metrics.jsonl"))
    assert before.run.run_id == after.run.run_id
    assert (before.run.project, after.run.project) == ("arms", "arms")
    assert (before.rows, after.rows) == (rows[:1], rows)
    assert len(rows) == 4


@pytest.mark.slow
def test_a_run_that_wandb_did_not_see_begin_is_logged_from_its_start() -> None:
    config = configure(**TINY, stop_early=False)
    with pytest.raises(Interrupted):
        train(config, "run", lambda _: os.kill(os.getpid(), signal.SIGINT))
    train(config, "run", resume=True, sinks=("wandb",))
    (begun,) = kept(Path("run"))
    assert begun.rows == read_metrics(Path("run/metrics.jsonl"))


def test_disabled_it_does_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WANDB_MODE", "disabled")
    train(configure(**TINY), "run", sinks=("wandb",))
    assert not list(Path("run").glob("**/*.wandb"))


@pytest.mark.parametrize(
    ("variables", "why"),
    [
        ({}, "--wandb needs an API key: run `wandb login`"),
        ({"API_KEY": "short"}, "API key must have 40"),
        ({"MODE": "no"}, "Input should be 'online'"),
        ({"API_KEY": "x" * 40, "BASE_URL": "http://127.0.0.1:9", "HTTP_TIMEOUT": "1"}, "http://127.0.0.1:9"),
    ],
    ids=["no key", "no such key", "no such mode", "no server"],
)
def test_where_wandb_cannot_be_used_one_sentence_says_so_before_anything_is_made(
    monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], why: str
) -> None:
    for name, value in {"MODE": "online", **variables}.items():
        monkeypatch.setenv(f"WANDB_{name}", value)
    with pytest.raises(InputError, match=f"{why}.*set WANDB_MODE=offline, or leave --wandb out") as refusal:
        train(configure(**TINY), "run", sinks=("wandb",))
    assert "\n" not in str(refusal.value)
    assert not list(Path().iterdir())


def test_a_process_of_wandb_that_does_not_end_holds_nothing_up(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"MODE": "online", "API_KEY": "short"}.items():
        monkeypatch.setenv(f"WANDB_{name}", value)
    never, begun = Event(), Event()
    with monkeypatch.context() as patch:
        patch.setattr(wandb, "teardown", lambda: begun.set() or never.wait())
        patch.setattr(wandb_sink, "END_TIMEOUT", 0.01)
        with pytest.raises(InputError, match="API key must have 40"):
            train(configure(**TINY), "run", sinks=("wandb",))
    assert begun.is_set()
    never.set()


def test_without_the_extra_wandb_is_refused_before_anything_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(InputError, match=r"--wandb needs wandb: pip install .*\[wandb\]'"):
        train(configure(**TINY), "run", sinks=("wandb",))
    assert not list(Path().iterdir())
