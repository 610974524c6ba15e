"""The Stable-Baselines3 face, held against its own vector environment and its own learners."""

from __future__ import annotations

import re
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
import stable_baselines3.common.env_util as sb3_env_util
import torch
from gymnasium.wrappers import RescaleAction
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

from pushes import pushes
from reachlab.envs.gymnasium_shared import SETTINGS
from reachlab.envs.sb3_vector import ReachVecEnv
from reachlab.sb3 import make_vec_env
from reachlab.settings.validation import InputError, installing

NUM_ENVS = 3
SHORT: dict[str, Any] = {"max_steps": 40, "clip_actions": False, "success_distance": 0.4}
"""Episodes that end often and in every way."""


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def env() -> ReachVecEnv:
    return make_vec_env(n_envs=NUM_ENVS, **SHORT)


@pytest.fixture(scope="module")
def goal_env() -> ReachVecEnv:
    return make_vec_env("reachlab:reachlab/ReachGoal-v0", NUM_ENVS, seed=0, max_steps=20)


def assert_same_infos(ours: list[dict[str, Any]], theirs: list[dict[str, Any]], where: str) -> None:
    """Infos of equal names, types and values; the time of an episode's end is not compared."""
    for one, other in zip(ours, theirs, strict=True):
        assert one.keys() == other.keys(), where
        for name, value in other.items():
            if name == "episode":
                assert one[name]["r"] == pytest.approx(value["r"], abs=1e-4), where
                assert one[name]["l"] == value["l"], where
                assert one[name].keys() == value.keys(), where
            else:
                assert type(one[name]) is type(value), f"{where}: {name}"
                assert one[name] == pytest.approx(value, abs=1e-4), f"{where}: {name}"


def test_a_batch_is_stable_baselines3s_vector_of_single_environments(env: ReachVecEnv) -> None:
    theirs = sb3_env_util.make_vec_env("reachlab/Reach-v0", NUM_ENVS, env_kwargs=SHORT)
    assert env.observation_space == theirs.observation_space
    assert env.action_space == theirs.action_space
    assert env.seed(21) == theirs.seed(21)
    assert env.reset() == pytest.approx(theirs.reset(), abs=1e-4)
    assert_same_infos(env.reset_infos, theirs.reset_infos, "reset")
    ends = {"success": 0, "outside": 0, "timeout": 0}
    for number, actions in enumerate(pushes(NUM_ENVS, 400)):
        ours, other = env.step(actions), theirs.step(actions)
        for one, two in zip(ours[:3], other[:3], strict=True):
            assert one == pytest.approx(two, abs=1e-3), f"step {number}"
            assert np.asarray(one).dtype == np.asarray(two).dtype
        assert_same_infos(ours[3], other[3], f"step {number}")
        assert_same_infos(env.reset_infos, theirs.reset_infos, f"step {number}")
        for index in np.flatnonzero(ours[2]):
            info = ours[3][index]
            ends["timeout" if info["TimeLimit.truncated"] else "success" if info["is_success"] else "outside"] += 1
    assert min(ends.values()) > 0, f"not every end occurred: {ends}"
    assert env.reset() == pytest.approx(theirs.reset(), abs=1e-4), "the unseeded reset"


def test_make_vec_env_seeds_the_first_reset() -> None:
    batch, single = make_vec_env(n_envs=NUM_ENVS, seed=7, **SHORT), gymnasium.make("reachlab/Reach-v0", **SHORT)
    assert np.asarray(batch.reset())[1] == pytest.approx(single.reset(seed=8)[0], abs=1e-6)


def test_seeds_are_those_of_the_batch(env: ReachVecEnv) -> None:
    assert env.seed(2**32 - 1) == [2**32 - 1, *range(NUM_ENVS - 1)]
    for wrong in (-1, "3", True):
        with pytest.raises(InputError, match="seed must be a whole number"):
            env.seed(wrong)  # pyright: ignore[reportArgumentType]
    drawn = env.seed()
    assert len(drawn) == NUM_ENVS
    env.reset()


def test_observations_belong_to_the_caller(env: Any) -> None:
    first = env.reset()
    before = first.copy()
    second, *_ = env.step(np.full((NUM_ENVS, 3), 0.3, np.float32))
    assert np.array_equal(first, before)
    second[:] = 0
    assert env.step(np.zeros((NUM_ENVS, 3), np.float32))[0].any()


def test_what_all_environments_share_is_told_for_each(env: ReachVecEnv) -> None:
    assert env.get_attr("num_envs") == [NUM_ENVS] * NUM_ENVS
    assert env.get_attr("action_space", indices=[0, 2]) == [env.action_space] * 2
    assert env.get_attr("observation_space", indices=1) == [env.observation_space]
    assert env.env_is_wrapped(Monitor) == [True] * NUM_ENVS
    assert env.env_is_wrapped(RescaleAction, indices=0) == [False]
    assert not env.has_attr("colour")
    env.set_attr("colour", "red")
    assert env.get_attr("colour") == ["red"] * NUM_ENVS


def test_what_all_environments_share_cannot_differ(env: ReachVecEnv) -> None:
    with pytest.raises(InputError, match="colour is one for all 3 environments: leave out indices"):
        env.set_attr("colour", "red", indices=[1])
    with pytest.raises(InputError, match="method 'step' is not one of: compute_reward"):
        env.env_method("step", indices=[1])


def test_a_wrong_action_names_its_environment(env: ReachVecEnv) -> None:
    env.reset()
    actions = np.zeros((NUM_ENVS, 3), np.float32)
    actions[2, 1] = np.nan
    with pytest.raises(InputError, match=r"environment 2.*nan.*index 1"):
        env.step(actions)


def test_wrong_settings_and_an_id_of_others_are_refused_in_one_sentence() -> None:
    with pytest.raises(InputError, match=r"setting 'max_step' does not exist. Did you mean 'max_steps'"):
        make_vec_env(n_envs=2, max_step=3)
    with pytest.raises(InputError, match=r"environment id 'CartPole-v1' is not one of: .*reachlab/ReachGoal-v0"):
        make_vec_env("CartPole-v1")
    with pytest.raises(InputError, match="env_id must be the name of an environment"):
        make_vec_env(gymnasium.spec("reachlab/Reach-v0"))  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="is n_envs here"):
        make_vec_env(num_envs=8)
    with pytest.raises(InputError, match="env_kwargs must be a dict of settings, got 'dense'"):
        make_vec_env(env_kwargs="dense")  # pyright: ignore[reportArgumentType]
    settings: tuple[dict[str, Any], ...] = ({"arrays": "jax"}, {"autoreset_mode": "Disabled"})
    for setting in settings:
        with pytest.raises(
            InputError, match=f"takes arrays of NumPy, reset in the same step: leave {next(iter(setting))}"
        ):
            make_vec_env(**setting)


@pytest.mark.parametrize("argument", [{"wrapper_class": RescaleAction}, {"monitor_dir": "logs"}, {"start_index": 3}])
def test_an_argument_for_single_environments_is_refused_in_one_sentence(argument: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"{next(iter(argument))} is for single environments, and these are one batch"):
        make_vec_env(n_envs=2, **argument)


def test_settings_are_given_as_stable_baselines3_takes_them_too() -> None:
    env = make_vec_env(n_envs=1, env_kwargs=SHORT, wrapper_class=None, monitor_dir=None, start_index=0)
    assert getattr(env.action_space, SETTINGS)["rules"]["max_steps"] == 40


def test_the_settings_of_an_id_are_its_own_where_they_are_not_changed(goal_env: ReachVecEnv) -> None:
    rules = getattr(goal_env.action_space, SETTINGS)["rules"]
    assert (rules["action"], rules["max_steps"]) == ("tool_step", 20)
    assert goal_env.observation_space == gymnasium.make("reachlab/ReachGoal-v0").observation_space


def test_without_stable_baselines3_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "reachlab.envs.sb3_vector")
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.monitor", None)
    with pytest.raises(InputError, match=re.escape(f"ReachVecEnv needs Stable-Baselines3: {installing('sb3')}.")):
        make_vec_env()


def test_pictures_are_tiled() -> None:
    env = make_vec_env(n_envs=NUM_ENVS, render_mode="rgb_array", **SHORT)
    env.reset()
    try:
        pictures = env.get_images()
    except InputError as error:
        pytest.skip(str(error))
    assert isinstance(pictures[0], np.ndarray)
    tiled = env.render()
    assert tiled is not None
    assert tiled.size >= NUM_ENVS * pictures[0].size
    env.close()


def test_ppo_learns_and_is_told_returns_and_successes(env: ReachVecEnv) -> None:
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=96, n_epochs=1, seed=0, device="cpu")
    before = [parameter.clone() for parameter in model.policy.parameters()]
    model.learn(2 * 64 * NUM_ENVS)
    assert any((old != new).any() for old, new in zip(before, model.policy.parameters(), strict=True))
    assert model.ep_info_buffer
    assert {"r", "l", "t"} == model.ep_info_buffer[0].keys()
    assert model.ep_success_buffer
    mean, _ = evaluate_policy(model, env, n_eval_episodes=3)
    assert np.isfinite(mean)


def test_hindsight_replay_pays_for_a_goal_what_the_environment_would_have_paid(goal_env: ReachVecEnv) -> None:
    settings: dict[str, Any] = {"buffer_size": 600, "learning_starts": 120, "batch_size": 32, "seed": 0}
    model = SAC("MultiInputPolicy", goal_env, replay_buffer_class=HerReplayBuffer, **settings, device="cpu")
    model.learn(150)
    assert isinstance(model.replay_buffer, HerReplayBuffer)
    sampled = model.replay_buffer.sample(500)
    achieved, desired = (sampled.next_observations[name].numpy() for name in ("achieved_goal", "desired_goal"))
    assert np.array_equal(desired, sampled.observations["desired_goal"].numpy())
    assert sampled.rewards.numpy()[:, 0] == pytest.approx(
        goal_env.env_method("compute_reward", achieved, desired, {})[0]
    )
    assert {0.0, -1.0} == set(sampled.rewards.numpy()[:, 0].tolist())
    assert not sampled.dones.any(), "the clock alone ends episodes"


def test_goal_observations_are_dicts_the_last_of_an_episode_too(goal_env: ReachVecEnv) -> None:
    first = goal_env.reset()
    push = np.ones((NUM_ENVS, 3), np.float32)
    for _ in range(19):
        assert not goal_env.step(push)[2].any()
    observation, _, done, infos = goal_env.step(push)
    assert isinstance(first, dict)
    assert isinstance(observation, dict)
    assert done.all()
    for index, info in enumerate(infos):
        last = info["terminal_observation"]
        assert goal_env.observation_space.contains(last)
        assert np.array_equal(last["desired_goal"], first["desired_goal"][index])
        assert np.linalg.norm(last["achieved_goal"] - last["desired_goal"]) == pytest.approx(info["distance"], abs=1e-6)
