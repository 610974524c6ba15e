"""A run's numbers, and the sinks that get them too."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from extension import Notebook
from reachlab.envs.presets import configure
from reachlab.learn.train import train
from reachlab.runs.metrics import Metrics, read_metrics
from reachlab.runs.sinks import make_sinks
from reachlab.settings.validation import InputError, installing

ROWS = [{"steps": 128, "success_rate": 0.25}, {"steps": 256, "success_rate": 0.5, "validation_success": 0.75}]

Scalars = set[tuple[str, int, float]]


def scalars(folder: Path) -> Scalars:
    """Name, step and value of every scalar in a folder's event file."""
    from tensorboardX.proto.event_pb2 import Event  # type: ignore[attr-defined]
    from tensorboardX.record_writer import masked_crc32c

    [file] = folder.glob("events.out.tfevents.*")
    data, found = file.read_bytes(), set()
    while data:
        # TFRecord: length (8 bytes), its checksum (4), the event, its checksum (4).
        size = int.from_bytes(data[:8], "little")
        assert int.from_bytes(data[8:12], "little") == masked_crc32c(data[:8])
        event = Event.FromString(data[12 : 12 + size])
        found |= {(value.tag, event.step, value.simple_value) for value in event.summary.value}
        data = data[16 + size :]
    return found


def test_rows_are_read_as_they_were_written(tmp_path: Path) -> None:
    with Metrics(tmp_path / "metrics.jsonl") as metrics:
        for number, row in enumerate(ROWS):
            metrics.write(row)
            assert read_metrics(tmp_path / "metrics.jsonl") == ROWS[: number + 1], "already on disk's way"
    assert [file.name for file in tmp_path.iterdir()] == ["metrics.jsonl"]


def test_tensorboard_gets_the_same_numbers_by_the_same_names(tmp_path: Path) -> None:
    pytest.importorskip("tensorboardX")
    with Metrics(tmp_path / "metrics.jsonl", make_sinks(["tensorboard"])) as metrics:
        for row in ROWS:
            metrics.write(row)
    assert scalars(tmp_path) == {(name, int(row["steps"]), value) for row in ROWS for name, value in row.items()}
    assert read_metrics(tmp_path / "metrics.jsonl") == ROWS


def test_without_the_extra_tensorboard_is_refused_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(InputError, match=re.escape(installing("tensorboard"))):
        train(configure(), tmp_path / "run", sinks=("tensorboard",))
    assert not (tmp_path / "run").exists()


def test_a_sink_that_there_is_not_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"sink 'tensorbord' is not one of: .*Did you mean 'tensorboard'"):
        train(configure(), tmp_path / "run", sinks=("tensorbord",))
    assert not (tmp_path / "run").exists()


class Full(Notebook):
    """A sink with room for one row."""

    def write(self, row: Mapping[str, Any]) -> None:
        if self.rows:
            raise ConnectionError("no room")
        super().write(row)


def test_a_sink_that_fails_is_told_once_and_the_run_goes_on(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    full, notebook = Full(), Notebook()
    with Metrics(tmp_path / "metrics.jsonl", {"full": full, "notebook": notebook}) as metrics:
        for row in [*ROWS, {"steps": 384}]:
            metrics.write(row)
        metrics.finish({"success_rate": 1.0})
    assert (full.rows, full.result) == (ROWS[:1], {})
    assert (notebook.rows, notebook.result) == ([*ROWS, {"steps": 384}], {"success_rate": 1.0})
    assert read_metrics(tmp_path / "metrics.jsonl") == notebook.rows
    assert caplog.messages == ["reachlab: full gets no more numbers (no room); the run goes on without it."]


def test_a_sink_that_cannot_be_opened_closes_the_others(tmp_path: Path) -> None:
    class Shut(Notebook):
        def open(self, folder: Path) -> None:
            raise InputError(f"{folder} is shut.")

    notebook = Notebook()
    with pytest.raises(InputError, match="is shut"):
        Metrics(tmp_path / "metrics.jsonl", {"notebook": notebook, "shut": Shut()})
    assert notebook.result is None
