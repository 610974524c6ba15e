"""Every registered environment in every simulator, held against the checkers of the libraries that use them."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasiums_checker
from gymnasium_robotics.core import GoalEnv
from stable_baselines3.common.env_checker import check_env as stable_baselines3s_checker

import reachlab
from reachlab.envs.gymnasium_goal import ReachGoalEnv
from reachlab.sims import SIMULATORS

IDS = sorted(name for name, spec in gymnasium.registry.items() if spec.namespace == reachlab.__name__)
GOAL_METHODS = ("compute_reward", "compute_terminated", "compute_truncated")


@pytest.fixture(scope="module", params=SIMULATORS)
def sim(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module", params=IDS)
def env(request: pytest.FixtureRequest, sim: str) -> Iterator[gymnasium.Env[Any, Any]]:
    env = gymnasium.make(request.param, sim=sim, disable_env_checker=True)
    yield env.unwrapped
    env.close()


def said(check: Callable[[], None]) -> list[str]:
    """What a checker warns of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check()
    return [str(warning.message) for warning in caught]


def test_checkers_find_nothing_but_the_tutorials_box(env: Any) -> None:
    found = said(lambda: gymnasiums_checker(env, skip_render_check=True))
    found += said(lambda: stable_baselines3s_checker(env, skip_render_check=True))
    assert len(found) == (0 if isinstance(env, ReachGoalEnv) else 2), found
    assert all("symmetric and normalized" in sentence for sentence in found)


# --- goals: what Gymnasium-Robotics asks of its own environments ----------------------------------


@pytest.fixture(scope="module")
def goal_env(sim: str) -> Iterator[ReachGoalEnv]:
    """Episodes that a success or the way out of the workspace ends, as well as the clock."""
    env = gymnasium.make(
        "reachlab/ReachGoal-v0", sim=sim, max_steps=12, at_goal="end", end_outside=True, success_distance=0.2
    )
    yield env.unwrapped  # pyright: ignore[reportReturnType]
    env.close()


def test_rewards_and_ends_of_a_step_follow_from_its_goals(goal_env: ReachGoalEnv) -> None:
    random, ends = np.random.default_rng(0), {"terminated": 0, "truncated": 0}
    told: list[tuple[Any, ...]] = []
    for episode in range(25):
        observation, info = goal_env.reset(seed=episode)
        push = random.uniform(-1, 1, goal_env.action_space.shape).astype(np.float32)
        ended = False
        while not ended:
            assert goal_env.observation_space.contains(observation)
            observation, reward, terminated, truncated, info = goal_env.step(push)
            goals = observation["achieved_goal"], observation["desired_goal"]
            assert np.linalg.norm(goals[0] - goals[1]) == pytest.approx(info["distance"], abs=1e-6)
            again = [getattr(goal_env, method)(*goals, info) for method in GOAL_METHODS]
            assert again == [reward, terminated, truncated]
            told.append((*goals, info, *again))
            ended = terminated or truncated
            ends["terminated"] += terminated
            ends["truncated"] += truncated
    assert min(ends.values()) > 0, f"not every end occurred: {ends}"
    achieved, desired, infos, *columns = zip(*told, strict=True)
    for method, column in zip(GOAL_METHODS, columns, strict=True):
        assert getattr(goal_env, method)(np.array(achieved), np.array(desired), infos).tolist() == list(column)


def test_another_goal_is_judged_as_if_it_had_been_asked_for(goal_env: ReachGoalEnv) -> None:
    observation, info = goal_env.reset(seed=0)
    achieved, desired = observation["achieved_goal"], observation["desired_goal"]
    assert not goal_env.compute_terminated(achieved, desired, info)
    assert goal_env.compute_terminated(achieved, achieved, info)
    assert goal_env.compute_reward(achieved, achieved, info) == 0


@pytest.mark.parametrize("method", GOAL_METHODS)
def test_the_methods_are_those_of_gymnasium_robotics(goal_env: ReachGoalEnv, method: str) -> None:
    asked = inspect.signature(getattr(GoalEnv, method)).parameters
    assert list(inspect.signature(getattr(ReachGoalEnv, method)).parameters) == list(asked)
    answer = getattr(goal_env, method)(achieved_goal=np.zeros((4, 3)), desired_goal=np.zeros((4, 3)), info={})
    assert np.shape(answer) == (4,)
