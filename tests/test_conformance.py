"""The checks of `conformance`, over combinations of the tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from conformance import CHECKS, Subject
from reachlab.envs.consistency import check
from reachlab.envs.presets import configure, preset
from reachlab.robots.catalogue import ROBOTS
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.rewards import REWARDS

TABLES = {
    "robot": ROBOTS,
    "sim": SIMULATORS,
    "observation": OBSERVATIONS,
    "action": ACTIONS,
    "reward": REWARDS,
}

FIRST = next(iter(TASKS))
"""Everything is varied about this task's preset, which compiles quickly; of the others what has to do with them."""

TASK_OF_ROBOT = {"panda": "pose", "ur5e": "clutter", "xarm7": "track", "gen3": "precise", "so101": "pose"}
"""In which other task a robot beside the first is tried."""

LONG = ("image+tool", "clutter", "clutter_pose", "heading")
"""What takes long and has a quicker sibling, or is tried by tests of its own."""


def _fits(names: dict[str, str]) -> bool:
    """Whether a configuration with these names is not refused."""
    try:
        check(configure(**names))
    except InputError:
        return False
    return True


def _combinations() -> Iterator[tuple[dict[str, str], bool]]:
    """Names of a task's preset with one of them changed, for each task; and whether `make slow` tries it alone."""
    for task in TASKS:
        rules, sim = preset(task).rules, preset(task).sim
        usual = {"task": task, "robot": next(iter(ROBOTS)), "sim": sim}
        usual |= {kind: getattr(rules, kind) for kind in ("observation", "action", "reward")}
        yield usual, task in LONG
        for kind, table in TABLES.items():
            for name in table.keys() - {usual[kind]}:
                concerned = kind in ("sim", "action") or (kind == "robot" and task == TASK_OF_ROBOT[name])
                pictured = kind == "action" and "picture" in ACTIONS[name].needs
                changed = {**usual, kind: name} | ({"observation": "image"} if pictured else {})
                if kind == "action" and not pictured:  # some are preset with an observation of their own
                    changed["observation"] = preset(task, action=name).rules.observation
                if (task == FIRST or concerned) and _fits(changed):
                    yield changed, (task != FIRST and not pictured) or name in LONG


COMBINATIONS = sorted(_combinations(), key=lambda one: tuple(one[0].values()))


def test_every_entry_of_a_table_is_tried() -> None:
    for kind, table in {"task": TASKS, **TABLES}.items():
        assert {names[kind] for names, _ in COMBINATIONS} == set(table)
    quick = {name for names, slow in COMBINATIONS if not slow for name in names.values()}
    assert quick >= {*ROBOTS, *SIMULATORS, *ACTIONS, *REWARDS} - {*LONG}


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(names, id="-".join(names.values()), marks=[pytest.mark.slow] if slow else [])
        for names, slow in COMBINATIONS
    ],
)
def subject(request: pytest.FixtureRequest) -> Iterator[Subject]:
    try:
        subject = Subject(**request.param)
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
