"""Entries of tables that are loaded when they are asked for."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from reachlab.settings.tables import Lazy


def test_an_entry_is_imported_only_when_it_is_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "asked_for.py").write_text("def answer():\n    return 42\n")
    monkeypatch.syspath_prepend(tmp_path)
    entry = Lazy("The answer.", "asked_for:answer")
    assert "asked_for" not in sys.modules
    try:
        assert entry.load()() == 42
        assert entry.load() is entry.load()
    finally:
        sys.modules.pop("asked_for", None)


@pytest.mark.parametrize(
    ("place", "error"), [("reachlab.nowhere:name", ImportError), ("reachlab.settings.tables:Lasy", AttributeError)]
)
def test_a_place_that_holds_nothing_is_told_when_it_is_loaded(place: str, error: type[Exception]) -> None:
    with pytest.raises(error, match=place.rpartition(".")[2].partition(":")[0 if error is ImportError else 2]):
        Lazy("Nothing.", place).load()
