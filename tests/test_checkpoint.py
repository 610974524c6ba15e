"""Run directories: what is written comes back, and what is damaged is refused."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors
import safetensors.numpy

from reachlab import sims
from reachlab.cli import main as cli
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.jax_setup import jit
from reachlab.learn.checkpointing import UnwritableError
from reachlab.learn.load import load_policy
from reachlab.learn.ppo_method import TrainState, initial_state
from reachlab.learn.train import _held
from reachlab.robots.loading import load_robot
from reachlab.runs.checkpoint import Counters, seal
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import write_json, written
from reachlab.runs.lock import locked
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError

STEP = "checkpoints/step_000000000512"
CENTRE = "learner/policy/centre"


@pytest.fixture(scope="module")
def config() -> RunConfig:
    return configure(num_envs=8, rollout_steps=8, seed=3, max_steps=30)


@pytest.fixture(scope="module")
def env(config: RunConfig) -> Env:
    return Env(config, 8)


@pytest.fixture(scope="module")
def state(env: Env, config: RunConfig) -> TrainState:
    return env.compile_whole(lambda seed: initial_state(env, config, seed))(np.uint32(config.seed))


@pytest.mark.parametrize("keep", [1, 2])
def test_a_checkpoint_is_kept_beside_later_ones_that_are_damaged(keep: int, config: RunConfig, tmp_path: Path) -> None:
    run, state = RunDirectory(tmp_path / "run"), {"x": np.zeros(9)}
    run.create(config)

    def write(step: int, success: float) -> None:
        run.write_checkpoint(step, state, Counters(step, success=success, validated=True), keep)

    write(100, 1.0)
    for step in (200, 300):
        write(step, 0.1)
    for folder in run.checkpoints.glob("step_*[23]00"):
        (folder / "state.safetensors").write_bytes(b"cut")
    for step in (150, 160, 170):
        write(step, 0.5)
        assert run.read_state(state)[0].steps == step
    assert 100 in run.checkpoint_steps(), "the best"
    assert len(run.checkpoint_steps()) == keep + 1


def test_a_damaged_checkpoint_is_not_the_best(config: RunConfig, tmp_path: Path) -> None:
    run, state = RunDirectory(tmp_path / "run"), {"x": np.zeros(9)}
    run.create(config)
    for step, success in enumerate((1.0, 0.9, 0.1, 0.1), start=1):
        run.write_checkpoint(step, state, Counters(step, success=success, validated=True), 2)
        if step == 1:
            (run.checkpoints / "step_000000000001" / "state.safetensors").write_bytes(b"cut")
    assert run.checkpoint_steps() == [2, 3, 4]


def test_a_file_of_an_arm_may_lie_elsewhere_where_its_hash_tells_that_it_is_the_same(
    config: RunConfig, tmp_path: Path
) -> None:
    text = load_robot("so101").model.file.read_text()
    before, after = tmp_path / "before.xml", tmp_path / "after.xml"
    before.write_text(text)
    run, state = RunDirectory(tmp_path / "run"), {"x": np.zeros(9)}
    run.create(replace(config, robot=str(before)))
    run.write_checkpoint(512, state)
    before.rename(after)
    with pytest.raises(InputError, match=r"before\.xml', of run '.*', does not exist: .* into '.*config\.json'"):
        run.read_config()
    run.config_file.write_text(run.config_file.read_text().replace(str(before), str(after)))
    run.read_config()
    assert run.checkpoint_steps() == [512]
    after.write_text(text.replace("mass", "mass ", 1))
    with pytest.raises(InputError, match="was trained with another arm"):
        run.read_config()
    run.robot_file.unlink()
    with pytest.raises(InputError, match=r"does not fit the run's configuration: robot is '.*before\.xml'"):
        run.checkpoint_steps()


@pytest.fixture(scope="module")
def finished(config: RunConfig, state: TrainState, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = RunDirectory(tmp_path_factory.mktemp("checkpoint") / "run")
    run.create(config)
    run.write_checkpoint(512, state)
    return run.path


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    shutil.copytree(finished, tmp_path / "run")
    return tmp_path / "run"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def plain(tree: object) -> list[np.ndarray]:
    return [
        np.asarray(jax.random.key_data(leaf) if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key) else leaf)
        for leaf in jax.tree.leaves(tree)
    ]


# --- there and back -------------------------------------------------------------------------------


def test_configuration_and_training_state_come_back_bit_for_bit(
    finished: Path, config: RunConfig, state: TrainState
) -> None:
    assert RunDirectory(finished).read_config() == config
    for part in ("learner", "env", "key"):
        saved = vars(state)[part]
        loaded = RunDirectory(finished).read_checkpoint(part, jax.eval_shape(lambda tree: tree, saved))
        assert jax.tree.structure(loaded) == jax.tree.structure(saved)
        for one, other in zip(plain(loaded), plain(saved), strict=True):
            assert one.dtype == other.dtype
            assert np.array_equal(one, other)


def test_a_loaded_policy_acts_as_the_saved_one(finished: Path, env: Env, state: TrainState) -> None:
    act, observation = jit(lambda policy, observation: policy.act(observation)), env.observe_now(state.env)
    assert np.array_equal(
        act(load_policy(RunDirectory(finished), env), observation), act(state.learner.policy, observation)
    )


def test_the_newest_checkpoint_is_read(run: Path) -> None:
    directory = RunDirectory(run)
    for step in (1_000_000, 999):
        directory.write_checkpoint(step, {"step": np.array([step])})
    assert directory.read_checkpoint("step", np.array([0])).tolist() == [1_000_000]


def test_no_checkpoint_is_pickled(finished: Path) -> None:
    arrays = safetensors.numpy.load((finished / STEP / "state.safetensors").read_bytes())
    assert all(array.dtype.kind in "fiub" for array in arrays.values())
    manifest = json.loads((finished / STEP / "manifest.json").read_text())
    assert manifest["format"] == 2
    assert manifest["counters"]["steps"] == 512
    assert "jax" in manifest["versions"]


# --- damage ---------------------------------------------------------------------------------------


def flip(run: Path) -> None:
    file = run / STEP / "state.safetensors"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)


def truncate(run: Path) -> None:
    file = run / STEP / "state.safetensors"
    file.write_bytes(file.read_bytes()[:-100])


def reseal(run: Path, data: bytes) -> None:
    """Replace the arrays, with a checksum that fits."""
    (run / STEP / "state.safetensors").write_bytes(data)
    manifest = json.loads((run / STEP / "manifest.json").read_text())
    manifest["sha256"]["state.safetensors"] = hashlib.sha256(data).hexdigest()
    manifest["sizes"]["state.safetensors"] = len(data)
    (run / STEP / "manifest.json").write_text(json.dumps(seal(manifest)))


def edit_arrays(change: Callable[[dict[str, np.ndarray]], object]) -> Callable[[Path], None]:
    def damage(run: Path) -> None:
        arrays = safetensors.numpy.load((run / STEP / "state.safetensors").read_bytes())
        change(arrays)
        reseal(run, safetensors.numpy.save(arrays))

    return damage


def edit_config(change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    def damage(run: Path) -> None:
        config = json.loads((run / "config.json").read_text())
        change(config)
        (run / "config.json").write_text(json.dumps(config))

    return damage


def write(name: str, data: bytes) -> Callable[[Path], None]:
    def damage(run: Path) -> None:
        (run / name).write_bytes(data)

    return damage


def remove(name: str) -> Callable[[Path], None]:
    def damage(run: Path) -> None:
        path = run / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()

    return damage


DAMAGES: dict[str, tuple[Callable[[Path], None], str]] = {
    "a flipped bit": (flip, "is damaged: its checksum does not fit"),
    "a cut file": (truncate, "is damaged"),
    "no arrays": (remove(f"{STEP}/state.safetensors"), "is damaged: it cannot be read"),
    "arrays that are none": (lambda run: reseal(run, b"not tensors"), "is damaged: its header is too large"),
    "an array too few": (edit_arrays(lambda a: a.pop(CENTRE)), f"does not fit the run's configuration at '{CENTRE}'"),
    "an array of another type": (
        edit_arrays(lambda a: a.update({CENTRE: a[CENTRE].astype(np.float64)})),
        f"does not fit the run's configuration at '{CENTRE}'",
    ),
    "another shape": (edit_config(lambda c: c["learner"].update(hidden=[32])), "does not fit the run's configuration"),
    "no manifest": (remove(f"{STEP}/manifest.json"), "manifest.json' is missing"),
    "a manifest that is no JSON": (write(f"{STEP}/manifest.json", b"{"), "manifest.json' is not JSON"),
    "a manifest without a checksum": (write(f"{STEP}/manifest.json", b"{}"), "is damaged"),
    "no configuration": (remove("config.json"), "config.json' is missing"),
    "a setting twice": (write("config.json", b'{"seed": 1, "seed": 2}'), "it holds 'seed' twice"),
    "a bottomless configuration": (write("config.json", b"[" * 100_000), "config.json' is not JSON"),
    "a configuration that is a list": (write("config.json", b"[]"), "config.json' is not usable: .*got list"),
    "a setting too few": (edit_config(lambda c: c.pop("seed")), "seed is 3 in the checkpoint and 0 in the run"),
    "a setting too many": (edit_config(lambda c: c.update(colour="red")), "unknown setting 'colour'"),
    "a setting of another type": (edit_config(lambda c: c["loop"].update(num_envs="x")), "num_envs must be a whole"),
    "a setting out of range": (edit_config(lambda c: c["ppo"].update(gamma=2.0)), "gamma must be at least 0 and"),
    "a name that does not exist": (edit_config(lambda c: c["rules"].update(reward="gold")), "reward 'gold' is not one"),
    "a robot that is gone": (
        edit_config(lambda c: c.update(robot="gone.xml")),
        "gone.xml', of .*, does not exist",
    ),
    "no checkpoint": (remove("checkpoints"), "holds no checkpoint"),
    "no run": (remove("."), "does not exist: train one with"),
}


@pytest.mark.parametrize(("damage", "sentence"), DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_run_is_refused_in_one_sentence_and_nothing_is_written(
    run: Path, damage: Callable[[Path], None], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    damage(run)
    before = contents(run.parent)
    assert cli.main(["eval", str(run), "--episodes", "5"]) == cli.WRONG_INPUT
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1, said.err
    assert said.err.startswith("reachlab: ")
    assert re.search(sentence, said.err), said.err
    assert contents(run.parent) == before


# --- reports --------------------------------------------------------------------------------------


def write_reports(run: Path, writers: range, times: int = 20) -> None:
    for _ in range(times):
        for writer in writers:
            RunDirectory(run).write_report("same", {"writer": writer}, {"rows": np.full(1000, writer)})


def test_reports_written_at_once_are_whole_and_of_one_writer(tmp_path: Path) -> None:
    (tmp_path / "reports").mkdir()
    (tmp_path / "reports/.same.json.0123.tmp").write_text("{")  # of a writer that was killed: it is removed
    write_reports(tmp_path, range(1), 1)
    with ThreadPoolExecutor(3) as threads, ProcessPoolExecutor(1, get_context("spawn")) as processes:
        jobs = [threads.submit(write_reports, tmp_path, range(i, i + 1)) for i in (1, 2, 3)]
        jobs += [processes.submit(write_reports, tmp_path, range(4, 5))]
        while not all(job.done() for job in jobs):
            assert json.loads((tmp_path / "reports/same.json").read_text())["writer"] in range(5)
            with safetensors.safe_open(tmp_path / "reports/same.safetensors", "numpy") as file:
                report = json.loads(file.metadata()["report"])
                assert set(file.get_tensor("rows")) == {report["writer"]}, "a report with the episodes of another"
        for job in jobs:
            job.result()
    writer = json.loads((tmp_path / "reports/same.json").read_text())["writer"]
    assert set(safetensors.numpy.load_file(tmp_path / "reports/same.safetensors")["rows"]) == {writer}
    assert {path.name for path in (tmp_path / "reports").iterdir()} == {".lock", "same.json", "same.safetensors"}


@pytest.mark.slow
def test_a_report_names_the_checkpoint_of_its_policy(run: Path, state: TrainState) -> None:
    evaluate = ["eval", str(run), "--episodes", "5", "--agent", "trained", "zero"]
    file = run / "reports/kinematic-{}-1.json"
    named = []
    for step in (512, 600):
        RunDirectory(run).write_checkpoint(step, state, keep=1)
        assert cli.main(evaluate) == cli.DONE
        named.append(json.loads(Path(str(file).format("trained")).read_text())["checkpoint"])
        arrays = run / f"checkpoints/step_{step:012d}/state.safetensors"
        assert named[-1] == {"steps": step, "sha256": hashlib.sha256(arrays.read_bytes()).hexdigest()}
    assert json.loads(Path(str(file).format("zero")).read_text())["checkpoint"] is None


def test_all_simulators_of_an_evaluation_judge_one_checkpoint(
    run: Path, state: TrainState, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    real, step = RunDirectory.write_report, iter(range(1000, 2000))

    def while_training_goes_on(self: RunDirectory, *report: Any) -> None:
        real(self, *report)
        self.write_checkpoint(next(step), state, keep=1)

    monkeypatch.setattr(RunDirectory, "write_report", while_training_goes_on)
    monkeypatch.setattr(sims, "SIMULATORS", {name: sims.SIMULATORS[name] for name in ("kinematic", "mujoco")})
    assert cli.main(["eval", str(run), "--sim", "all", "--episodes", "2", "--json"]) == cli.DONE
    assert [report["checkpoint"]["steps"] for report in json.loads(capsys.readouterr().out)] == [512, 512]


# --- writes that fail -----------------------------------------------------------------------------


def fail(*_: object) -> None:
    raise OSError(28, "No space left on device")


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "report.json"
    write_json(file, {"old": 1})
    with monkeypatch.context() as broken:
        broken.setattr(os, "fsync", fail)
        with pytest.raises(OSError, match="No space left"):
            write_json(file, {"new": 2})
    assert json.loads(file.read_text()) == {"old": 1}
    write_json(file, {"new": 2})
    assert json.loads(file.read_text()) == {"new": 2}
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]


def test_a_checkpoint_is_complete_or_absent(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory = RunDirectory(run)
    with monkeypatch.context() as broken:
        broken.setattr(os, "fsync", fail)
        with pytest.raises(OSError, match="No space left"):
            directory.write_checkpoint(600, {"step": np.array([600])})
    assert [path.name for path in (run / "checkpoints").glob("step_*")] == ["step_000000000512"]
    directory.write_checkpoint(600, {"step": np.array([600])})
    assert directory.read_checkpoint("step", np.array([0])).tolist() == [600]


@pytest.mark.parametrize("out", [".", ""])
def test_an_out_that_exists_is_refused_in_one_sentence_and_left_as_it_is(
    out: str, run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(run)
    before = contents(run)
    assert cli.main(["train", "--out", out, "--num-envs", "8"]) == cli.WRONG_INPUT
    assert re.fullmatch(r"reachlab: run directory '.*' exists and is not overwritten: .*\n", capsys.readouterr().err)
    assert contents(run) == before


def test_a_training_that_never_began_is_not_in_the_way(tmp_path: Path, config: RunConfig) -> None:
    unbegun = RunDirectory(tmp_path / "run")
    unbegun.create(config)
    with locked(unbegun.path), pytest.raises(InputError, match="is being trained by"):
        unbegun.refuse_existing()
    unbegun.metrics_file.write_text("{}\n")
    with pytest.raises(InputError, match="exists and is not overwritten"):
        unbegun.refuse_existing()
    unbegun.metrics_file.write_text("")
    unbegun.refuse_existing()
    assert not unbegun.path.exists()


def test_what_is_to_be_resumed_stays_though_nothing_was_saved(tmp_path: Path, config: RunConfig) -> None:
    run = RunDirectory(tmp_path / "run")
    for error, stays in ((UnwritableError("last checkpoint: no room", "train"), True), (InputError("refused"), False)):
        run.refuse_existing()
        run.create(config)
        with pytest.raises(InputError), _held(run, new=True):
            raise error
        assert run.path.exists() == stays


def test_one_of_many_threads_makes_a_directory_and_leaves_it(tmp_path: Path, config: RunConfig) -> None:
    def make(_: int) -> str | None:
        try:
            RunDirectory(tmp_path / "run").create(config)
        except InputError as error:
            return str(error)
        return None

    with ThreadPoolExecutor(8) as pool:
        refused = list(filter(None, pool.map(make, range(8))))
    assert len(refused) < 8
    assert {one.name for one in tmp_path.iterdir()} == {"run"}
    assert (tmp_path / "run/config.json").is_file()


@pytest.mark.parametrize(("name", "why"), [("x" * 5000, "File name too long"), ("file/run", "Not a directory")])
def test_a_directory_that_cannot_be_made_is_refused(tmp_path: Path, config: RunConfig, name: str, why: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=f"cannot be made: {why}"):
        RunDirectory(tmp_path / name).create(config)


# --- pictures and films ---------------------------------------------------------------------------


def _half_written(file: Path) -> None:
    file.write_text("half")
    raise OSError("full")


def test_a_film_is_the_old_file_or_the_new_one(tmp_path: Path) -> None:
    file = tmp_path / "film.mp4"
    for content in ("old", "new"):
        with written("the video", file) as part:
            assert part.suffix == ".mp4"
            part.write_text(content)
        with pytest.raises(InputError, match="full"), written("the video", file) as part:
            _half_written(part)
        assert file.read_text() == content
    assert list(tmp_path.iterdir()) == [file]
    with pytest.raises(InputError, match="the video cannot be written to"), written("the video", file / "a.mp4"):
        pytest.fail("filmed for nothing")
