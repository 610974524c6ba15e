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
from params import tried
from reachlab.envs.gymnasium_goal import ReachGoalEnv, ReachGoalVectorEnv
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS

IDS = sorted(name for name, spec in gymnasium.registry.items() if spec.namespace == reachlab.__name__)
GOAL_METHODS = ("compute_reward", "compute_terminated", "compute_truncated")


@pytest.fixture(scope="module", params=tried(SIMULATORS, ["kinematic"]))
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


def test_the_methods_are_those_of_gymnasium_robotics(goal_env: ReachGoalEnv) -> None:
    for method in GOAL_METHODS:
        asked = inspect.signature(getattr(GoalEnv, method)).parameters
        assert list(inspect.signature(getattr(ReachGoalEnv, method)).parameters) == list(asked)
        answer = getattr(goal_env, method)(achieved_goal=np.zeros((4, 3)), desired_goal=np.zeros((4, 3)), info={})
        assert np.shape(answer) == (4,)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"observation": "state"}, "observation of a goal environment 'state' is not one of: goal, goal.state"),
        ({"reward": "dense"}, "reward of a goal environment 'dense' is not one of: goal, goal_distance"),
        ({"task": "precise", "hold_steps": 3, "at_goal": "end"}, "cannot end an episode once the goal was held for"),
    ],
)
@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_what_cannot_be_computed_again_is_refused(make: Any, settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        make("reachlab/ReachGoal-v0", **settings)


def test_a_goal_that_has_to_be_held_is_a_goal_too() -> None:
    settings = {"task": "precise", "action": "joint_delta", "tool_scale": None, "success_distance": 0.01}
    envs = gymnasium.make_vec("reachlab/ReachGoal-v0", num_envs=4, observation="goal+state", **settings)
    assert isinstance(envs, ReachGoalVectorEnv)
    envs.reset(seed=0)
    for _ in range(60):
        observation, rewards, _, truncated, info = envs.step(envs.action_space.sample())
        goals = observation["achieved_goal"], observation["desired_goal"]
        under_way = info["elapsed_steps"] > 0
        assert np.array_equal(rewards[under_way], envs.compute_reward(*goals, info)[under_way])
        assert np.array_equal(truncated, envs.compute_truncated(*goals, info))
    envs.close()
