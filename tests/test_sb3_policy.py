"""Models of Stable-Baselines3 through `reachlab eval`, beside SB3's own evaluation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

from reachlab.agents.sb3_policy import load_model
from reachlab.cli.main import main
from reachlab.settings.validation import InputError

ENVS, EPISODES = 50, 300


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, float]:
    """A model that is half trained, its normaliser, and its success by SB3's own evaluation."""
    from reachlab.sb3 import make_vec_env

    folder = tmp_path_factory.mktemp("model")
    settings: dict[str, Any] = {"observation": "target+tool", "success_distance": 0.2, "max_steps": 200}
    env = VecNormalize(make_vec_env(n_envs=32, seed=0, **settings), norm_reward=False)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=1024, n_epochs=4, learning_rate=2e-3, seed=0, device="cpu")
    model.learn(30_000)
    model.save(folder / "model")
    env.save(str(folder / "normaliser.pkl"))
    env.training = False
    judged = VecNormalize.load(str(folder / "normaliser.pkl"), make_vec_env(n_envs=ENVS, seed=900, **settings))
    judged.training = False
    successes = []

    def count(local: dict[str, Any], _: dict[str, Any]) -> None:
        if local["done"]:
            successes.append(local["info"]["is_success"])

    evaluate_policy(model, judged, n_eval_episodes=EPISODES, callback=count)
    return folder / "model.zip", folder / "normaliser.pkl", float(np.mean(successes))


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Exit status, output and messages of `reachlab eval`."""
    code = main(["eval", *words])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_model_is_as_good_as_stable_baselines3_says(
    trained: tuple[Path, Path, float], capsys: pytest.CaptureFixture[str]
) -> None:
    model, normaliser, theirs = trained
    words = (str(model), "--trust", "--normaliser", str(normaliser), "--episodes", str(EPISODES), "--json")
    code, out, _ = run(capsys, *words)
    report = json.loads(out)
    assert code == 0
    assert report["agent"] == "sb3"
    assert report["checkpoint"]["steps"] == 30_720
    # Both have drawn: the difference of two rates is within twice the standard error of one, times the root of two.
    error = np.sqrt(max(theirs * (1 - theirs), 0.01) / EPISODES)
    assert abs(report["success_rate"] - theirs) < 2 * np.sqrt(2) * error + 0.02


def test_a_model_knows_its_settings_and_how_its_file_is_called(trained: tuple[Path, Path, float]) -> None:
    model = load_model(trained[0])
    assert model.config is not None
    assert model.config.rules.max_steps == 200
    assert model.config.rules.observation == "target+tool"
    assert model.act(np.zeros((5, 6), np.float32)).shape == (5, 3)


def test_a_model_is_unpickled_only_if_it_is_trusted(
    trained: tuple[Path, Path, float], capsys: pytest.CaptureFixture[str]
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
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.zip").write_text("no archive")
    code, out, said = run(capsys, *words)
    assert (code, out) == (2, "")
    assert sentence in " ".join(said.split())


def test_a_model_is_not_asked_about_observations_that_it_does_not_know(trained: tuple[Path, Path, float]) -> None:
    from reachlab import Env, configure

    env = Env(configure(observation="target"), 1)
    with pytest.raises(InputError, match=r"observes arrays of \(6,\), and the environment gives \(3,\)"):
        load_model(trained[0]).check(env.schema)
