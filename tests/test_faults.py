"""Faults of processes, files, disks and numbers: noticed, said in one sentence, and nothing good is lost."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import logging
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import safetensors.numpy

from faults import inputs, saves, trainings
from faults.hostile import HOSTILE, hostile_files
from faults.saves import file_limit, make_run, no_space, state_of
from reachlab.cli import main as cli
from reachlab.envs.presets import configure
from reachlab.learn.interrupts import Interrupted
from reachlab.learn.loop import NotFiniteError, Progress
from reachlab.learn.train import train
from reachlab.runs import arrays
from reachlab.runs.checkpoint import MANIFEST, seal
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import read_json, write_json
from reachlab.runs.metrics import Metrics
from reachlab.settings.json_form import to_json
from reachlab.settings.validation import InputError
from reachlab.sims.mujoco import MujocoSimulator
from reachlab.tasks.judging import Outcome
from reachlab.tasks.rewards import REWARDS

pytestmark = pytest.mark.slow

EACH = 64
"""Environment steps of an iteration."""

TINY: dict[str, Any] = {**trainings.TINY, "num_envs": 8, "rollout_steps": 8, "total_steps": 6 * EACH}
"""Six iterations, each saved."""


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)


def warnings_in(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.name.startswith("reachlab")]


def steps_saved(run: Path) -> list[int]:
    return sorted(int(path.name[5:]) for path in (run / "checkpoints").glob("step_*"))


def after(iteration: int, act: Callable[[], object]) -> Callable[[Progress], None]:
    def watch(progress: Progress) -> None:
        if progress.steps == iteration * EACH:
            act()

    return watch


# --- in bulk --------------------------------------------------------------------------------------


def test_a_killed_run_resumes_to_the_same_weights() -> None:
    assert trainings.killed_runs(4).wrong == []


def test_a_save_cut_off_at_any_step_leaves_a_whole_checkpoint() -> None:
    trial = saves.cut_saves()
    assert trial.wrong == []
    assert trial.tried > 50


def test_damage_is_noticed() -> None:
    assert saves.corruptions(1000).wrong == []


def test_damage_would_be_read_if_checksums_were_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    real = arrays.digest

    def as_promised(file: Path, size: int) -> str:
        real(file, size)
        return read_json(file.with_name(MANIFEST))["sha256"][file.name]

    monkeypatch.setattr(arrays, "digest", as_promised)
    assert any("a damaged state was read" in line for line in saves.corruptions(300).wrong)


def test_a_disk_without_room_leaves_earlier_checkpoints_as_they_were() -> None:
    assert saves.failing_saves(20).wrong == []


def test_a_number_that_is_not_finite_is_noticed_wherever_it_is_and_changes_nothing() -> None:
    trial = trainings.not_finite()
    assert trial.wrong == []
    assert trial.tried >= 40


def test_inputs_edited_by_hand_are_refused_or_harmless() -> None:
    trials = (inputs.edited_exports(20), inputs.edited_runs(15), inputs.edited_robots(20), inputs.wrong_seeds())
    assert [trial.wrong for trial in trials] == [[], [], [], []]


def test_hostile_files_are_refused() -> None:
    assert len(HOSTILE) >= 40
    # Times depend on the machine; the benchmark holds them.
    assert [line for line in hostile_files().wrong if not line.endswith(" s")] == []


# --- configurations that mean harm, in a run that is otherwise sound -----------------------------

HARMFUL: dict[str, dict[str, Any]] = {
    "num_envs": {"ppo": {"num_envs": 10**9}},
    "layers": {"ppo": {"hidden": [64] * 1000}},
    "width": {"ppo": {"hidden": [10**9]}},
    "steps of an episode": {"rules": {"max_steps": 10**30}},
    "steps of the engine": {"sim": "mujoco", "physics": {"physics_steps": 10**30}},
    "a number of 400 digits": {"ppo": {"anneal_steps": 10**400}},
    "a name of 5000 letters": {"robot": "a" * 5000 + ".xml"},
    "a name with a zero": {"robot": "\0"},
    "a tool with a zero": {"rules": {"tool": "\0"}},
}


@pytest.mark.parametrize("verb", [["eval"], ["train", "--resume"]], ids=" ".join)
@pytest.mark.parametrize("harm", HARMFUL.values(), ids=HARMFUL)
def test_a_harmful_configuration_is_refused_though_its_checkpoint_fits(
    tmp_path: Path, verb: list[str], harm: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "run").path
    config: dict[str, Any] = json.loads(json.dumps(to_json(configure())))
    for name, value in harm.items():
        config[name] = config[name] | value if isinstance(value, dict) else value
    write_json(run / "config.json", config)
    for folder in (run / "checkpoints").iterdir():
        write_json(folder / MANIFEST, seal(read_json(folder / MANIFEST) | {"config": config}))
    assert cli.main([*verb, str(run)]) == cli.WRONG_INPUT
    said = str(capsys.readouterr().err)
    assert said.startswith("reachlab: ")
    assert said.count("\n") == 1


@pytest.mark.parametrize("name", ["metrics.jsonl", ".lock"])
@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda path: path.symlink_to("/dev/zero")])
def test_what_is_no_plain_file_is_not_written_to(
    tmp_path: Path, name: str, make: Callable[[Path], object], capsys: pytest.CaptureFixture[str]
) -> None:
    config = configure(**TINY)
    run = RunDirectory(tmp_path / "run")
    run.create(config)
    make(run.path / name)
    assert cli.main(["train", "--resume", str(run.path)]) == cli.WRONG_INPUT
    said = str(capsys.readouterr().err)
    assert said.count("\n") == 1
    assert "cannot be" in said


# --- training on a bad disk -----------------------------------------------------------------------


def test_a_failed_save_is_told_and_tried_again(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    out, disk = tmp_path / "run", contextlib.ExitStack()

    def watch(progress: Progress) -> None:
        if progress.steps == 3 * EACH:
            disk.enter_context(no_space(0))
        if progress.steps == 5 * EACH:
            assert steps_saved(out) == [EACH, 2 * EACH]
            disk.close()

    with disk:
        train(configure(**TINY), out, watch)
    assert len(warnings_in(caplog)) == 2
    assert all("cannot be written to" in said and "No space left on device" in said for said in warnings_in(caplog))
    assert steps_saved(out)[-1] == 6 * EACH
    rows = [json.loads(line)["steps"] for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert rows == [n * EACH for n in range(1, 7)]


def test_a_training_that_cannot_save_its_end_fails_and_resumes_later(tmp_path: Path) -> None:
    out, disk = tmp_path / "run", contextlib.ExitStack()
    with disk, pytest.raises(InputError, match=r"the last checkpoint cannot be written .*No space.* resume with"):
        train(configure(**TINY), out, after(5, lambda: disk.enter_context(no_space(0))))
    assert steps_saved(out)[-1] == 4 * EACH
    assert train(configure(**TINY), out, resume=True).steps == 6 * EACH


def test_a_limit_of_file_sizes_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    out, limit = tmp_path / "run", contextlib.ExitStack()
    with limit:
        train(configure(**TINY), out, _limited(limit, out))
    assert any("File too large" in said for said in warnings_in(caplog))
    assert steps_saved(out)[-1] == 6 * EACH


def _limited(limit: contextlib.ExitStack, out: Path) -> Callable[[Progress], None]:
    def watch(progress: Progress) -> None:
        if progress.steps == 2 * EACH:
            limit.enter_context(file_limit(5000))
        if progress.steps == 4 * EACH:
            assert steps_saved(out) == [EACH]
            limit.close()

    return watch


def test_an_interrupted_run_on_a_full_disk_says_what_is_saved(tmp_path: Path) -> None:
    disk = contextlib.ExitStack()

    def fill_and_ask() -> None:
        disk.enter_context(no_space(0))
        os.kill(os.getpid(), signal.SIGTERM)

    with disk, pytest.raises(Interrupted, match="interrupted at step 192; step 128 is saved"):
        train(configure(**TINY), tmp_path / "run", after(3, fill_and_ask))


def test_a_report_that_cannot_be_written_is_shown_all_the_same_with_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    train(configure(**TINY), tmp_path / "run")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    assert cli.main(["eval", str(tmp_path / "run"), "--episodes", "2"]) == cli.DONE
    shown, said = capsys.readouterr()
    assert "2 held-out targets" in shown
    assert said.count("cannot be written: No space left on device.") == 1


def test_rows_that_find_no_room_wait(tmp_path: Path) -> None:
    with Metrics(tmp_path / "metrics.jsonl") as metrics:
        with no_space(0):
            metrics.write({"steps": 1})
            with pytest.raises(OSError, match="No space"):
                metrics.sync()
        metrics.write({"steps": 2})
    assert (tmp_path / "metrics.jsonl").read_text() == '{"steps": 1}\n{"steps": 2}\n'


# --- numbers that are not finite ------------------------------------------------------------------


def breaking(rules: Any, outcome: Outcome) -> dict[str, jnp.ndarray]:
    """Pays nothing finite from an episode's 20th step on."""
    return REWARDS["dense"](rules, outcome) | {"broken": jnp.where(outcome.timeout, jnp.nan, 0.0)}


def test_a_reward_that_is_not_finite_stops_training_with_the_last_good_state_saved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    words = ["--num-envs", "8", "--rollout-steps", "8", "--no-stop-early", "--hidden", "8", "--max-steps", "20"]
    monkeypatch.setitem(REWARDS, "breaking", breaking)
    assert cli.main(["train", "--reward", "breaking", "--out", str(out), *words]) == cli.NOT_FINITE
    said = str(capsys.readouterr().err).splitlines()[-1]
    assert "training stopped after step 128: a number is not finite in: reward, gradient" in said
    assert f"`reachlab train --resume {out}` continues from there" in said
    assert "it stops there again" in said
    assert steps_saved(out) == [128]
    saved = safetensors.numpy.load((out / "checkpoints/step_000000000128/state.safetensors").read_bytes())
    assert all(np.isfinite(array).all() for array in saved.values() if array.dtype.kind == "f")
    rollout = safetensors.numpy.load((out / "not_finite.safetensors").read_bytes())
    assert np.isnan(rollout["reward"]).any()
    assert np.isfinite(rollout["observation"]).all()
    assert rollout["observation"].shape[:2] == (8, 8)


def test_an_engine_that_breaks_stops_training_with_the_last_good_state_saved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = MujocoSimulator.step, []

    def step(self: MujocoSimulator, state: Any, command: Any) -> Any:
        calls.append(None)
        if len(calls) == 20:
            state = dataclasses.replace(state, engine=jnp.full_like(state.engine, 0xFFFFFFFF))
        return real(self, state, command)

    monkeypatch.setattr(MujocoSimulator, "step", step)
    monkeypatch.chdir(tmp_path)  # the engine writes a log of its own
    config = configure(**TINY, sim="mujoco")
    with pytest.raises(NotFiniteError, match=r"stopped after step 128: MuJoCo.*environment 0"):
        train(config, tmp_path / "run")
    assert steps_saved(tmp_path / "run")[-1] == 128
    rollout = safetensors.numpy.load((tmp_path / "run/not_finite.safetensors").read_bytes())
    assert len(rollout["reward"]) == 3
    assert train(config, tmp_path / "run", resume=True).steps == 6 * EACH


def test_a_state_that_is_not_finite_is_not_loaded(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", ())
    run.write_checkpoint(7, {"learner": np.array([1.0, np.nan], np.float32)})
    with pytest.raises(InputError, match="holds numbers at 'learner' that are not finite"):
        run.read_checkpoint("learner", np.zeros(2, np.float32))


def test_a_state_too_large_to_be_read_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = make_run(tmp_path / "run", ())
    monkeypatch.setattr(arrays, "SIZE_LIMIT", arrays.HEADER_LIMIT)
    with pytest.raises(InputError, match="choose fewer environments or narrower layers"):
        run.write_checkpoint(1, state_of(1))
