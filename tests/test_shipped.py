"""Policies that come with reachlab: each is there, whole and small, does what its report says, and stays as it is."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from safetensors.numpy import load_file

import reachlab
from reachlab.cli.main import main
from reachlab.envs.presets import preset
from reachlab.envs.setup import make_setup, settled
from reachlab.runs.checkpoint import ARRAYS
from reachlab.runs.files import read_json
from reachlab.runs.shipped import SHIPPED, find_run, shipped, told
from reachlab.settings.json_form import difference, override
from reachlab.settings.validation import InputError
from reachlab.tasks.observations import OBSERVATIONS
from shipped_policies import NAMES

MOST_BYTES = 8_000_000

PLAYED = (
    "so101/tutorial",
    "panda/precise",
    "gen3/pose",
    "ur5e/track",
    "xarm7/clutter",
    "panda/push",
    "panda/lift",
    "panda/place",
)
"""One for each task, each of another arm."""


def test_there_is_one_for_each_arm_and_task_and_they_are_small() -> None:
    assert shipped().keys() == set(NAMES)
    assert sum(file.stat().st_size for file in SHIPPED.rglob("*")) <= MOST_BYTES


@pytest.mark.parametrize("name", sorted(NAMES))
def test_it_is_whole_and_made_by_the_command_that_is_told(name: str) -> None:
    run = shipped()[name]
    robot, task = name.split("/")
    config = override(preset(task), robot=robot)
    setup = make_setup(config)
    assert difference(run.read_config(), settled(config, setup)) is None
    (steps,) = run.checkpoint_steps()
    report = read_json(run.report_file)
    arrays = next(run.checkpoints.iterdir()) / ARRAYS
    assert report["checkpoint"] == {"steps": steps, "sha256": hashlib.sha256(arrays.read_bytes()).hexdigest()}
    schema = OBSERVATIONS[config.rules.observation].schema(setup)
    assert load_file(arrays)["learner/policy/normaliser/mean"].shape == (schema.vector_size,)
    assert f"--task {task} --robot {robot}" in told(run)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLAYED)
def test_it_does_what_its_report_says(name: str) -> None:
    loaded = reachlab.load(name, num_envs=100)
    report = reachlab.evaluate(loaded.env, "trained", loaded.policy, seed=77, episodes=100)
    said = read_json(shipped()[name].report_file)
    assert report.success_interval[1] >= said["success_rate"]
    assert said["success_rate"] >= 0.95


@pytest.mark.slow
def test_eval_and_video_leave_it_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    before = sorted(SHIPPED.rglob("*"))
    assert main(["eval", "panda/tutorial", "--episodes", "5", "--json"]) == 0
    assert main(["video", "panda/tutorial", "--episodes", "1", "--fps", "5"]) == 0
    assert (tmp_path / "panda-tutorial.webp").is_file()
    assert sorted(SHIPPED.rglob("*")) == before


@pytest.mark.parametrize(("sim", "said"), [("kinematic", True), ("mujoco", False)])
def test_a_policy_that_fails_in_another_simulator_is_said_to_be_of_its_own(
    sim: str, said: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["eval", "panda/precise", "--sim", sim, "--episodes", "20"]) == 0
    told = "panda/precise was trained in mujoco, where joints follow their commands otherwise than in kinematic"
    assert (told in " ".join(capsys.readouterr().out.split())) == said


def test_a_folder_of_that_name_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "panda" / "precise").mkdir(parents=True)
    assert find_run("panda/precise").path == Path("panda/precise")


def test_a_name_that_is_nearly_one_is_told() -> None:
    with pytest.raises(InputError, match="Did you mean 'panda/precise'"):
        reachlab.load("panda/precis")
