"""A student that observes pictures learns from a teacher that knows the state."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from benchmarks.camera import SPOILT
from reachlab.cli import main as cli
from reachlab.envs.consistency import check
from reachlab.envs.core import Env
from reachlab.envs.presets import configure, distillation
from reachlab.envs.random_streams import REPORT_STREAM, env_keys, episode_keys
from reachlab.learn.dagger import check_distillation
from reachlab.learn.dagger_buffer import Pictures, add, make_buffer
from reachlab.learn.interrupts import Interrupted
from reachlab.learn.load import load_policy
from reachlab.learn.train import distil, train
from reachlab.runs.directory import RunDirectory
from reachlab.settings.config import DistilRunConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError
from test_resume import ask, at, rows, weights

pytestmark = pytest.mark.slow

TINY: dict[str, Any] = {"num_envs": 8, "rollout_steps": 4, "action_repeat": 4, "total_steps": 6 * 128, "updates": 4}
TINY |= {"batch": 16, "guided": 2, "capacity": 128, "report_episodes": 4, "max_steps": 30}
"""Six iterations of 32 pictures; the buffer is overwritten once."""

TEACHER: dict[str, Any] = {"num_envs": 16, "rollout_steps": 16, "total_steps": 256, "stop_early": False}
TEACHER |= {"report_episodes": 4, "max_steps": 30}
"""A training of one iteration."""


@pytest.fixture(scope="module")
def teacher(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("teacher") / "run"
    train(configure(**TEACHER), out)
    return out


def lessons(teacher: Path, **settings: Any) -> DistilRunConfig:
    return distillation(str(teacher), RunDirectory(teacher).read_config(), **{**TINY, **settings})


@pytest.fixture(scope="module")
def whole(teacher: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "run"
    distil(lessons(teacher, randomise=("view",)), out)
    return out


def test_the_student_comes_to_do_as_the_teacher_does_in_mujoco_too(teacher: Path, tmp_path: Path) -> None:
    result = distil(lessons(teacher, sim="mujoco", updates=16, capacity=1000), tmp_path / "run")
    errors = [row["action_error"] for row in rows(tmp_path / "run")]
    assert errors[-1] < errors[0] / 2
    assert result.report.sim == "mujoco"
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(result.policy.parameters))


def test_a_distillation_stopped_ends_with_the_weights_of_one_never_stopped(
    teacher: Path, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, config = tmp_path / "parts", lessons(teacher, randomise=("view",))
    with pytest.raises(Interrupted, match=r"`reachlab distil --resume .*parts` continues from there"):
        distil(config, out, at(5, ask(signal.SIGINT)))
    different = (
        ["--seed", "9"],
        ["--action-repeat", "7"],
        ["--batch", "17"],
        ["--updates", "48"],  # what it would be by default
        ["--randomise"],
        [str(tmp_path / "other")],
    )
    for words in different:
        assert cli.main(["distil", "--resume", str(out), *words]) == cli.WRONG_INPUT
        assert "and cannot be resumed with" in capsys.readouterr().err
    distil(config, out, resume=True)
    assert weights(out) == weights(whole)
    assert rows(out) == rows(whole)


def test_a_student_that_remembers_resumes_too_with_pictures_that_did_not_come(teacher: Path, tmp_path: Path) -> None:
    config = lessons(teacher, memory=8, goal_lost=0.5, action_repeat=1, total_steps=6 * 32)
    with pytest.raises(Interrupted):
        distil(config, tmp_path / "parts", at(5, ask(signal.SIGINT)))
    distil(config, tmp_path / "parts", resume=True)
    distil(config, tmp_path / "whole")
    assert weights(tmp_path / "parts") == weights(tmp_path / "whole")
    assert rows(tmp_path / "parts") == rows(tmp_path / "whole")


def test_the_run_directory_is_as_that_of_a_training(whole: Path) -> None:
    run = RunDirectory(whole)
    report = json.loads(run.report_file.read_text())
    assert (report["episodes"], report["steps"], report["agent"]) == (4, 768, "trained")
    assert isinstance(run.read_config(), DistilRunConfig)
    assert (run.read_config().randomise, report["randomised"]) == (("view",), [])
    assert rows(whole)[-1]["pictures"] == 6 * 32


def test_pictures_that_are_drawn_again_are_the_same() -> None:
    env = Env(configure(observation="image", randomise=("view",)), 8)
    state = env.init(env_keys(0, 8))
    buffer, album, again = make_buffer(state, 0, 12, dated=False), Pictures(env, 12), Pictures(env, 12)
    for seed in range(2):
        state = env.init(env_keys(8 * seed, 8))
        buffer = add(buffer, state, jnp.zeros((8, 0)), state.last_action)
        pictures = env.render_observation(state)
        assert pictures is not None
        album.add(pictures)
    again.complete(buffer)
    everything = np.arange(12)
    assert np.array_equal(album[everything], again[everything])
    env.close()


def test_whatever_the_picture_actions_are_finite(whole: Path) -> None:
    run = RunDirectory(whole)
    env = Env(run.read_config(), 2)
    policy, picture = load_policy(run, env), env.render_observation(env.init(env_keys(0, 2)))
    assert picture is not None
    for way, spoil in SPOILT.items():
        spoilt = spoil(picture, np.random.default_rng(0)).astype(np.uint8)
        assert not np.array_equal(spoilt, picture), way
        assert np.isfinite(np.asarray(policy.act(spoilt))).all(), way
    env.close()


def test_a_student_is_taught_its_own_action_or_the_whole_of_it(teacher: Path) -> None:
    with pytest.raises(InputError, match="a student with action 'joint_delta' cannot be taught by 'tool_delta'"):
        check_distillation(lessons(teacher, action="joint_delta"))
    taught = configure("lift", robot="panda")
    assert distillation("runs/lift", taught).rules.action == "joint_delta"


# --- the command line -----------------------------------------------------------------------------


def test_distil_then_eval_and_video(teacher: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "student"
    words = "--observation image+tool --total-steps 4096 --updates 2 --report-episodes 4 --guided 0"
    assert cli.main(["distil", str(teacher), *words.split(), "--out", str(out), "--json"]) == cli.DONE
    assert json.loads(capsys.readouterr().out)["steps"] == 4096
    assert cli.main(["eval", str(out), "--episodes", "2", "--agent", "trained", "zero", "--json"]) == cli.DONE
    assert [report["episodes"] for report in json.loads(capsys.readouterr().out)] == [2, 2]
    assert cli.main(["video", str(out), "--episodes", "1"]) == cli.DONE
    corner = np.asarray(Image.open(out / "video.webp").convert("RGB"))[16 : 16 + 168, 640 - 16 - 168 : 640 - 16]
    assert np.ptp(corner.astype(int), axis=-1).mean() < 5  # the inset is grey
    assert 150 < corner.mean() < 250
    assert cli.main(["distil", "--resume", str(out)]) == cli.DONE
    assert "is finished" in capsys.readouterr().err
    assert cli.main(["train", "--resume", str(out)]) == cli.WRONG_INPUT
    assert f"is resumed with `reachlab distil --resume {out}`" in capsys.readouterr().err


def test_a_teacher_that_remembers_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    train(configure(**TEACHER, memory=4), tmp_path / "teacher")
    with pytest.raises(InputError, match="remembers, and a teacher must not: train one with --memory 0"):
        distil(lessons(tmp_path / "teacher", memory=0), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["chained_starts", "gamma", "minibatches"])
def test_what_has_no_effect_on_a_student_is_refused(teacher: Path, name: str) -> None:
    with pytest.raises(InputError, match=f"{name} has no effect on a student"):
        lessons(teacher, **{name: 1})
    check(lessons(teacher, num_envs=7))


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"observation": "target"}, "observation 'target' holds no picture"),
        ({"sim": "pybullet"}, "choose --sim kinematic or mujoco"),
        ({"teacher_observation": "image"}, "a teacher has to know the state"),
        ({"capacity": 4}, "capacity must be at least"),
        ({"action_repeat": 16}, "the teacher would act in all 2 iterations of 512 steps, as guided is 2"),
    ],
)
def test_what_cannot_be_learnt_from_is_refused(
    teacher: Path, tmp_path: Path, settings: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        distil(lessons(teacher, **settings), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_videos_of_a_student_of_random_views_show_the_view_as_it_is(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "video.webp"
    assert cli.main(["video", str(whole), "--episodes", "1", "--out", str(out)]) == cli.DONE
    shown = np.asarray(Image.open(out).convert("L"), int)[16 : 16 + 168 : 2, 640 - 16 - 168 : 640 - 16 : 2]
    pictures = []
    for randomise in ((), ("view",)):
        env = Env(override(RunDirectory(whole).read_config(), randomise=randomise), 1)
        pictures.append(np.asarray(env.observe_now(env.init(episode_keys(1, REPORT_STREAM, 0, 1))), int)[0])
        env.close()
    tutorial, random = (np.abs(shown - picture).mean() for picture in pictures)
    assert tutorial < 5 < random


def test_distil_without_a_teacher_says_what_it_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["distil"]) == cli.WRONG_INPUT
    assert "distil needs a teacher" in capsys.readouterr().err
