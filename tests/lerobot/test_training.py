"""From a dataset of `reachlab record` to a policy that LeRobot trains, and back into `reachlab eval`."""

# pyright: reportMissingImports=false
from __future__ import annotations

import json
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from test_lerobot_policy import EPISODES, SEED, TOGETHER, saved

import lerobot_policy_reachlab
import reachlab
from reachlab.cli import main as cli
from reachlab.envs.core import Env
from reachlab.envs.setup import in_evaluation
from reachlab.lerobot import LeRobotPolicy
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError

RUN = "so101/precise"
"""Teacher, which comes with reachlab."""

SMALL = {"chunk_size": 4, "n_action_steps": 4, "dim_model": 16, "n_heads": 2, "dim_feedforward": 16}
"""Settings of an ACT that is trained in no time, and has learnt nothing then."""


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy that LeRobot has trained on episodes of ours."""
    folder = tmp_path_factory.mktemp("trained")
    assert cli.main(["record", RUN, "--episodes", "3", "--cameras", "--out", str(folder / "dataset")]) == cli.DONE
    words = ["--dataset.repo_id=me/reaching", f"--dataset.root={folder / 'dataset'}", f"--output_dir={folder / 'act'}"]
    words += ["--policy.type=act", "--policy.device=cpu", "--policy.push_to_hub=false", "--policy.use_vae=false"]
    words += [f"--policy.{name}={value}" for name, value in SMALL.items()]
    words += ['--policy.normalization_mapping={"STATE": "MEAN_STD", "ENV": "MEAN_STD", "ACTION": "MEAN_STD"}']
    words += ["--batch_size=8", "--steps=3", "--num_workers=0"]
    command = [str(Path(sys.executable).with_name("lerobot-train")), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder / "act" / "checkpoints" / "last" / "pretrained_model"


def test_a_policy_that_lerobot_has_trained_is_evaluated_beside_its_teacher(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["eval", RUN, str(trained), "--episodes", "20", "--json"]) == cli.DONE
    teacher, act = json.loads(capsys.readouterr().out)
    assert (teacher["agent"], act["agent"]) == ("trained", "act")
    assert act["run"] == str(trained)
    assert act["checkpoint"]["sha256"] != teacher["checkpoint"]["sha256"]
    assert act["success_interval"][0] == 0.0
    assert teacher["success_interval"][1] == 1.0
    assert (act["task"], act["robot"], act["seed"]) == (teacher["task"], teacher["robot"], teacher["seed"])


def test_success_of_a_policy_of_lerobot_is_that_of_the_exported_one(exported: Path, tmp_path: Path) -> None:
    assert lerobot_policy_reachlab.ReachlabPolicy.name == "reachlab"  # its import makes it one of LeRobot's policies
    loaded = reachlab.load(RUN)
    # Its controller keeps the limits of acceleration and jerk, as an environment with `shaping` does.
    config = in_evaluation(loaded.config, loaded.config.sim)
    driver = LeRobotPolicy(saved(exported, tmp_path / "saved")).act
    with closing(Env(config, TOGETHER)) as env:
        found = reachlab.evaluate(env, driver, seed=SEED, episodes=EPISODES)
    with closing(Env(override(config, shaping=True), TOGETHER)) as env:
        low, high = reachlab.evaluate(env, "trained", loaded.policy, seed=SEED, episodes=EPISODES).success_interval
    assert low <= found.success_rate <= high
    assert found.agent == "reachlab"


def test_what_does_not_fit_is_refused_in_a_sentence(trained: Path, tmp_path: Path) -> None:
    policy = LeRobotPolicy(trained)
    with (
        closing(Env(reachlab.configure("precise", robot="panda"), 2)) as env,
        pytest.raises(InputError, match="has 6 numbers, and the environment has 7"),
    ):
        reachlab.evaluate(env, policy.act, episodes=2)
    with pytest.raises(InputError, match="cannot be read as a policy of LeRobot"):
        LeRobotPolicy(tmp_path)
