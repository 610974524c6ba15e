"""Videos of held-out episodes."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

from params import tried
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM
from reachlab.evaluation.episodes import BATCH, make_runner, run_episodes
from reachlab.settings.validation import InputError, installing
from reachlab.watch import video
from reachlab.watch.captions import HEIGHT, VERDICTS, Caption, angle_text, captioned, distance_text
from reachlab.watch.player import Player, played
from reachlab.watch.video import BEGIN_PAUSE, ENCODERS, END_PAUSE, LONG_ENOUGH, SPEEDS, Clip, encode_mp4, write_video

SIZE = (64, 48)
"""Of the pictures that stand for rendered ones here."""


@pytest.fixture(scope="module")
def env() -> Env:
    return Env(configure(), 1)


class Shown(NamedTuple):
    """What is seen of an episode after some step."""

    step: int
    distance: float
    done: bool
    success: bool


def shown(player: Player, agent: str, stride: int) -> Iterator[Shown]:
    for _ in played(player, agent, None, stride):
        yield Shown(player.clock, player.moment.distance, player.over, player.success)


@pytest.fixture(scope="module")
def moments(env: Env) -> list[list[Shown]]:
    """Two episodes of inverse kinematics, every eighth step."""
    player, episodes = Player(env, seed=1), []
    for number in range(2):
        player.begin(number)
        episodes.append(list(shown(player, "ik", 8)))
    return episodes


def grey(_: object, *, path: np.ndarray, trail: np.ndarray) -> np.ndarray:
    return np.full((*SIZE[::-1], 3), len(path) + len(trail), np.uint8)


@pytest.fixture
def film(env: Env, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Clip]:
    """Writes a video of inverse kinematics whose pictures are plain grey, so that it needs no OpenGL."""
    monkeypatch.setattr(env, "render", grey)

    def write(name: str, episodes: int = 1, fps: float = 30.0, speed: float = 1.0, **more: Any) -> Clip:
        return write_video(env, "ik", None, tmp_path / name, seed=1, episodes=episodes, fps=fps, speed=speed, **more)

    return write


def durations(path: str) -> list[int]:
    """Milliseconds for which each picture is shown."""
    with Image.open(path) as picture:
        times = []
        for number in range(picture.n_frames):  # type: ignore[attr-defined]
            picture.seek(number)
            picture.load()
            times.append(int(picture.info["duration"]))
        return times


def test_it_is_told_how_many_episodes_are_filmed(film: Callable[..., Clip]) -> None:
    filmed: list[int] = []
    film("film.webp", episodes=2, fps=5.0, watch=filmed.append)
    assert filmed == [1, 2]


# --- episodes -------------------------------------------------------------------------------------


def test_the_episodes_are_those_of_the_evaluation(moments: list[list[Shown]]) -> None:
    evaluated = run_episodes(make_runner(Env(configure(), BATCH), "ik"), None, 1, REPORT_STREAM, 2)
    assert [episode[-1].step for episode in moments] == evaluated.steps.tolist()
    assert [episode[-1].success for episode in moments] == evaluated.success.tolist()
    ends = [episode[-1].distance for episode in moments]
    assert ends == pytest.approx(evaluated.distance, abs=1e-5)


def test_an_episode_is_seen_from_its_begin_to_its_end(moments: list[list[Shown]]) -> None:
    for episode in moments:
        steps = [moment.step for moment in episode]
        assert steps[:-1] == list(range(0, steps[-1], 8))
        assert [moment.done for moment in episode] == [False] * (len(steps) - 1) + [True]
        assert not any(moment.success for moment in episode[:-1])


@pytest.mark.slow
def test_an_episode_in_a_host_simulator_ends_with_the_clock() -> None:
    env = Env(configure(sim="mujoco", max_steps=5), 1)
    [*_, last] = shown(Player(env, seed=0), "random", 2)
    assert (last.step, last.done, last.success) == (5, True, False)
    env.close()


# --- files ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", tried([".webp", ".gif"], [".webp"]))
def test_an_animation_plays_in_real_time(film: Callable[..., Clip], moments: list[list[Shown]], ending: str) -> None:
    clip = film(f"film{ending}", episodes=2)
    lengths = [len(episode) for episode in moments]
    assert clip.frames == sum(lengths)
    assert (clip.episodes, clip.successes) == (2, 2)
    # Every picture is 8 steps of 1/240 s long but the last, which stands, and the first, which stands longer.
    seconds = sum((count - 1) / 30 for count in lengths) + 2 * (BEGIN_PAUSE + END_PAUSE)
    assert clip.seconds == pytest.approx(seconds, abs=0.05)
    assert sum(durations(clip.out)) == pytest.approx(1000 * seconds, abs=20), "roundings do not add up"
    assert clip.bytes == Path(clip.out).stat().st_size
    with Image.open(clip.out) as picture:
        assert picture.format == ending[1:].upper()
        assert picture.size == (SIZE[0], SIZE[1] + HEIGHT)
        assert picture.info["loop"] == 0


def test_without_a_speed_a_short_episode_is_slowed_down(film: Callable[..., Clip], moments: list[list[Shown]]) -> None:
    moves = moments[0][-1].step / 240
    fitting = max(speed for speed in SPEEDS if moves / speed >= LONG_ENOUGH)
    clip = film("film.gif", speed=0.0)
    assert fitting < 1
    with Image.open(clip.out) as picture:
        assert picture.format == "GIF"
    assert sum(durations(clip.out)) == pytest.approx(1000 * clip.seconds, abs=20)
    assert clip.seconds == pytest.approx(moves / fitting + BEGIN_PAUSE + END_PAUSE, abs=0.1)


def test_slower_shows_more_pictures_for_longer(film: Callable[..., Clip], moments: list[list[Shown]]) -> None:
    slow, usual = film("slow.webp", speed=0.5), len(moments[0])
    assert slow.seconds - BEGIN_PAUSE - END_PAUSE == pytest.approx(2 * (usual - 1) / 30, abs=0.05)
    assert slow.frames == pytest.approx(2 * usual, abs=2)


def test_no_more_pictures_than_steps(film: Callable[..., Clip], moments: list[list[Shown]]) -> None:
    pytest.importorskip("imageio_ffmpeg")
    clip = film("film.mp4", fps=10_000.0)
    assert clip.frames == moments[0][-1].step + 1


@pytest.mark.parametrize("ending", ["webp", "gif"])
def test_no_picture_is_too_short_for_a_browser(film: Callable[..., Clip], ending: str) -> None:
    clip = film(f"film.{ending}", fps=10_000.0, speed=1.0)
    assert min(durations(clip.out)) >= 20


def test_the_name_of_an_mp4_may_hold_a_colon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.chdir(tmp_path)
    encode_mp4(Path("12:30.mp4"), [bytes(64 * 64 * 3)] * 3, (64, 64), 10.0, "")
    assert (tmp_path / "12:30.mp4").stat().st_size > 0


def test_mp4_has_the_same_length(film: Callable[..., Clip]) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    clip = film("film.mp4", fps=10.0)
    said = subprocess.run([ffmpeg, "-i", clip.out], capture_output=True, text=True, check=False).stderr
    hours, minutes, seconds = said.partition("Duration: ")[2].partition(",")[0].split(":")
    assert 3600 * int(hours) + 60 * int(minutes) + float(seconds) == pytest.approx(clip.seconds, abs=0.1)
    assert f"{SIZE[0]}x{SIZE[1] + HEIGHT}" in said
    assert "h264" in said


def test_without_the_extra_mp4_names_it(film: Callable[..., Clip], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=re.escape(f"{installing('video')}, or name a file that ends in .webp")):
        film("film.mp4")


def test_what_ffmpeg_refuses_is_told_in_a_sentence(
    film: Callable[..., Clip], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("imageio_ffmpeg")
    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(InputError, match=r"the video cannot be written to '.*folder.mp4'") as refused:
        film("folder.mp4")
    assert "\n" not in str(refused.value)
    monkeypatch.setattr(video, "_ffmpeg", lambda: str(tmp_path / "missing"))
    with pytest.raises(InputError, match="cannot be written"):
        film("film.mp4")


def test_an_ffmpeg_that_is_killed_is_told_in_a_sentence(
    film: Callable[..., Clip], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    killed = tmp_path / "killed"
    killed.write_text("#!/bin/sh\nkill -9 $$\n")
    killed.chmod(0o755)
    monkeypatch.setattr(video, "_ffmpeg", lambda: str(killed))
    with pytest.raises(InputError, match=r"cannot be written to '.*': ffmpeg was ended with -9"):
        film("film.mp4")


@pytest.mark.parametrize("ending", ENCODERS)
def test_where_no_file_can_be_nothing_is_filmed(film: Callable[..., Clip], ending: str) -> None:
    with pytest.raises(InputError, match="cannot be written to"):
        film(f"missing/film{ending}")


# --- captions -------------------------------------------------------------------------------------


def test_a_caption_leaves_the_picture_as_it_is() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (120, 640, 3), np.uint8)
    image = np.asarray(captioned(picture, Caption("Episode 1 of 4", "tutorial", 0.123, 0.5)))
    assert image.shape == (120 + HEIGHT, 640, 3)
    assert np.array_equal(image[:120], picture)
    assert image[120:].std() > 10


@pytest.mark.parametrize("further", [{"angle": 0.2}, {"angle": 2.5, "error": 0.1234}])
def test_a_caption_tells_the_angle_and_the_mean_and_its_verdict_covers_neither(further: dict[str, float]) -> None:
    picture = np.zeros((10, 640, 3), np.uint8)
    short, long, ended = (
        np.asarray(captioned(picture, Caption("Episode 1 of 4", "a task", 0.1234, 5.0, said, **told)))
        for said, told in (("", {}), ("", further), ("success", further))
    )
    assert (short != long).any()
    stamped = np.argwhere((ended == VERDICTS["success"]).all(axis=-1))[:, 1]
    assert np.array_equal(ended[:, stamped.max() + 1 :], long[:, stamped.max() + 1 :]), "the figures are all there"
    assert np.argwhere((short != long).any(axis=-1))[:, 1].min() > stamped.max()


def test_a_long_caption_ends_where_the_verdict_or_the_figures_begin() -> None:
    picture, words = (
        np.zeros((10, 640, 3), np.uint8),
        "a task of a long name · an arm of a longer one · pybullet · trained · 0.25× speed",
    )
    name = "franka_research_3_with_a_gripper_of_another_maker_and_a_name_that_never_ends"
    for verdict in ("", "success"):
        short, long = (
            np.asarray(captioned(picture, Caption(title, detail, 0.1234, 5.0, verdict, angle=2.5)))
            for title, detail in (("a", "b"), (name, words))
        )
        room = np.argwhere((short != long).any(axis=-1))[:, 1].max()
        stamped = np.argwhere((short == VERDICTS["success"]).all(axis=-1))[:, 1]
        assert room < (stamped.min() if verdict else 640 - 110) - 5
        assert room > 300


def test_a_film_shows_the_trail_of_a_target_that_moves(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    env, points = Env(configure("track", sim="kinematic", randomise=(), goal_paths=("smooth",), max_steps=250), 1), []

    def count(_: object, *, path: np.ndarray, trail: np.ndarray) -> np.ndarray:
        points.append(len(trail))
        return grey(_, path=path, trail=trail)

    monkeypatch.setattr(env, "render", count)
    write_video(env, "ik", None, tmp_path / "film.webp", episodes=1, fps=5.0, speed=1.0)
    env.close()
    assert points[0] == 1
    assert points == sorted(points)
    assert points[-1] > 10


def test_the_verdict_is_told_in_its_colour_at_the_end_only() -> None:
    picture = np.zeros((10, 640, 3), np.uint8)
    told = {
        said: np.asarray(captioned(picture, Caption("1 of 4", "a task", 0.1, 0.5, said))) for said in ("", *VERDICTS)
    }
    for verdict, colour in VERDICTS.items():
        assert (told[verdict] == colour).all(axis=-1).sum() > 500
        assert not (told[""] == colour).all(axis=-1).any()


def test_distances_are_in_millimetres_and_angles_in_degrees() -> None:
    texts = {0.1234: "123 mm", 0.01: "10 mm", 0.0012: "1.2 mm", 1.2: "1200 mm"}
    assert {metres: distance_text(metres) for metres in texts} == texts
    assert angle_text(np.pi / 6) == "30.0°"
