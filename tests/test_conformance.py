"""The checks of `conformance`, over every combination of the tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product

import pytest

from conformance import CHECKS, Subject
from reachlab.robots.catalogue import ROBOTS
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.rewards import REWARDS

PICTURED = ("tutorial", "tool_delta", "sparse")
"""Task, action and reward with which pictures are tried: the camera is aimed at the table, and they change nothing."""

FIRST, TRACED = next(iter(ROBOTS)), "kinematic"

USUAL = (
    ("tutorial", "kinematic", "target+tool", "tool_delta", "dense"),
    ("tutorial", "pybullet", "target+tool", "tool_delta", "dense"),
    ("precise", "mujoco", "state", "joint_residual", "precise"),
)
"""Task, simulator, observation, action and reward with which every robot is tried."""

COMBINATIONS = [
    names
    for names in product(TASKS, ROBOTS, SIMULATORS, OBSERVATIONS, ACTIONS, REWARDS)
    if (names[0], *names[2:]) in USUAL
    or (
        names[1] == FIRST
        and (names[2] == TRACED or names[5] in ("sparse", "precise"))
        and (
            (names[0], *names[4:]) == PICTURED
            or (not OBSERVATIONS[names[3]].pictured and (names[0] == PICTURED[0] or names[4:] == PICTURED[1:]))
        )
    )
]
"""Of the first robot all of the tutorial's, and of every other task those with the same action and reward.

The dense reward, which is the sparse one and a term, is tried in the fastest simulator."""


@pytest.fixture(scope="module", params=COMBINATIONS, ids="-".join)
def subject(request: pytest.FixtureRequest) -> Iterator[Subject]:
    try:
        subject = Subject(*request.param)
    except InputError as error:
        # An optional simulator that is not installed says how to install it.
        if "pip install" not in str(error):
            raise
        pytest.skip(str(error))
    yield subject
    subject.env.close()


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_conformance(subject: Subject, check: Callable[[Subject], None]) -> None:
    check(subject)
