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
    ("pose", "mujoco", "pose", "joint_residual", "precise"),
    ("track", "mujoco", "track", "joint_residual", "track"),
    ("clutter", "mujoco", "clutter", "joint_residual", "closeness"),
)
"""Task, simulator, observation, action and reward with which every robot is tried."""

OTHERS = (
    *(("precise", observation, "tool_delta", "sparse") for observation in ("target", "target+tool", "state", "goal")),
    *(("pose", observation, "joint_delta", "sparse") for observation in ("pose", "goal+state")),
    *(("track", observation, "joint_delta", "sparse") for observation in ("track", "goal+state")),
    *(("clutter", observation, "joint_delta", "sparse") for observation in ("clutter", "goal+state")),
)
"""Task, observation, action and reward with which the first robot is tried in every simulator that has it."""


def _tried(task: str, robot: str, sim: str, observation: str, action: str, reward: str) -> bool:
    """Every robot as usual; of the first one every observation with every action, and every reward with every action.

    Of other tasks than the tutorial's those of `OTHERS`; rewards beyond the sparse one in the fastest simulator.
    """
    if (task, sim, observation, action, reward) in USUAL:
        return True
    if task == "clutter" and not SIMULATORS[sim].obstacles:
        return False
    if robot != FIRST or (reward != "sparse" and sim != TRACED):
        return False
    if task != PICTURED[0]:
        return (task, observation, action, reward) in OTHERS
    if (design := OBSERVATIONS[observation]).needs_pose or design.needs_velocity or design.needs_obstacles:
        return False
    if design.pictured:
        return (action, reward) == PICTURED[1:]
    return reward == "sparse" or observation == "target+tool"


COMBINATIONS = [names for names in product(TASKS, ROBOTS, SIMULATORS, OBSERVATIONS, ACTIONS, REWARDS) if _tried(*names)]


def _slow(task: str, robot: str, sim: str, observation: str, action: str, reward: str) -> bool:
    """Whether it is left to `make slow`: what takes long to compile, and most of what is unusual in two ways.

    Of the tutorial's task `make test` tries every observation with every action in the fastest simulator.
    """
    if task == "clutter" or (task == "pose" and robot != FIRST):
        return True
    if task == "tutorial":
        beyond = (observation != "target+tool", action != "tool_delta", reward != "sparse")
        return sum(beyond) > 1 and (sim != TRACED or beyond[2])
    return task == "pose" and (task, sim, observation, action, reward) not in USUAL


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(names, id="-".join(names), marks=[pytest.mark.slow] if _slow(*names) else [])
        for names in COMBINATIONS
    ],
)
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
