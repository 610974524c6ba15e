"""Speed, accuracy and learning on this machine, a file a suite."""

from __future__ import annotations

from collections.abc import Mapping

from reachlab.bench.table import Row
from reachlab.settings.tables import Lazy
from reachlab.settings.validation import choose

SUITES: dict[str, Lazy] = {
    "speed": Lazy("Environment and training steps a second.", "reachlab.bench.speed:speed"),
    "kinematics": Lazy(
        "Accuracy of forward kinematics, Jacobian and inverse kinematics.", "reachlab.bench.kinematics:kinematics"
    ),
    "learning": Lazy(
        "Success and wall time of whole trainings, in the default and in the author's setting.",
        "reachlab.bench.learning:learning",
    ),
    "start": Lazy(
        "Wall time of whole commands, with an empty and a warm compilation cache.", "reachlab.bench.start:start"
    ),
}
"""Suites by name: functions that yield rows, loaded when they are run. Adding one takes its file and its line here."""


def run_suite(name: str, suites: Mapping[str, Lazy] = SUITES) -> list[Row]:
    """Rows of a suite.

    Raises:
        InputError: there is no such suite.
    """
    return list(suites[choose("suite", name, suites)].load()())
