"""Entries of tables that are loaded when they are asked for."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from reachlab.settings.tables import Lazy
from reachlab.settings.validation import InputError


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
    ("place", "why"),
    [
        (
            "reachlab.nowhere:name",
            "there is no module 'reachlab.nowhere': it has the name of its file, without .py; a notebook's is __main__",
        ),
        ("reachlab.settings.tables:Lasy", "module 'reachlab.settings.tables' has no 'Lasy'"),
    ],
)
def test_a_place_that_holds_nothing_is_told_when_it_is_loaded(place: str, why: str) -> None:
    with pytest.raises(InputError, match=re.escape(f"entry {place!r} cannot be loaded: {why}.")):
        Lazy("Nothing.", place).load()


def test_a_module_that_lacks_another_says_which(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "lacking.py").write_text("import nothing_of_this_name")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ModuleNotFoundError, match="nothing_of_this_name"):
        Lazy("Nothing.", "lacking:name").load()
