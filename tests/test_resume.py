"""A training that was interrupted resumes as if it had never been."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reachlab.cli import main as cli
from reachlab.envs.presets import configure
from reachlab.envs.setup import make_setup, settled
from reachlab.jax_setup import VARIABLE, threads
from reachlab.learn.interrupts import ASKING, Interrupted
from reachlab.learn.loop import Loop, Progress
from reachlab.learn.train import train
from reachlab.runs.checkpoint import Counters, seal
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import read_json, write_json
from reachlab.runs.lock import NAME, locked
from reachlab.runs.metrics import cut_metrics
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError

pytestmark = pytest.mark.slow

EACH = 256
"""Environment steps of an iteration."""

TINY: dict[str, Any] = {"num_envs": 16, "rollout_steps": 16, "total_steps": 8 * EACH, "hidden": (8,)}
TINY |= {"validation_episodes": 4, "report_episodes": 4, "max_steps": 30}

RUNS: dict[str, dict[str, Any]] = {
    "kinematic": {},
    "pybullet": {"sim": "pybullet", "num_envs": 2, "rollout_steps": 128, "max_steps": 100},
    "track": {"task": "track", "sim": "mujoco", "settle_steps": 10},
    "memory": {"memory": 8, "goal_lost": 0.3, "observation": "state"},
    "clutter": {"task": "clutter", "sim": "mujoco", "obstacles": (1, 3)},
}
"""What `precise` and `pose` save `clutter` saves too."""


def at(iteration: int, act: Callable[[], object]) -> Callable[[Progress], None]:
    """A watch that acts after the n-th iteration it is called for."""
    seen: list[int] = []

    def watch(progress: Progress) -> None:
        seen.append(progress.steps)
        if len(seen) == iteration:
            act()

    return watch


def ask(number: int) -> Callable[[], None]:
    return lambda: os.kill(os.getpid(), number)


def weights(run: Path) -> bytes:
    return (max((run / "checkpoints").glob("step_*")) / "state.safetensors").read_bytes()


def rows(run: Path) -> list[dict[str, float]]:
    """Metrics without times."""
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return [{name: x for name, x in line.items() if name not in ("wall_s", "steps_per_second")} for line in lines]


def walls(run: Path) -> list[float]:
    return [json.loads(line)["wall_s"] for line in (run / "metrics.jsonl").read_text().splitlines()]


def interrupted(config: RunConfig, out: Path, iteration: int = 3, number: int = signal.SIGINT) -> Interrupted:
    with pytest.raises(Interrupted) as caught:
        train(config, out, at(iteration, ask(number)), resume=out.exists())
    return caught.value


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("resume") / "unbroken"
    train(configure(**TINY, stop_early=False), out)
    return out


@pytest.fixture
def config() -> RunConfig:
    return configure(**TINY, stop_early=False)


# --- exactly --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", RUNS)
def test_a_run_stopped_once_or_twice_ends_with_the_weights_and_report_of_one_never_stopped(
    tmp_path: Path, name: str
) -> None:
    config = configure(**{**TINY, "stop_early": False, **RUNS[name]})
    whole = train(config, tmp_path / "whole")
    for iteration in (3, 2) if name == "kinematic" else (3,):
        interrupted(config, tmp_path / "parts", iteration)
    before = walls(tmp_path / "parts")
    parts = train(config, tmp_path / "parts", resume=True)
    assert weights(tmp_path / "parts") == weights(tmp_path / "whole")
    assert rows(tmp_path / "parts") == rows(tmp_path / "whole")
    assert parts.report.final_error_mm == whole.report.final_error_mm
    after = walls(tmp_path / "parts")
    assert after[: len(before)] == before, "time is counted across an interruption"
    assert after == sorted(after)
    assert parts.train_wall_s > after[-1]


def test_validations_in_a_row_are_counted_across_an_interruption(tmp_path: Path) -> None:
    config = configure(**{**TINY, "total_steps": 100_000}, success_distance=2.0, stop_success=0.5, stop_streak=3)
    whole = train(config, tmp_path / "whole")
    assert whole.validated
    interrupted(config, tmp_path / "parts", 4)
    parts = train(config, tmp_path / "parts", resume=True)
    assert (parts.validated, parts.steps) == (True, whole.steps)
    assert rows(tmp_path / "parts") == rows(tmp_path / "whole")
    assert weights(tmp_path / "parts") == weights(tmp_path / "whole")


def test_rows_after_the_checkpoint_are_written_once_and_leftovers_of_a_killed_save_cleared(
    tmp_path: Path, config: RunConfig, unbroken: Path
) -> None:
    interrupted(config, tmp_path / "run", 3)
    with (tmp_path / "run/metrics.jsonl").open("a") as file:
        file.write(json.dumps({"steps": 4 * EACH}) + "\n" + '{"steps": 12')
    left = tmp_path / "run/checkpoints/.step_000000000999.tmp"
    left.mkdir()
    (left / "state.safetensors").write_bytes(b"half")
    train(config, tmp_path / "run", resume=True)
    assert rows(tmp_path / "run") == rows(unbroken)
    assert not list((tmp_path / "run/checkpoints").glob(".*"))


def test_without_a_checkpoint_it_starts_from_the_beginning(tmp_path: Path, config: RunConfig, unbroken: Path) -> None:
    RunDirectory(tmp_path / "run").create(settled(config, make_setup(config)))
    (tmp_path / "run/metrics.jsonl").write_text('{"steps": 256}\n')
    train(config, tmp_path / "run", resume=True)
    assert weights(tmp_path / "run") == weights(unbroken)
    assert rows(tmp_path / "run") == rows(unbroken)


def test_a_damaged_newest_checkpoint_gives_way_to_the_one_before(
    tmp_path: Path, unbroken: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = configure(**TINY, stop_early=False, checkpoint_interval=0.0)
    interrupted(config, tmp_path / "run", 4)
    newest = tmp_path / f"run/checkpoints/step_{4 * EACH:012d}"
    (newest / "state.safetensors").write_bytes(b"")
    train(config, tmp_path / "run", resume=True)
    assert weights(tmp_path / "run") == weights(unbroken)
    (said,) = [record.getMessage() for record in caplog.records if "directory" in record.name]
    assert "is damaged: its size does not fit" in said
    assert f"step_{3 * EACH:012d}" in said


# --- what is kept ---------------------------------------------------------------------------------


def test_the_newest_and_the_best_are_kept(tmp_path: Path, config: RunConfig) -> None:
    run = RunDirectory(tmp_path / "run")
    run.create(config)
    successes = {1: (0.99, False), 2: (0.5, True), 3: (0.4, True), 4: (0.9, False), 5: (0.1, False), 6: (0.2, False)}
    for step, (success, validated) in successes.items():
        counters = Counters(step, success=success, validated=validated)
        run.write_checkpoint(step, {"x": np.zeros(3)}, counters, keep=2)
    assert sorted(path.name[-1] for path in run.checkpoints.iterdir()) == ["2", "5", "6"]


# --- signals --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_saves_and_leaves_after_the_iteration_and_no_damaged_run_is_begun_anew(
    tmp_path: Path, config: RunConfig, number: int, status: int
) -> None:
    before = {each: signal.getsignal(each) for each in ASKING}
    said = interrupted(config, tmp_path / "run", 2, number)
    assert said.status == status
    assert "interrupted at step 512; step 512 is saved: `reachlab train --resume" in str(said)
    assert [row["steps"] for row in rows(tmp_path / "run")] == [256, 512]
    after = {each: signal.getsignal(each) for each in ASKING}
    signal.signal(signal.SIGHUP, before[signal.SIGHUP])
    assert after == before | ({signal.SIGHUP: signal.SIG_IGN} if number == signal.SIGHUP else {})
    with locked(tmp_path / "run"):
        pass  # given back
    (newest,) = (tmp_path / "run/checkpoints").iterdir()
    (newest / "state.safetensors").write_bytes(b"")
    with pytest.raises(InputError, match="is damaged"):
        train(config, tmp_path / "run", resume=True)


TWICE = """
import os, signal, sys
from pathlib import Path
from reachlab.envs.presets import configure
from reachlab.learn.interrupts import Interrupts
with Interrupts():
    os.kill(os.getpid(), signal.SIGINT)
    print("still here", flush=True)
    os.kill(os.getpid(), signal.SIGINT)
    print("never said", flush=True)
"""


def test_a_second_ctrl_c_leaves_at_once() -> None:
    done = subprocess.run([sys.executable, "-c", TWICE], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (130, "still here\n")


# --- the command line -----------------------------------------------------------------------------


def say(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    capsys.readouterr()
    status = cli.main([str(word) for word in words])
    out, err = capsys.readouterr()
    return status, str(out), str(err)


def test_a_finished_run_says_so(unbroken: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert say(capsys, "train", "--resume", unbroken, "--num-envs", 16, "--seed=0")[0] == 0, "its own settings"
    status, out, err = say(capsys, "train", "--resume", unbroken, "--json")
    assert status == 0
    assert json.loads(out) == json.loads((unbroken / "report.json").read_text())
    further = f"train its policy further with --initial-policy {unbroken}, as a new run"
    assert err == f"Run {unbroken} is finished: {unbroken / 'report.json'} holds its report; {further}.\n"


def test_a_run_whose_report_is_cut_short_is_not_called_finished(
    unbroken: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Path(shutil.copytree(unbroken, tmp_path / "run"))
    (run / "report.json").write_bytes((unbroken / "report.json").read_bytes()[:100])
    status, out, err = say(capsys, "train", "--resume", run)
    assert (status, out) == (2, "")
    assert err == f"reachlab: '{run / 'report.json'}' is not JSON that can be read.\n"


def test_what_begins_is_told_before_anything_is_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen, config, prepare = list[str](), configure(**TINY), Loop.prepare

    def prepared(loop: Loop, *, resume: bool) -> Any:
        seen.append("compiled")
        return prepare(loop, resume=resume)

    monkeypatch.setattr(Loop, "prepare", prepared)
    train(config, tmp_path / "run", lambda _: seen.append("iteration"), begun=lambda: seen.append("begun"), base=config)
    assert seen[:3] == ["begun", "compiled", "iteration"]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--num-envs", "32"], "was begun with num_envs 16 and cannot be resumed with 32: leave the setting out"),
        (["--sim", "mujoco"], "was begun with sim 'kinematic' and cannot be resumed with 'mujoco'"),
        (["--deterministic"], "was begun with deterministic False and cannot be resumed with True"),
        (["--out", "elsewhere"], "leave --out out"),
    ],
)
def test_other_settings_than_the_runs_are_refused(
    unbroken: Path, words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = say(capsys, "train", "--resume", unbroken, *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert sentence in err


def test_a_run_that_is_none_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, _, err = say(capsys, "train", "--resume", tmp_path / "none")
    assert status == 2
    assert "does not exist: train one with" in err


# --- one trainer ----------------------------------------------------------------------------------

HOLD = """
import sys
from pathlib import Path
from reachlab.runs.lock import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_trainer_is_refused_and_a_dead_ones_lock_taken_over(
    tmp_path: Path, config: RunConfig, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    RunDirectory(run).create(config)
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(run)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    for words in (["--resume", run], ["--out", run]):
        status, _, err = say(capsys, "train", *words)
        assert status == 2
        assert f"is being trained by process {holder.pid}: wait for it, or stop it." in err
    holder.kill()
    holder.communicate()
    assert (run / NAME).read_text() == f"{holder.pid}\n"
    with locked(run):
        assert (run / NAME).read_text() == f"{os.getpid()}\n"


def test_a_lock_that_is_a_link_is_not_followed(tmp_path: Path, config: RunConfig) -> None:
    run, other = RunDirectory(tmp_path / "run"), tmp_path / "other"
    run.create(config)
    other.write_text("kept")
    (run.path / NAME).symlink_to(other)
    with pytest.raises(InputError, match="cannot be locked: "), locked(run.path):
        pass
    assert other.read_text() == "kept"


# --- threads --------------------------------------------------------------------------------------

WEIGHTS = """
import hashlib, os, sys
os.sched_setaffinity(0, set(map(int, sys.argv[2].split(","))))
from pathlib import Path
from reachlab.cli import main as cli
status = cli.main(["train", "--out", sys.argv[1], *sys.argv[3:]])
state = max(Path(sys.argv[1]).glob("checkpoints/step_*/state.safetensors"))
print(status, hashlib.sha256(state.read_bytes()).hexdigest())
"""


def test_deterministic_gives_the_same_weights_on_one_core_and_on_all(tmp_path: Path) -> None:
    if not hasattr(os, "sched_setaffinity"):
        pytest.skip("no way to take cores away here")
    flags = ["--total-steps", "8192", "--no-stop-early", "--report-episodes", "5", "--max-steps", "100"]
    cores = {"one": {0}, "all": os.sched_getaffinity(0)}
    free = {name: value for name, value in os.environ.items() if name != VARIABLE}
    said = []
    for name, some in cores.items():
        words = [str(tmp_path / name), ",".join(map(str, some)), *flags, "--deterministic"]
        command = [sys.executable, "-c", WEIGHTS, *words]
        done = subprocess.run(command, env=free, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        said.append(done.stdout.splitlines()[-1])
    assert said[0] == said[1]
    for name in cores:
        manifest = RunDirectory(tmp_path / name).newest_manifest()
        assert manifest is not None
        assert manifest.threads == 1


def test_another_number_of_threads_is_refused(tmp_path: Path, config: RunConfig) -> None:
    interrupted(config, tmp_path / "run")
    (folder,) = (tmp_path / "run/checkpoints").iterdir()
    manifest = read_json(folder / "manifest.json")
    write_json(folder / "manifest.json", seal(manifest | {"threads": threads() + 1}))
    with pytest.raises(InputError, match=r"needs JAX to compute with \d+ threads, and it runs already with \d+"):
        train(config, tmp_path / "run", resume=True)


def test_a_run_all_of_whose_manifests_are_damaged_is_not_begun_anew(tmp_path: Path, config: RunConfig) -> None:
    interrupted(config, tmp_path / "run")
    (folder,) = (tmp_path / "run/checkpoints").iterdir()
    rows = (tmp_path / "run/metrics.jsonl").read_bytes()
    (folder / "manifest.json").write_text("{")
    with pytest.raises(InputError, match=r"manifest\.json"):
        train(config, tmp_path / "run", resume=True)
    assert rows
    assert (tmp_path / "run/metrics.jsonl").read_bytes() == rows
    assert folder.exists()


DETERMINISTIC_LATE = """
import sys
from pathlib import Path
import jax
from reachlab.learn.train import train
from reachlab.envs.presets import configure
from reachlab.settings.validation import InputError
jax.devices()
try:
    train(configure(deterministic=True), Path(sys.argv[1]))
except InputError as error:
    print(error)
"""


def test_deterministic_is_refused_where_jax_runs_with_more_threads(tmp_path: Path) -> None:
    command = [sys.executable, "-c", DETERMINISTIC_LATE, str(tmp_path / "run")]
    done = subprocess.run(command, env=os.environ | {VARIABLE: "2"}, capture_output=True, text=True, check=False)
    assert done.stdout.startswith("this run needs JAX to compute with 1 thread, and it runs already with 2:"), (
        done.stderr
    )
    assert "set NPROC=1 in the environment before Python starts" in done.stdout
    assert not (tmp_path / "run").exists()


# --- metrics --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ('{"steps": 1}\n{"steps": 2}\n{"steps": 3}\n', 2),
        ('{"steps": 1}\n{"steps": 2}', 1),
        ('{"steps": 1}\nnot JSON\n{"steps": 2}\n', 1),
        ('{"steps": 1}\n[]\n', 1),
        ('{"steps": 1}\n{"steps": "2"}\n', 1),
        ("", 0),
    ],
)
def test_metrics_are_cut_after_the_last_whole_row_of_the_checkpoint(tmp_path: Path, text: str, kept: int) -> None:
    file = tmp_path / "metrics.jsonl"
    file.write_text(text)
    cut_metrics(file, 2)
    assert file.read_text() == "".join(f"{line}\n" for line in text.splitlines()[:kept])
