"""Datasets for LeRobot: what is recorded, read back from the files, and how recording is stopped and resumed."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from imageio_ffmpeg import get_ffmpeg_exe
from pyarrow.compute import field

from reachlab.cli import main as cli
from reachlab.deploy import lerobot_dataset
from reachlab.deploy import record as recording
from reachlab.deploy.lerobot_units import motors_of
from reachlab.deploy.record import Recorded, record
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import RECORD_STREAM, episode_keys
from reachlab.evaluation.episodes import make_runner, run_episodes
from reachlab.render import CAMERAS
from reachlab.render.view_randomisation import SAMPLES, make_views
from reachlab.settings.config import RecordConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError, installing

SIZE, SEED, EPISODES = 32, 3, 6
CAMERA_NAMES = ("front", "observation")

TUTORIAL: dict[str, Any] = {"max_steps": 138}
"""Inverse kinematics comes to half of the targets in time."""


@pytest.fixture(scope="module")
def env() -> Iterator[Env]:
    made = Env(configure("precise", robot="so101", randomise=("dynamics",), max_steps=25), 4)
    yield made
    made.close()


@pytest.fixture(scope="module")
def tutorial() -> Env:
    return Env(configure("tutorial", **TUTORIAL), 4)


@pytest.fixture(scope="module")
def dataset(env: Env, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Six episodes, in a part of four and one of two."""
    out = tmp_path_factory.mktemp("recorded") / "dataset"
    config = RecordConfig(episodes=EPISODES, cameras=CAMERA_NAMES, size=SIZE, seed=SEED, failures=True)
    return record(env, "script", None, out, config)


def states(env: Env, out: Path, **settings: Any) -> Recorded:
    """A dataset without pictures, of inverse kinematics."""
    return record(env, "ik", None, out, RecordConfig(**{"cameras": (), "seed": SEED, "failures": True} | settings))


def read(out: str | Path, what: str) -> pa.Table:
    return pa.concat_tables([pq.read_table(file) for file in sorted(Path(out).glob(f"{what}/*/*.parquet"))])


def column(table: pa.Table, name: str) -> np.ndarray:
    return np.array(table[name].to_pylist())


def info(out: str | Path) -> dict[str, Any]:
    return json.loads((Path(out) / "meta/info.json").read_text())


# --- what is recorded -----------------------------------------------------------------------------


def test_every_file_that_is_named_is_there_and_the_numbers_agree(dataset: Recorded) -> None:
    known, rows, episodes = info(dataset.out), read(dataset.out, "data"), read(dataset.out, "meta/episodes")
    assert (known["codebase_version"], known["fps"], known["robot_type"]) == ("v3.0", 50, "so101")
    assert known["total_episodes"] == len(episodes) == dataset.episodes == dataset.tried == EPISODES
    assert known["total_frames"] == len(rows) == dataset.steps == sum(episodes["length"].to_pylist())
    for episode in episodes.to_pylist():
        place = {name: episode[f"data/{name}"] for name in ("chunk_index", "file_index")}
        own = pq.read_table(Path(dataset.out) / known["data_path"].format(**place))
        own = own.filter(field("episode_index") == episode["episode_index"])
        assert column(own, "index").tolist() == list(range(episode["dataset_from_index"], episode["dataset_to_index"]))
        for camera in CAMERA_NAMES:
            key = f"observation.images.{camera}"
            place = {name: episode[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
            assert (Path(dataset.out) / known["video_path"].format(video_key=key, **place)).is_file()
            film = episode[f"videos/{key}/to_timestamp"] - episode[f"videos/{key}/from_timestamp"]
            assert film == pytest.approx(episode["length"] / known["fps"])
    assert episodes["data/file_index"].to_pylist() == [0, 0, 0, 0, 1, 1]


def test_steps_count_from_the_begin_of_their_episode_and_only_the_last_one_is_done(dataset: Recorded) -> None:
    rows, lengths = read(dataset.out, "data"), column(read(dataset.out, "meta/episodes"), "length")
    frame = np.concatenate([np.arange(length) for length in lengths])
    assert column(rows, "frame_index").tolist() == frame.tolist()
    assert column(rows, "timestamp") == pytest.approx(frame / 50)
    assert column(rows, "episode_index").tolist() == np.repeat(np.arange(EPISODES), lengths).tolist()
    assert np.flatnonzero(column(rows, "next.done")).tolist() == (np.cumsum(lengths) - 1).tolist()
    assert not column(rows, "next.success")[~column(rows, "next.done")].any()


def test_steps_and_outcomes_are_those_of_the_environment(env: Env, dataset: Recorded) -> None:
    played = run_episodes(make_runner(env, "script", keep=lambda _: None), None, SEED, RECORD_STREAM, EPISODES)
    rows, ends = read(dataset.out, "data"), np.cumsum(played.steps) - 1
    assert column(rows, "next.success")[ends].tolist() == played.success.tolist()
    rewards = np.split(column(rows, "next.reward"), ends[:-1] + 1)
    assert [part.sum() for part in rewards] == pytest.approx(played.returns, rel=1e-5)
    goals = np.repeat(np.asarray(played.goal), played.steps, axis=0)
    assert column(rows, "observation.environment_state") == pytest.approx(goals)


def test_commands_played_back_from_the_start_reach_the_recorded_states(env: Env, dataset: Recorded) -> None:
    rows, episodes = read(dataset.out, "data"), read(dataset.out, "meta/episodes")
    states = np.radians(column(rows, "observation.state")[:, :5])
    commands = np.radians(column(rows, "action")[:, :5]).astype(np.float32)
    lengths, numbers = column(episodes, "length"), column(episodes, "reachlab/number")
    firsts = np.cumsum(lengths) - lengths
    for batch in (slice(0, 4), slice(4, 6)):
        arm = env.init(episode_keys(SEED, RECORD_STREAM, int(numbers[batch][0]), env.num_envs)).arm
        count = len(numbers[batch])
        assert np.asarray(arm.q)[:count] == pytest.approx(states[firsts[batch]], abs=1e-6)
        for step in range(1, min(lengths[batch])):
            command = np.repeat(commands[firsts[batch] + step - 1][:1], env.num_envs, axis=0)
            command[:count] = commands[firsts[batch] + step - 1]
            moved = env.simulator.step(arm, command)
            assert np.asarray(moved.q)[:count] == pytest.approx(states[firsts[batch] + step], abs=1e-4)
            arm = moved
    turned = np.abs(np.diff(states, axis=0)).max()
    assert turned > 0.05  # else a test of arms at rest


def test_recorded_episodes_are_none_of_an_evaluation(tutorial: Env) -> None:
    starts: list[Any] = []
    run_episodes(make_runner(tutorial, "ik", keep=starts.append), None, SEED, RECORD_STREAM, 4)
    held_out = tutorial.init_held_out(episode_keys(SEED, 1, 0, 4))
    assert not np.isin(np.asarray(starts[0].state.goal.position), np.asarray(held_out.goal.position)).all(axis=1).any()


def test_only_successes_are_recorded_unless_failures_are_asked_for(tutorial: Env, tmp_path: Path) -> None:
    all_of_them = states(tutorial, tmp_path / "all", episodes=16)
    listed, rows = read(all_of_them.out, "meta/episodes"), read(all_of_them.out, "data")
    success = column(rows, "next.success")[column(listed, "dataset_to_index") - 1]
    assert 0 < success.sum() < 16
    some = states(tutorial, tmp_path / "some", episodes=int(success.sum()), failures=False)
    numbers = column(read(some.out, "meta/episodes"), "reachlab/number")
    assert numbers.tolist() == np.flatnonzero(success).tolist()
    assert some.tried == numbers[-1] + 1
    assert column(read(some.out, "data"), "next.success").sum() == some.episodes


# --- units ----------------------------------------------------------------------------------------


def test_an_so101_is_in_degrees_and_its_locked_jaw_in_hundredths(env: Env, dataset: Recorded) -> None:
    names = info(dataset.out)["features"]["action"]["names"]
    motors = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
    assert names == [f"{name}.pos" for name in motors]
    jaw = column(read(dataset.out, "data"), "observation.state")[:, 5]
    assert jaw == pytest.approx(np.full(dataset.steps, 50.761), abs=1e-2)
    # Home of so101.xml: 0, -0.2, -0.11, 1.36 and 0 rad; the jaw, from -10 to 100 degrees, at 0.8 rad.
    home = motors_of("so101", env.setup.robot).read(np.array(env.setup.robot.home))
    assert home == pytest.approx([0.0, -11.459, -6.303, 77.922, 0.0, 50.761], abs=1e-2)


def test_the_jaw_of_an_so101_that_grips_is_between_closed_and_open() -> None:
    robot = Env(override(configure("lift"), robot="so101"), 1).setup.robot
    assert robot.gripper
    actuated = np.zeros((3, 6))
    actuated[:, 5] = 0.0, 0.5 * robot.gripper.widest, robot.gripper.widest
    jaw = motors_of("so101", robot).read(actuated)[:, 5]
    low, high = (100 * (np.degrees(end[0]) + 10) / 110 for end in (robot.gripper.closed, robot.gripper.open))
    assert jaw[[0, 2]] == pytest.approx([low, high])
    assert 0 <= jaw[0] < jaw[1] < jaw[2] <= 100


def test_other_arms_are_in_radians_by_the_names_of_their_joints(tutorial: Env) -> None:
    robot = tutorial.setup.robot
    motors = motors_of("iiwa14", robot)
    assert motors.names == robot.joint_names
    assert motors.read(np.array([robot.home]))[0].tolist() == list(robot.home)


# --- statistics and pictures ----------------------------------------------------------------------


def test_statistics_are_those_of_all_steps(dataset: Recorded) -> None:
    stats, rows = json.loads((Path(dataset.out) / "meta/stats.json").read_text()), read(dataset.out, "data")
    for name in ("observation.state", "action", "next.reward", "timestamp"):
        values, own = column(rows, name).reshape(len(rows), -1), stats[name]
        assert own["count"] == [len(rows)]
        for kind in ("min", "max", "mean", "std"):
            assert own[kind] == pytest.approx(getattr(values, kind)(axis=0), rel=1e-5, abs=1e-6)
        assert own["q10"] == pytest.approx(np.quantile(values, 0.1, axis=0), rel=1e-5, abs=1e-6)


def film(out: str, camera: str, part: int) -> np.ndarray:
    """Pictures of a part's film, `[steps, SIZE, SIZE, 3]`."""
    path = Path(out) / f"videos/observation.images.{camera}/chunk-000/file-{part:03d}.mp4"
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(
        [get_ffmpeg_exe(), "-loglevel", "error", "-i", str(path), *raw], capture_output=True, check=True
    )
    return np.frombuffer(done.stdout, np.uint8).reshape(-1, SIZE, SIZE, 3)


def test_pictures_show_the_arm_as_it_moves_and_their_statistics_are_theirs(dataset: Recorded) -> None:
    lengths, stats = (
        column(read(dataset.out, "meta/episodes"), "length"),
        json.loads((Path(dataset.out) / "meta/stats.json").read_text()),
    )
    for camera in CAMERA_NAMES:
        films = [film(dataset.out, camera, part).astype(float) for part in (0, 1)]
        assert [len(one) for one in films] == [lengths[:4].sum(), lengths[4:].sum()]
        pictures, own = np.concatenate(films) / 255, stats[f"observation.images.{camera}"]
        assert np.shape(own["mean"]) == (3, 1, 1)
        assert own["count"] == [len(pictures)]
        assert np.ravel(own["mean"]) == pytest.approx(pictures.mean(axis=(0, 1, 2)), abs=0.02)
        assert np.ravel(own["std"]) == pytest.approx(pictures.std(axis=(0, 1, 2)), abs=0.02)
        assert own["q50"] == pytest.approx(np.median(pictures, axis=(0, 1, 2)).reshape(3, 1, 1), abs=0.03)
        coloured = np.ptp(pictures, axis=-1).max() > 0.3
        assert coloured == bool(CAMERAS[camera].angles)
    moved = np.abs(np.diff(film(dataset.out, "front", 0)[: lengths[0]].astype(int), axis=0)).max()
    assert moved > 50


@pytest.mark.parametrize("camera", CAMERAS)
def test_every_camera_sees_the_middle_of_the_workspace(env: Env, camera: str) -> None:
    robot = env.setup.robot
    views = make_views(np.zeros((1, SAMPLES)), robot, angles=CAMERAS[camera].angles)
    position, rotation = views.position[0], views.rotation[0]
    assert rotation.T @ rotation == pytest.approx(np.eye(3), abs=1e-9)
    right, up, behind = (np.mean(robot.workspace, axis=0) - position) @ rotation
    assert behind < 0
    assert max(abs(right), abs(up)) < -behind * np.tan(np.radians(30))
    assert rotation[2, 1] > 0  # what is up in the picture is up


# --- stopping and resuming ------------------------------------------------------------------------


def contents(out: str | Path) -> dict[str, Any]:
    """What a dataset holds, file by file."""
    files = sorted(path for path in Path(out).rglob("*") if path.is_file())
    return {str(path.relative_to(out)): path.read_bytes() for path in files}


@pytest.mark.parametrize("after", range(1, 6))
def test_what_is_interrupted_is_resumed_and_comes_out_the_same(
    tutorial: Env, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    states(tutorial, tmp_path / "whole", episodes=5)
    written: list[Path] = []

    def stopping(path: Path, data: bytes) -> None:
        if len(written) == after:
            (path.parent / f".{path.name}.left.tmp").write_bytes(data)
            raise KeyboardInterrupt
        written.append(path)
        write_whole(path, data)

    write_whole = lerobot_dataset.write_whole
    monkeypatch.setattr(lerobot_dataset, "write_whole", stopping)
    if after < 5:  # two files a part, and that of tasks
        with pytest.raises(KeyboardInterrupt):
            states(tutorial, tmp_path / "resumed", episodes=5)
        assert not (tmp_path / "resumed/meta/info.json").exists()
        monkeypatch.undo()
    states(tutorial, tmp_path / "resumed", episodes=5)
    assert contents(tmp_path / "resumed") == contents(tmp_path / "whole")


@pytest.mark.slow
def test_what_is_killed_is_resumed_and_no_episode_is_lost_or_twice(tmp_path: Path) -> None:
    words = ["--agent", "ik", "--episodes", "120", "--cameras", "front", "--size", "32"]
    command = [sys.executable, "-m", "reachlab", "record", *words, "--out"]
    subprocess.run([*command, str(tmp_path / "whole")], check=True, capture_output=True)
    first = tmp_path / "killed/meta/episodes/chunk-000/file-000.parquet"
    with subprocess.Popen([*command, str(tmp_path / "killed")], stderr=subprocess.DEVNULL) as process:
        while not first.exists():
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    told = len(pq.read_table(first))
    assert 0 < told < 120
    assert not (tmp_path / "killed/meta/info.json").exists()
    before = first.stat().st_mtime_ns
    subprocess.run([*command, str(tmp_path / "killed")], check=True, capture_output=True)
    assert first.stat().st_mtime_ns == before  # what was told as written is not written again
    whole, resumed = (read(tmp_path / name, "data") for name in ("whole", "killed"))
    assert resumed.equals(whole)
    assert contents(tmp_path / "killed").keys() == contents(tmp_path / "whole").keys()
    assert read(tmp_path / "killed", "meta/episodes").equals(read(tmp_path / "whole", "meta/episodes"))


# --- refusals -------------------------------------------------------------------------------------


def refused(env: Env, out: Path, agent: str = "ik", **changed: Any) -> str:
    settings = {"episodes": 2, "cameras": (), "seed": SEED, "failures": True} | changed
    with pytest.raises(InputError) as refusal:
        record(env, agent, None, out, RecordConfig(**settings))
    return str(refusal.value)


def test_what_is_there_already_is_not_touched(tutorial: Env, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert refused(tutorial, tmp_path) == f"'{tmp_path}' exists and is not overwritten: name another with --out."
    assert contents(tmp_path) == {"notes.txt": b"mine"}
    states(tutorial, tmp_path / "done", episodes=2)
    assert "done' is a dataset that is finished, and not extended" in refused(tutorial, tmp_path / "done")


def test_where_nothing_is_recorded_yet_other_settings_begin_anew(
    tutorial: Env, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "PATIENCE", 8)
    out = tmp_path / "zero"
    assert "or record failures too with --failures" in refused(tutorial, out, "zero", failures=False)
    settings = RecordConfig(episodes=2, cameras=(), seed=SEED, failures=True)
    assert record(tutorial, "zero", None, out, settings).episodes == 2


def test_other_settings_do_not_resume_a_dataset(tutorial: Env, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(lerobot_dataset, "finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            states(tutorial, tmp_path / "begun", episodes=2)
    sentence = refused(tutorial, tmp_path / "begun", seed=7)
    assert "was begun with seed 3 and cannot be resumed with 7" in sentence


def test_an_interrupted_command_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(lerobot_dataset, "finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    words = f"record --task tutorial --agent ik --episodes 1 --cameras --out {tmp_path / 'new'}"
    assert cli.main(words.split()) == cli.INTERRUPTED
    assert f"interrupted; the same command goes on in '{tmp_path / 'new'}'." in capsys.readouterr().err


def test_a_full_disk_is_one_sentence(tutorial: Env, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, data: bytes) -> None:
        del data
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(lerobot_dataset, "write_whole", full)
    out = tmp_path / "new"
    assert refused(tutorial, out) == f"the dataset cannot be written to '{out}': No space left on device."


def test_a_film_that_finds_no_room_says_so() -> None:
    pictures = [bytes(SIZE * SIZE * 3)] * 50
    with pytest.raises(OSError, match="No space left"):
        lerobot_dataset.encode_mp4(Path("/dev/full"), pictures, (SIZE, SIZE), 50, lerobot_dataset.X264)


def test_an_agent_that_never_succeeds_is_refused(
    tutorial: Env, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "PATIENCE", 8)
    sentence = refused(tutorial, tmp_path / "none", agent="zero", failures=False)
    assert sentence.startswith("none of 8 episodes in a row is a success of agent 'zero'")


def test_without_the_extra_one_sentence_names_it(
    tutorial: Env, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    sentence = f"a LeRobot dataset needs pyarrow and imageio-ffmpeg: {installing('lerobot')}."
    assert refused(tutorial, tmp_path / "new") == sentence


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"size": 33, "cameras": ("front",)}, "size must be even, for the colours of a film, got 33."),
        ({"cameras": ("frnt",)}, "Did you mean 'front'?"),
        ({"agent": "scrip"}, "Did you mean 'script'?"),
    ],
)
def test_wrong_input_is_one_sentence(tutorial: Env, tmp_path: Path, changed: dict[str, Any], sentence: str) -> None:
    assert sentence in refused(tutorial, tmp_path / "new", **changed)
    assert not (tmp_path / "new").exists()


# --- the command ----------------------------------------------------------------------------------


def test_the_command_records_and_prints_one_object(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = [
        "record",
        "--agent",
        "ik",
        "--episodes",
        "3",
        "--cameras",
        "top",
        "--size",
        "16",
        "--randomise",
        "view",
        "--json",
    ]
    assert cli.main(words) == cli.DONE
    printed = json.loads(capsys.readouterr().out)
    assert (printed["out"], printed["episodes"]) == ("dataset", 3)
    assert info("dataset")["features"]["observation.images.top"]["shape"] == [16, 16, 3]
    assert cli.main(words) == cli.WRONG_INPUT
    assert "is a dataset that is finished" in capsys.readouterr().err


def test_the_command_needs_a_run_for_a_trained_agent(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["record"]) == cli.WRONG_INPUT
    assert "agent 'trained' needs a run" in capsys.readouterr().err
