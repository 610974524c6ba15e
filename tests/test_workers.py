"""Processes that plan: they answer in order, the same as one alone, and end with who began them."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest

from reachlab.control.planning import workers
from reachlab.control.planning.workers import Workers
from reachlab.robots.loading import load_robot
from reachlab.settings.validation import InputError
from reachlab.tasks.scenes.bank import Finder, drawn_scenes


def scaled(by: float) -> Callable[[float], float]:
    """A function that is made in each process."""

    def multiplied(number: float) -> float:
        if number < 0:
            raise InputError(f"{number} is negative: give another.")
        sys.stdout.write("said on the way")
        time.sleep(0.02 * (number % 3))
        return by * number

    return multiplied


def process_number(_: int) -> Callable[[int], int]:
    def own(_: int) -> int:
        return os.getpid()

    return own


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "cores", lambda: 2)


@pytest.mark.usefixtures("two")
@pytest.mark.parametrize("most", [1, 2, 8])
def test_answers_come_in_the_order_of_the_questions(most: int) -> None:
    some = Workers(scaled, 10.0, most=most)
    assert some.count == min(most, 2)
    assert list(some.map(range(7))) == [10.0 * number for number in range(7)]
    assert list(itertools.islice(some.map(itertools.count()), 3)) == [0.0, 10.0, 20.0], "without end"
    assert list(some.map([])) == []
    some.close()


@pytest.mark.usefixtures("two")
def test_they_are_processes_of_their_own_which_end_when_nobody_asks_any_more() -> None:
    some = Workers(process_number, 0, most=2)
    numbers = set(some.map(range(6)))
    assert os.getpid() not in numbers
    assert 1 <= len(numbers) <= 2
    del some
    for number in numbers:
        with pytest.raises(ProcessLookupError):
            os.kill(number, 0)


@pytest.mark.usefixtures("two")
def test_what_is_refused_there_is_refused_here_and_nothing_is_lost() -> None:
    some = Workers(scaled, 2.0, most=2)
    with pytest.raises(InputError, match="-1 is negative: give another"):
        list(some.map([1, -1, 2]))
    assert list(some.map([3, 4])) == [6.0, 8.0]
    some.close()


@pytest.mark.usefixtures("two")
def test_a_process_that_was_killed_is_told() -> None:
    some = Workers(process_number, 0, most=2)
    for number in set(some.map(range(6))):
        os.kill(number, signal.SIGKILL)
    with pytest.raises(RuntimeError, match="a process that planned has ended"):
        list(some.map(range(6)))
    some.close()


@pytest.mark.parametrize("said", ["1", "2", ""])
def test_the_environment_says_how_many_cores_there_are(said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(workers.VARIABLE, said)
    here = len(os.sched_getaffinity(0))
    assert workers.cores() == min(int(said or here), here)


SCRIPT = """
from reachlab.control.planning import workers
workers.cores = lambda: 2
from test_workers import scaled
print(sum(workers.Workers(scaled, 1.0, most=2).map(range(5))))
"""


def test_a_script_needs_no_guard_and_ends(tmp_path: Path) -> None:
    file = tmp_path / "script.py"
    file.write_text(SCRIPT)
    beside = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    words = [sys.executable, str(file)]
    done = subprocess.run(words, capture_output=True, text=True, env=beside, timeout=60, check=True)
    assert done.stdout == "10.0\n", "what functions print goes to where errors go"


@pytest.mark.usefixtures("two")
def test_scenes_are_the_same_whoever_draws_them() -> None:
    given = load_robot("panda"), "wall", 3
    some = Workers(Finder, *given, most=2)
    drawn = list(some.map(range(2)))
    some.close()
    assert len(drawn[0]) != len(drawn[1]), "each batch is another"
    jax.tree.map(np.testing.assert_array_equal, drawn, [Finder(*given)(batch) for batch in range(2)])
    found = list(drawn_scenes(given[0], "wall", len(drawn[0]) + 1, seed=3))
    jax.tree.map(np.testing.assert_array_equal, found, [*drawn[0], drawn[1][0]])
