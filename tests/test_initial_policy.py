"""Trainings that begin with a policy which is there already."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from reachlab.agents.policy import Policy
from reachlab.envs.core import Env
from reachlab.envs.presets import configure, distillation
from reachlab.envs.setup import make_setup, settled
from reachlab.learn.load import load, load_initial
from reachlab.learn.train import distil, train
from reachlab.runs.directory import RunDirectory
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError

TINY: dict[str, Any] = {
    "num_envs": 8,
    "rollout_steps": 8,
    "total_steps": 64,
    "stop_early": False,
    "hidden": (8,),
    "report_episodes": 2,
    "max_steps": 20,
}
"""A training of one iteration."""

STILL: dict[str, Any] = {"learning_rate": 1e-12, "final_learning_rate": 1e-12}
"""Settings with which an iteration leaves the networks as they are."""


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose policy is like no untrained one."""
    folder = tmp_path_factory.mktemp("first") / "run"
    train(configure(**TINY, learning_rate=0.1), folder)
    return folder


def assert_same(one: Policy, other: Policy) -> None:
    for here, there in zip(jax.tree.leaves(one.parameters), jax.tree.leaves(other.parameters), strict=True):
        np.testing.assert_allclose(here, there, atol=1e-8)


@pytest.mark.parametrize("sim", ["kinematic", "mujoco"])
def test_training_begins_with_the_policy_of_another_run(first: Path, tmp_path: Path, sim: str) -> None:
    config = configure(sim=sim, **TINY, **STILL, seed=5, initial_policy=str(first))
    taken, given = train(config, tmp_path / "run").policy, load(first).policy
    assert_same(taken, given)
    begun: Any = load_initial(Env(config, 1))
    np.testing.assert_array_equal(begun.normaliser.mean, given.normaliser.mean)
    assert taken.normaliser.count == TINY["total_steps"], "then what it observes here counts alone"


def test_a_training_ended_before_its_first_checkpoint_begins_with_it_again(first: Path, tmp_path: Path) -> None:
    asked = configure(**TINY, **STILL, initial_policy=str(first))
    config = settled(asked, make_setup(asked))
    RunDirectory(tmp_path / "run").create(config)
    assert_same(train(config, tmp_path / "run", resume=True).policy, load(first).policy)


def test_a_policy_of_another_arm_that_observes_as_much_is_taken(first: Path, tmp_path: Path) -> None:
    policy = train(configure(robot="so101", **TINY, **STILL, initial_policy=str(first)), tmp_path / "run").policy
    assert_same(policy, load(first).policy)
    assert policy.schema == Env(configure(robot="so101", **TINY), 1).schema != load(first).policy.schema


def test_a_policy_that_is_built_otherwise_is_refused_before_anything_is_made(first: Path, tmp_path: Path) -> None:
    wider = override(configure(**TINY), hidden=(16, 8), observation="target", initial_policy=str(first))
    with pytest.raises(InputError, match=r"was trained with observation target\+tool, hidden 8: choose that too"):
        train(wider, tmp_path / "run")
    other = configure("precise", robot="ur5e", initial_policy="panda/precise")
    with pytest.raises(InputError, match=r"observes 40 numbers for actions of 7, and this training 36 for 6"):
        train(other, tmp_path / "run")
    with pytest.raises(InputError, match="run directory 'nowhere' does not exist"):
        train(configure(**TINY, initial_policy="nowhere"), tmp_path / "run")
    with pytest.raises(InputError, match="initial_std has no effect with initial_policy"):
        train(configure(**TINY, initial_std=0.2, initial_policy=str(first)), tmp_path / "run")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_student_begins_with_another_student_and_not_with_what_its_teacher_began_with(
    first: Path, tmp_path: Path
) -> None:
    tiny: dict[str, Any] = {
        "num_envs": 4,
        "rollout_steps": 4,
        "total_steps": 128,
        "report_episodes": 2,
        "guided": 1,
        "updates": 1,
    }
    taught = override(load(first).config, initial_policy="gone")
    assert distillation(str(first), taught).learner.initial_policy is None
    student = distil(distillation(str(first), taught, **tiny), tmp_path / "first").policy
    config = distillation(str(first), taught, **tiny, **STILL, initial_policy=str(tmp_path / "first"))
    assert_same(distil(config, tmp_path / "second").policy, student)
