"""Models of Stable-Baselines3 through `reachlab eval`, beside SB3's own evaluation."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.wrappers import RescaleAction
from sb3_contrib import ARS
from stable_baselines3 import A2C, PPO
from stable_baselines3.common.env_util import make_vec_env as vector_of_single
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

from reachlab.agents.sb3_policy import load_model
from reachlab.cli.main import main
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.evaluation.episodes import make_runner
from reachlab.evaluation.intervals import wilson_interval
from reachlab.settings.validation import InputError

EPISODES = 64


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, np.ndarray]:
    """A model that is half trained, its normaliser, and which episodes of seed 900 it solves in SB3's hands."""
    from reachlab.sb3 import make_vec_env

    torch.set_num_threads(1)
    folder = tmp_path_factory.mktemp("model")
    name, settings = "reachlab/Reach-v0", {"observation": "target+tool", "success_distance": 0.45, "max_steps": 100}
    env = VecNormalize(make_vec_env(name, n_envs=EPISODES, seed=0, **settings), norm_reward=False)
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=512, n_epochs=4, learning_rate=2e-3, seed=0, device="cpu")
    model.learn(8192)
    model.save(folder / "model")
    env.save(str(folder / "normaliser.pkl"))
    held_out = make_vec_env(name, n_envs=EPISODES, seed=900, **settings)
    judged = VecNormalize.load(str(folder / "normaliser.pkl"), held_out)
    judged.training = False
    solved: dict[int, bool] = {}

    def remember(local: dict[str, Any], _: dict[str, Any]) -> None:
        if local["done"]:
            solved.setdefault(local["i"], local["info"]["is_success"])

    # One for each environment: the first episode of its seed.
    evaluate_policy(model, judged, n_eval_episodes=EPISODES, callback=remember)
    return folder / "model.zip", folder / "normaliser.pkl", np.array([solved[i] for i in range(EPISODES)])


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Exit status, output and messages of `reachlab eval`."""
    code = main(["eval", *words])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_model_solves_the_very_episodes_that_it_solves_in_stable_baselines3(
    trained: tuple[Path, Path, np.ndarray],
) -> None:
    model = load_model(*trained[:2])
    assert model.config is not None
    played = make_runner(Env(model.config, EPISODES), model.act).run(None, env_keys(900, EPISODES))
    assert np.array_equal(np.asarray(played.success), trained[2])
    assert 0.1 < trained[2].mean() < 0.95


def test_eval_reports_on_a_model(trained: tuple[Path, Path, np.ndarray], capsys: pytest.CaptureFixture[str]) -> None:
    model, normaliser, solved = trained
    words = (str(model), "--trust", "--normaliser", str(normaliser), "--episodes", str(EPISODES), "--json")
    code, out, _ = run(capsys, *words)
    report = json.loads(out)
    assert code == 0
    assert report["agent"] == "sb3"
    assert report["checkpoint"]["steps"] == 8192
    low, high = report["success_interval"]
    theirs = wilson_interval(int(solved.sum()), EPISODES)
    assert low < theirs[1]
    assert theirs[0] < high


def test_a_model_knows_its_settings_and_how_its_file_is_called(trained: tuple[Path, Path, np.ndarray]) -> None:
    model = load_model(trained[0])
    assert model.config is not None
    assert model.config.rules.max_steps == 100
    assert model.config.rules.observation == "target+tool"
    assert model.act(np.zeros((5, 6), np.float32)).shape == (5, 3)


def test_a_model_is_unpickled_only_if_it_is_trusted(
    trained: tuple[Path, Path, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, said = run(capsys, str(trained[0]))
    assert (code, out) == (2, "")
    assert "is unpickled and may run any code: add --trust" in " ".join(said.split())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("missing.zip", "--trust"), "'missing.zip' cannot be loaded as a model: FileNotFoundError"),
        (("bad.zip", "--trust"), "'bad.zip' cannot be loaded as a model: ValueError"),
        (("--trust", "--agent", "ik"), "--trust goes with a model of Stable-Baselines3"),
        (("--normaliser", "x.pkl", "--agent", "ik"), "--normaliser goes with a model of Stable-Baselines3"),
    ],
)
def test_what_is_no_model_is_refused_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: Any, sentence: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.zip").write_text("no archive")
    code, out, said = run(capsys, *words)
    assert (code, out) == (2, "")
    assert sentence in " ".join(said.split())


def test_a_model_that_needs_a_normaliser_says_so_without_one(
    trained: tuple[Path, Path, np.ndarray], caplog: pytest.LogCaptureFixture
) -> None:
    env = Env(configure(success_distance=0.45), 1)
    load_model(*trained[:2]).check(env)
    assert not caplog.records
    model = load_model(trained[0])
    assert not caplog.records, "it may not be for this environment"
    model.check(env)
    model.check(env)
    assert len(caplog.records) == 1
    assert "was trained on normalised observations, and gets plain ones" in caplog.text


@pytest.mark.parametrize("held", [None, 3])
def test_a_normaliser_that_is_none_is_named(trained: tuple[Path, Path, np.ndarray], tmp_path: Path, held: Any) -> None:
    if held is not None:
        (tmp_path / "n.pkl").write_bytes(pickle.dumps(held))
    with pytest.raises(InputError, match=r"n\.pkl' cannot be loaded as a normaliser"):
        load_model(trained[0], tmp_path / "n.pkl")


def test_a_model_is_not_asked_about_observations_that_it_does_not_know(trained: tuple[Path, Path, np.ndarray]) -> None:
    env = Env(configure(observation="target"), 1)
    with pytest.raises(InputError, match=r"observes arrays of \(6,\), and the environment gives \(3,\)"):
        load_model(trained[0]).check(env)


def test_a_model_whose_actions_a_wrapper_scaled_is_not_evaluated_without_it(tmp_path: Path) -> None:
    scaled = {"min_action": np.float32(-1), "max_action": np.float32(1)}
    wrapper: Any = RescaleAction
    env = vector_of_single("reachlab:reachlab/Reach-v0", 2, wrapper_class=wrapper, wrapper_kwargs=scaled)
    PPO("MlpPolicy", env, n_steps=16, batch_size=16, device="cpu").save(tmp_path / "model")
    model = load_model(tmp_path / "model.zip")
    assert model.config is None
    with pytest.raises(InputError, match=r"behind a wrapper, as RescaleAction, that no model holds"):
        model.check(Env(configure(), 1))


def test_a_model_without_settings_is_not_evaluated_on_another_arm(trained: tuple[Path, Path, np.ndarray]) -> None:
    model = replace(load_model(trained[0]), config=None)
    model.check(Env(configure(success_distance=0.45), 1))
    with pytest.raises(InputError, match="are not those of the environment"):
        model.check(Env(configure(robot="panda"), 1))


@pytest.mark.parametrize(
    ("algorithm", "policy", "options"),
    [(PPO, "MlpPolicy", {"use_sde": True}), (A2C, "MlpPolicy", {"use_sde": True}), (ARS, "LinearPolicy", {})],
)
def test_models_of_other_algorithms_act_as_in_stable_baselines3(
    tmp_path: Path, algorithm: Any, policy: str, options: dict[str, Any]
) -> None:
    from reachlab.sb3 import make_vec_env

    model = algorithm(policy, make_vec_env(n_envs=2), seed=0, device="cpu", **options)
    model.save(tmp_path / "model")
    observation = np.random.default_rng(0).uniform(-0.5, 0.5, model.observation_space.shape)[None].astype(np.float32)
    acts = load_model(tmp_path / "model.zip").act(observation)
    assert np.array_equal(acts, model.predict(observation, deterministic=True)[0])


def test_a_normaliser_of_other_observations_is_refused(trained: tuple[Path, Path, np.ndarray], tmp_path: Path) -> None:
    from reachlab.sb3 import make_vec_env

    VecNormalize(make_vec_env("reachlab/ReachGoal-v0", n_envs=1)).save(str(tmp_path / "goal.pkl"))
    with pytest.raises(
        InputError, match=r"goal\.pkl' cannot be loaded as a normaliser.*other observations than the model"
    ):
        load_model(trained[0], tmp_path / "goal.pkl")


def test_a_model_of_a_game_is_refused_by_its_observations(tmp_path: Path) -> None:
    model = PPO("MlpPolicy", "FrozenLake-v1", n_steps=16, batch_size=16, device="cpu").learn(16)
    model.save(tmp_path / "lake")
    with pytest.raises(InputError, match="the model observes arrays of"):
        load_model(tmp_path / "lake.zip").check(Env(configure(), 1))
