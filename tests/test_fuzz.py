"""A handful of random commands; `python tests/fuzz_commands.py 500` runs many more."""

from __future__ import annotations

import random

import pytest

from fuzz_commands import command, fuzz, senseless
from reachlab.cli.verbs import VERBS

pytestmark = pytest.mark.slow

QUICK = ("train",) * 4 + ("eval", "distil", "plot", "bench")
"""Verbs that draw no film."""


def test_random_commands_end_in_order() -> None:
    outcomes = fuzz(60, 1, QUICK)
    assert [(outcome.words, outcome.problem) for outcome in outcomes if outcome.problem] == []
    assert {outcome.status for outcome in outcomes} >= {0, 2}


def test_there_are_values_of_every_flag_to_try() -> None:
    tried = [word for seed in range(3000) for word in command(random.Random(seed), tuple(VERBS))]
    assert {"--frame", "--joint-names", "--limits", "--randomise"} <= set(tried)


@pytest.mark.parametrize(
    "words",
    [
        "--collisions",
        "--task precise --sim kinematic --gravity-compensation",
        "--joint-scale 0.5",
        "--hold-steps 2000",
        "--targets box --target-low 0.5 0 0 --target-high 0.4 0.1 0.1",
        "--targets box --target-low 5 5 5 --target-high 6 6 6",
        "--reward sparse --approach-weight 2",
        "--goal-paths line",
        "--task pose --settle-steps 10",
    ],
)
def test_what_makes_no_sense_is_known_for_that(words: str) -> None:
    assert senseless(["train", *words.split()])


def test_what_makes_sense_is_not_taken_for_nonsense() -> None:
    assert senseless(["train"]) is None
    assert senseless(["train", "--sim", "mujoco", "--collisions", "--no-gui", "--joint-scale", "0.02"]) is None
