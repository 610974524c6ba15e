"""Training as a user runs it, and what it leaves behind."""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
import sys
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.setup import make_setup, settled
from reachlab.evaluation.episodes import BATCH, make_runner
from reachlab.evaluation.report import evaluate
from reachlab.learn.load import load_policy
from reachlab.learn.loop import ENOUGH_EPISODES, Loop, Progress
from reachlab.learn.ppo_method import PPO
from reachlab.learn.train import TrainResult, train
from reachlab.runs.directory import RunDirectory
from reachlab.settings.json_form import to_json
from reachlab.settings.validation import InputError

TINY = {"num_envs": 16, "rollout_steps": 16, "total_steps": 1024, "stop_early": False, "report_episodes": 10}
"""A training of four iterations."""

SETTINGS = {"seed": 3, "validation_episodes": 500, "stop_streak": 2, "checkpoint_interval": 1e4}
"""Of a training that is soon done, with one checkpoint."""

ROW = """
steps wall_s steps_per_second episodes success_rate early_rate episode_length final_distance reward policy_loss
explained_variance value_loss entropy kl clip_fraction gradient_norm std
"""

IN_A_FRESH_PROCESS = """
import hashlib, sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from reachlab.jax_setup import use_compilation_cache
use_compilation_cache()
from reachlab.envs.presets import configure
from reachlab.learn.train import train
out = Path(sys.argv[1])
train(configure(seed=5, **{tiny}), out)
(state,) = out.glob("checkpoints/*/state.safetensors")
print(hashlib.sha256(state.read_bytes()).hexdigest())
"""


@dataclass(frozen=True)
class Trained:
    """A finished training, its directory and what was told on the way."""

    result: TrainResult
    out: Path
    told: list[Progress]
    rows: list[dict[str, float]]


def run(out: Path, **settings: object) -> Trained:
    told: list[Progress] = []
    result = train(configure(**settings), out, told.append)  # type: ignore[arg-type]
    rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    return Trained(result, out, told, rows)


@pytest.fixture(scope="module")
def tutorial(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    return run(tmp_path_factory.mktemp("train") / "deep" / "run", **SETTINGS)


# --- the result -----------------------------------------------------------------------------------


def test_the_tutorials_task_is_learnt(tutorial: Trained) -> None:
    report = tutorial.result.report
    assert (report.agent, report.episodes, report.seed) == ("trained", 1000, 3)
    assert report.success_rate >= 0.99
    assert (report.final_error_mm["p95"] or 0) < 100
    assert report.return_mean > 1


def test_training_ends_once_a_validation_holds(tutorial: Trained) -> None:
    assert tutorial.result.validated is True
    assert tutorial.result.steps < 2_000_000
    validations = [row["validation_success"] for row in tutorial.rows if "validation_success" in row]
    assert validations[-1] == 1
    assert tutorial.rows[-1]["validation_success"] == 1


def test_the_checkpoint_holds_the_policy_that_was_reported(tutorial: Trained) -> None:
    directory = RunDirectory(tutorial.out)
    env = Env(directory.read_config(), BATCH)
    policy, runner = load_policy(directory, env), make_runner(env, "trained")
    again, other = (evaluate(env, "trained", policy, seed=seed, runner=runner) for seed in (3, 1234))
    reported = tutorial.result.report
    assert again.success_rate == reported.success_rate
    assert again.final_error_mm == pytest.approx(reported.final_error_mm)
    assert other.success_rate >= 0.99
    assert other.final_error_mm["median"] != reported.final_error_mm["median"]


def test_times_and_speed_fit_together(tutorial: Trained) -> None:
    result = tutorial.result
    assert 0 < result.train_wall_s < result.total_wall_s
    assert result.steps / result.steps_per_second < result.train_wall_s


# --- validations ----------------------------------------------------------------------------------


def loop_of(env: Env, **settings: object) -> Loop:
    config = configure(num_envs=8, **settings)  # type: ignore[arg-type]
    return Loop(config, env, RunDirectory(Path("run")), lambda _: None, 0.0, PPO, None)


def end_episodes(loop: Loop, episodes: int, successes: int) -> None:
    """What an iteration leaves in which so many training episodes ended."""
    loop.now = replace(loop.now, steps=2 * loop.config.loop.iteration_steps)
    loop._count({"episodes": float(episodes), "success_rate": successes / max(episodes, 1)})


@pytest.fixture(scope="module")
def eight() -> Env:
    return Env(configure(num_envs=8), 8)


@pytest.mark.parametrize("stop_success", [0.9, 0.7, 0.98, 0.1])
@pytest.mark.parametrize("episodes", [1000, 50, 10])
def test_a_validation_that_just_reaches_its_success_rate_holds(eight: Env, stop_success: float, episodes: int) -> None:
    loop = loop_of(eight, stop_success=stop_success, validation_episodes=episodes)
    allowed = math.floor(episodes * (1 - Decimal(str(stop_success))))
    assert loop._can_reach(allowed)
    assert not loop._can_reach(allowed + 1)


def test_one_lucky_episode_brings_no_validation_and_no_rank(eight: Env) -> None:
    loop = loop_of(eight)
    end_episodes(loop, 1, 1)
    assert not loop._due()
    assert loop.now.success == 0
    end_episodes(loop, ENOUGH_EPISODES, ENOUGH_EPISODES)
    assert loop._due()
    assert loop.now.success == 1
    end_episodes(loop, 1, 0)
    assert loop.now.success == 1, "one unlucky episode says as little"


@pytest.mark.parametrize(("stop_success", "due"), [(0.5, True), (0.6, True), (0.7, False), (1.0, False)])
def test_validations_begin_where_training_is_as_good_as_is_asked_for(
    eight: Env, stop_success: float, due: bool
) -> None:
    loop = loop_of(eight, stop_success=stop_success)
    end_episodes(loop, 50, 30)
    assert loop._due() is due


@pytest.mark.parametrize(("failures", "left_out"), [(0, 0), (9, 0), (25, 2), (400, 3)])
def test_after_a_validation_that_was_far_off_some_are_left_out(
    eight: Env, monkeypatch: pytest.MonkeyPatch, failures: int, left_out: int
) -> None:
    loop = loop_of(eight, validation_episodes=1000)
    played = SimpleNamespace(success=np.arange(1000) >= failures)
    monkeypatch.setattr("reachlab.learn.loop.run_episodes", lambda *_, **__: played)
    end_episodes(loop, ENOUGH_EPISODES, ENOUGH_EPISODES)
    state: Any = SimpleNamespace(learner=SimpleNamespace(policy=None))
    assert loop._validate(state, cast("Any", None)) == 1 - failures / 1000
    begun, interval = loop.now.steps, loop.config.loop.validation_interval * loop.config.loop.iteration_steps
    due = []
    for count in range(1, 6):
        loop.now = replace(loop.now, steps=begun + count * interval)
        due.append(loop._due())
    assert due == [False] * left_out + [True] * (5 - left_out)


# --- the run directory ----------------------------------------------------------------------------


def test_a_run_directory_holds_checkpoint_configuration_metrics_and_report(tutorial: Trained) -> None:
    out, step = tutorial.out, tutorial.result.steps
    files = sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())
    checkpoint = f"checkpoints/step_{step:012d}"
    expected = [f"{checkpoint}/manifest.json", f"{checkpoint}/state.safetensors"]
    assert files == sorted([*expected, ".lock", "config.json", "metrics.jsonl", "report.json", "robot.json"])
    assert json.loads((out / f"{checkpoint}/manifest.json").read_text())["counters"]["steps"] == step


def test_the_configuration_and_the_report_are_on_disk(tutorial: Trained) -> None:
    saved = json.loads((tutorial.out / "config.json").read_text())
    asked = configure(**SETTINGS)  # type: ignore[arg-type]
    config = settled(asked, make_setup(asked))
    assert saved == json.loads(json.dumps(to_json(config)))
    assert RunDirectory(tutorial.out).read_config() == config
    report = json.loads((tutorial.out / "report.json").read_text())
    assert report == json.loads(json.dumps(tutorial.result.to_json()))
    extra = {"steps", "train_wall_s", "total_wall_s", "steps_per_second", "validated"}
    assert set(report) - set(tutorial.result.report.to_json()) == extra
    (arrays,) = tutorial.out.glob("checkpoints/*/state.safetensors")
    assert report["checkpoint"] == {
        "steps": report["steps"],
        "sha256": hashlib.sha256(arrays.read_bytes()).hexdigest(),
    }


def test_every_iteration_leaves_a_row(tutorial: Trained) -> None:
    steps = [row["steps"] for row in tutorial.rows]
    each = configure().loop.num_envs * configure().loop.rollout_steps
    assert steps == list(range(each, tutorial.result.steps + 1, each))
    assert (np.diff([row["wall_s"] for row in tutorial.rows]) > 0).all()
    for row in tutorial.rows:
        assert sorted(set(row) - {"validation_success"}) == sorted(ROW.split())
        assert np.isfinite(list(row.values())).all()
        assert 0 <= row["success_rate"] <= 1
    assert tutorial.rows[-1]["success_rate"] > 0.95
    assert tutorial.rows[-1]["std"] < tutorial.rows[0]["std"]


def test_a_watch_is_told_every_row(tutorial: Trained) -> None:
    assert [progress.metrics for progress in tutorial.told] == tutorial.rows
    assert [progress.steps for progress in tutorial.told] == [row["steps"] for row in tutorial.rows]
    assert {progress.total_steps for progress in tutorial.told} == {configure().loop.total_steps}


# --- settings -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_sweep_is_not_resumed_as_a_run(tmp_path: Path) -> None:
    (tmp_path / "sweep.json").write_text("{}")
    with pytest.raises(InputError, match="is a sweep: its runs are the folders in"):
        train(configure(**TINY), tmp_path, resume=True)


def test_who_watches_may_end_a_training_or_its_report_and_nothing_is_lost(tmp_path: Path) -> None:
    config, out = configure(**TINY), tmp_path / "run"

    def end(progress: Progress) -> None:
        if progress.steps == 512:
            raise StopAsyncIteration

    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(StopAsyncIteration):
        train(config, out, end)
    assert RunDirectory(out).checkpoint_steps() == [512]
    told = r"interrupted in its report; step 1,024 is saved: `reachlab train --resume \S+` continues from there"
    with pytest.raises(KeyboardInterrupt, match=told):
        train(config, out, watch_report=interrupt, resume=True)
    assert train(config, out, resume=True).report.episodes == 10


def test_the_same_seed_gives_the_same_bytes_in_another_process(tmp_path: Path) -> None:
    script = IN_A_FRESH_PROCESS.format(tiny=TINY)
    command = [sys.executable, "-c", script, str(tmp_path / "there")]
    there = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    here = []
    for seed in (5, 6):
        (state,) = run(tmp_path / str(seed), **TINY, seed=seed).out.glob("checkpoints/*/state.safetensors")
        here.append(hashlib.sha256(state.read_bytes()).hexdigest())
    assert here[0] == there != here[1]
