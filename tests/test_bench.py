"""The suites of measurements, without measuring."""

from __future__ import annotations

import pytest

import benchmarks
from reachlab.bench import SUITES, run_suite
from reachlab.bench.table import row, to_markdown
from reachlab.settings.tables import Lazy
from reachlab.settings.validation import InputError


@pytest.mark.parametrize(("name", "entry"), [*SUITES.items(), *benchmarks.SUITES.items()])
def test_every_suite_is_a_function_of_its_own_name(name: str, entry: Lazy) -> None:
    suite = entry.load()
    assert callable(suite)
    assert suite.__name__ == name


def test_a_suite_is_run_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SUITES, "keys", Lazy("A suite without rows.", "builtins:dict"))
    assert run_suite("keys") == []
    with pytest.raises(InputError, match=r"suite .sped. is not one of.* Did you mean 'speed'"):
        run_suite("sped")


def test_a_table_has_a_line_for_each_measurement_and_a_column_for_each_agent() -> None:
    rows = [
        row("held/ik", 0.5, "rate"),
        row("held/trained", 0.75, "rate", lowest_seed=0.25),
        row("speed/ik", 12345.6, "1/s"),
    ]
    heading, _, first, second, *_ = to_markdown(rows).splitlines()
    assert heading == "|  | ik | trained |"
    assert first == "| held | 50.00 % | 75.00 % (25.00) |"
    assert second == "| speed [1/s] | 12,346 | – |"
