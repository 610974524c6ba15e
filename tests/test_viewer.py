"""The viewer, as a person meets it in a browser."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlsplit

import numpy as np
import pytest
from playwright.sync_api import Browser, Page
from scipy.spatial.transform import Rotation

from browser.driver import chromium, executable, open_scene, opened, picture, traffic, wait_until
from browser.follow import Hand, follow
from browser.viewer import free_port
from params import tried
from reachlab.cli import main as cli
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.learn.load import load_policy
from reachlab.learn.ppo_method import initial_state
from reachlab.render import marks
from reachlab.render.marks import REACHED, TARGET_RADIUS
from reachlab.robots.loading import load_robot
from reachlab.runs.directory import RunDirectory
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError, installing
from reachlab.tasks import TASKS
from reachlab.watch import panel
from reachlab.watch import server as server_module
from reachlab.watch.moment import PATH_STEP
from reachlab.watch.player import TOUCHED
from reachlab.watch.saved_page import save_page
from reachlab.watch.server import LOCAL, start_server
from reachlab.watch.viewer import COMMANDS, MOVABLE, UNREACHABLE, Viewer
from situations import RULES

CHECKPOINTS = (0, 128)

REACHED_BYTES = tuple(round(255 * part) for part in REACHED)

WIDTH, HEIGHT = 1100, 480
"""Size of the page [pixels]: wide enough that the panel covers no place of the target."""

FRAME = 0.02
"""Time between two pictures [s]."""

EPISODES = 8
"""Episodes of a saved page: it has to last, for beginning anew takes its time without a graphics card."""

SHOWN = """(() => {
    const image = document.querySelector("img[src^=blob]");
    if (!image || !image.complete || !image.naturalWidth) return null;
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
    const context = canvas.getContext("2d");
    context.drawImage(image, 0, 0);
    const bytes = context.getImageData(0, 0, canvas.width, canvas.height).data;
    return Array.from(bytes).filter((_, i) => i % 4 === 0);
})()"""
"""Greys of the picture that the panel shows, row by row; null while there is none."""

FIRST = next(iter(TASKS))

HERE_SCHEMES = {"data", "blob", "file", "about"}


@pytest.fixture(scope="module")
def config() -> RunConfig:
    return configure(num_envs=8, hidden=(8,))


@pytest.fixture(scope="module")
def run(config: RunConfig, tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return untrained(config, tmp_path_factory.mktemp("viewer") / "run")


def untrained(config: RunConfig, path: Path) -> RunDirectory:
    """A run with two checkpoints of policies that have learnt nothing, and not the same."""
    env = Env(config, config.loop.num_envs)
    run = RunDirectory(path)
    run.create(config)
    begin = env.compile_whole(lambda seed: initial_state(env, config, seed))
    for step in CHECKPOINTS:
        run.write_checkpoint(step, begin(np.uint32(step)))
    return run


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if executable() is None:
        if "CI" in os.environ:
            pytest.fail("there is no Chromium here; CI needs one")
        pytest.skip("needs Chromium: apt install chromium")
    with chromium() as browser:
        yield browser


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    with opened(browser, WIDTH, HEIGHT) as page:
        yield page


@contextlib.contextmanager
def view(config: RunConfig, run: RunDirectory, agent: str = "ik") -> Iterator[Viewer]:
    env = Env(config, 1)
    load = partial(load_policy, run, env)
    with Viewer(env, run.checkpoint_steps(), load, agent, LOCAL, free_port()) as viewer:
        viewer.prepare(seed=1)
        yield viewer
    env.close()


@pytest.fixture
def viewer(config: RunConfig, run: RunDirectory) -> Iterator[Viewer]:
    with view(config, run) as viewer:
        yield viewer


def playing(viewer: Viewer, happened: Callable[[], bool]) -> Callable[[], bool]:
    """Plays a little, then asks."""

    def ask() -> bool:
        viewer.frame(FRAME)
        return happened()

    return ask


def stays_here(requests: list[str]) -> bool:
    return all(urlsplit(url).scheme in HERE_SCHEMES or urlsplit(url).hostname == LOCAL for url in requests)


# --- in the browser -------------------------------------------------------------------------------


FOLLOWING = [task for task in TASKS if task != "slide"]
"""Tasks whose arm can follow a target: a puck that has been struck is out of its reach."""


@pytest.mark.parametrize("task", tried(FOLLOWING, [FIRST]))
def test_the_arm_follows_a_target_that_is_dragged_in_the_page_and_rests_there(
    page: Page, task: str, tmp_path: Path
) -> None:
    config = configure(task, num_envs=8, hidden=(8,))
    requests = traffic(page).requests
    with view(config, untrained(config, tmp_path / "run")) as viewer:
        rows = {row["name"].partition("/")[0]: row for row in follow(viewer, page, task, drags=2, seconds=1.0)}
        assert "to the target" in page.inner_text("body")
    followed = rows["viewer_drags_followed"]
    assert followed["value"] == followed["config"]["drags"] == 3
    assert rows["viewer_worst_at_rest"]["value"] < 1000 * RULES.success_distance
    assert rows["viewer_new_starts"]["value"] == 0
    assert stays_here(requests)
    assert {urlsplit(url).scheme for url in requests} >= {"http", "ws"}, "requests and web sockets are recorded"


@pytest.mark.slow
def test_a_target_that_is_turned_in_the_page_is_reached(page: Page, tmp_path: Path) -> None:
    config = configure("pose", num_envs=8, hidden=(8,))
    with view(config, untrained(config, tmp_path / "run")) as viewer:
        before = viewer.player.moment.target_orientation
        hand = Hand(viewer, page)
        hand.turn()
        wait_until(playing(viewer, lambda: angle(viewer.player.moment.target_orientation, before) > 0.3), "a turn")
        wanted, place = np.array(viewer.handle.wxyz), np.array(viewer.handle.position)
        wait_until(playing(viewer, lambda: viewer.player.moment.reached), "that the arm is there")
        assert angle(viewer.player.moment.orientation, wanted) < 0.02
        assert np.linalg.norm(viewer.player.moment.tool - place) < 0.002


def test_a_saved_page_plays_from_its_file_alone(page: Page, config: RunConfig, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    save_page(Env(config, 1), "ik", None, seed=1, episodes=EPISODES, out=out)
    assert "<title>reachlab · tutorial task · ik</title>" in out.read_text(encoding="utf-8")
    requests = traffic(page).requests
    open_scene(page, out.as_uri())
    first = picture(page)
    wait_until(lambda: not np.array_equal(picture(page), first), "a movement")
    assert {urlsplit(url).scheme for url in requests} <= HERE_SCHEMES


@pytest.mark.slow
def test_what_the_policy_observes_is_in_the_panel_and_before_its_camera(page: Page, tmp_path: Path) -> None:
    config = configure(observation="image", num_envs=8, hidden=(8,))
    with view(config, untrained(config, tmp_path / "run"), "trained") as viewer:
        open_scene(page, viewer.url)
        first = viewer.player.observed_picture()
        for _ in range(30):
            viewer.step()
        seen = viewer.player.observed_picture()
        assert first is not None
        assert seen is not None
        assert not np.array_equal(first, seen)
        enlarged = seen[..., 0].repeat(panel.ENLARGED, 0).repeat(panel.ENLARGED, 1)
        wait_until(lambda: page.evaluate(SHOWN) == enlarged.ravel().tolist(), "the picture of now in the panel")
        assert viewer.stage.camera
        np.testing.assert_array_equal(np.asarray(viewer.stage.camera.image), seen)


def test_a_policy_that_sees_no_picture_has_no_place_for_one(viewer: Viewer) -> None:
    viewer.step()
    assert viewer.player.observed_picture() is None
    assert viewer.stage.camera is None


# --- without ---------------------------------------------------------------------------------------


@pytest.fixture
def poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Viewer]:
    """Viewer of a task that asks for an orientation, as if a browser were there."""
    config = configure("pose", num_envs=8, hidden=(8,))
    with view(config, untrained(config, tmp_path / "run")) as viewer:
        monkeypatch.setattr(viewer._server, "get_clients", lambda: {0: None})
        yield viewer


def angle(one: np.ndarray | None, other: np.ndarray | None) -> float:
    """Between orientations, wxyz [rad]."""
    assert one is not None
    assert other is not None
    a, b = (Rotation.from_quat(quaternion, scalar_first=True) for quaternion in (one, other))
    return float((a.inv() * b).magnitude())


@pytest.mark.slow
def test_a_target_that_is_turned_by_its_handle_is_reached(poses: Viewer) -> None:
    turn = Rotation.from_euler("z", 40, degrees=True)
    wanted = (turn * Rotation.from_quat(poses.handle.wxyz, scalar_first=True)).as_quat(scalar_first=True)
    place = np.array(poses.handle.position)
    poses.handle.wxyz = wanted
    for _ in range(180):
        poses.frame(FRAME)
    moment = poses.player.moment
    assert poses.stage.target_axes.visible
    assert poses.stage.axes.visible
    for axes in (poses.stage.axes, poses.stage.target_axes):
        assert angle(axes.wxyz, wanted) < 0.02
        assert np.linalg.norm(axes.position - place) < 0.002
    assert angle(moment.orientation, wanted) < 0.02
    assert f"**{poses.stage.label.text}** to the target, **reached**" in poses.panel.said
    assert poses.stage.label.text.endswith("°")


@pytest.mark.slow
def test_where_the_arm_has_no_such_pose_the_target_stays_and_the_panel_says_so(poses: Viewer) -> None:
    before = poses.player.moment
    poses.handle.position = poses.stage.goals[1]
    back = Rotation.align_vectors(-poses.stage.goals[1:], np.array([[0.0, 0.0, 1.0]]))[
        0
    ]  # the wrist behind the farthest corner
    poses.handle.wxyz = back.as_quat(scalar_first=True)
    poses.frame(0.0)
    assert UNREACHABLE in poses.panel.said
    np.testing.assert_array_equal(poses.player.moment.target, before.target)
    poses.frame(0.0)
    np.testing.assert_allclose(poses.handle.position, before.target, atol=1e-6)
    assert angle(np.array(poses.handle.wxyz), before.target_orientation) < 1e-3
    poses.handle.position = before.target + np.array([0.0, 0.0, 0.01])
    poses.frame(0.0)
    assert UNREACHABLE not in poses.panel.said


@pytest.mark.slow
def test_a_target_that_moves_shows_its_trail_until_it_is_taken_off_its_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = configure("track", num_envs=8, hidden=(8,), goal_paths=("smooth",))
    with view(config, untrained(config, tmp_path / "run")) as viewer:
        monkeypatch.setattr(viewer._server, "get_clients", lambda: {0: None})
        lengths = []
        for _ in range(100):
            viewer.frame(FRAME)
            assert viewer.stage.trail
            lengths.append(len(viewer.stage.trail.points))
        assert lengths == sorted(lengths)
        assert lengths[-1] > lengths[0] + 3
        COMMANDS["Step"](viewer)
        assert "RMS" in viewer.panel.said
        COMMANDS["Pause"](viewer)
        np.testing.assert_allclose(viewer.handle.position, viewer.player.moment.target, atol=0.02)
        viewer.handle.position = place = viewer.stage.goals.mean(axis=0)
        for _ in range(50):
            viewer.frame(FRAME)
        np.testing.assert_allclose(viewer.player.moment.target, place, atol=1e-6)
        COMMANDS["Reset"](viewer)
        assert viewer.player.on_path
        first = viewer.player.moment.target
        for _ in range(50):
            viewer.frame(FRAME)
        assert not np.allclose(viewer.player.moment.target, first, atol=1e-3)


def test_the_workspace_and_the_tools_path_are_drawn(viewer: Viewer) -> None:
    for _ in range(50):
        viewer.step()
    low, high = load_robot("iiwa14").workspace
    edges = viewer.stage.workspace.points
    assert edges.shape == (12, 2, 3)
    np.testing.assert_allclose([edges.min(axis=(0, 1)), edges.max(axis=(0, 1))], [low, high], atol=1e-6)
    assert viewer.stage.path
    np.testing.assert_allclose(viewer.stage.path.points[-1, 1], viewer.player.moment.tool, atol=2 * PATH_STEP)


def test_the_panel_and_the_label_tell_the_same_moment(viewer: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer._server, "get_clients", lambda: {0: None})
    told = set()
    for _ in range(200):
        viewer.frame(FRAME)
        assert f"**{viewer.stage.label.text}** to the target" in viewer.panel.said
        assert ("**reached**" in viewer.panel.said) is viewer.player.moment.reached
        assert (viewer.stage.balls[0].color == REACHED_BYTES) is viewer.player.moment.reached
        told.add(viewer.player.moment.reached)
    assert told == {True, False}


def test_the_success_distance_is_drawn_around_the_target(viewer: Viewer) -> None:
    core, near = sorted(float(np.linalg.norm(ball.vertices, axis=1).max()) for ball in viewer.stage.balls)
    assert core == pytest.approx(TARGET_RADIUS, rel=1e-3)
    assert near == pytest.approx(0.1, rel=1e-3)


def test_an_arm_that_leaves_its_workspace_says_so_and_tries_again_from_home(
    viewer: Viewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer._server, "get_clients", lambda: {0: None})
    viewer.panel.endless = True
    target, state = viewer.player.moment.target, viewer.player.state
    viewer.player.state = replace(state, command=state.command.at[:, 0].add(2.5))  # behind its base
    said = []
    for _ in range(300):
        viewer.frame(FRAME)
        said.append(viewer.panel.said)
    assert any("**left the workspace**, begins again at home" in text for text in said)
    assert "**reached**" in said[-1]
    np.testing.assert_array_equal(viewer.player.moment.target, target)
    assert not viewer.player.over


def test_nothing_moves_while_nobody_looks(viewer: Viewer) -> None:
    steps = viewer.player.steps
    for _ in range(10):
        viewer.frame(1.0)
    assert viewer.player.steps == steps


def test_buttons_step_pause_and_draw_a_new_target(viewer: Viewer) -> None:
    steps, target = viewer.player.steps, viewer.player.moment.target
    COMMANDS["Step"](viewer)
    assert (viewer.player.steps, viewer.paused) == (steps + 1, True)
    COMMANDS["Pause"](viewer)
    assert not viewer.paused
    COMMANDS["Reset"](viewer)
    assert not np.allclose(viewer.player.moment.target, target)
    np.testing.assert_allclose(viewer.handle.position, viewer.player.moment.target)


def test_the_target_is_where_its_handle_is_put(viewer: Viewer) -> None:
    height = viewer.player.moment.target[2]
    for x, y in ((0.25, -0.25), (0.65, 0.25)):
        viewer.handle.position = (x, y, height)
        viewer.frame(0.0)
        np.testing.assert_allclose(viewer.player.moment.target, [x, y, height], atol=1e-6)


def test_a_handle_outside_comes_back_to_where_targets_lie(viewer: Viewer) -> None:
    viewer.handle.position = (5.0, -5.0, 5.0)
    viewer.frame(0.0)
    viewer.frame(0.0)
    np.testing.assert_allclose(viewer.handle.position, [0.7, -0.3, -0.0083], atol=1e-3)


def test_the_server_prints_nothing_when_it_starts_and_stops(capfd: pytest.CaptureFixture[str]) -> None:
    start_server(LOCAL, free_port()).stop()
    assert capfd.readouterr() == ("", "")


def test_what_is_no_message_of_a_browser_is_told_in_one_line(caplog: pytest.LogCaptureFixture) -> None:
    start_server(LOCAL, free_port()).stop()
    try:
        raise ValueError("no message")
    except ValueError:
        logging.getLogger(server_module.WEBSOCKETS).exception("connection handler failed")
    (record,) = caplog.records
    assert (record.exc_info, record.getMessage().startswith("reachlab: a connection")) == (None, True)


@dataclass
class Visited:
    """A server to which a browser comes at the third look."""

    looks: int = 0

    def get_clients(self) -> list[int]:
        self.looks += 1
        return [1] * (self.looks >= 3)


def test_the_processor_is_left_to_a_browser_that_comes_but_not_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "DRAWING", 0.3)
    visited, begun = cast("Any", Visited()), time.perf_counter()
    server_module.await_picture(visited, lambda: False)
    assert visited.looks == 3
    assert 0.3 <= time.perf_counter() - begun < server_module.ARRIVAL
    monkeypatch.setattr(server_module, "ARRIVAL", 0.1)
    alone = cast("Any", Visited(looks=-1000))
    server_module.await_picture(alone, lambda: False)
    assert alone.looks < 0
    gone = cast("Any", Visited())
    server_module.await_picture(gone, lambda: True)
    assert gone.looks == 0


def test_the_scene_is_never_shared_through_the_makers_server() -> None:
    server = start_server(LOCAL, free_port())
    try:
        assert server.request_share_url() is None
    finally:
        server.stop()


def test_a_host_that_is_not_this_machine_is_refused() -> None:
    with pytest.raises(InputError, match=r"host '192.0.2.1' is no address of this machine \(.+\): leave it out"):
        start_server("192.0.2.1", 8080)


def test_without_viser_its_install_command_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match=re.escape(installing("viewer"))):
        start_server(LOCAL, 8080)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--agent", "traind"], "Did you mean 'trained'"),
        (["--sim", "mujoko"], "Did you mean 'mujoco'"),
        (["--port", "0"], "port must be at least 1"),
        (
            ["--save", "no/such/folder/page.html", "--episodes", "1"],
            "cannot be written: there is no folder 'no/such/folder'",
        ),
    ],
    ids=str,
)
def test_wrong_words_are_refused_in_a_sentence(
    run: RunDirectory, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["view", str(run.path), *words]) == cli.WRONG_INPUT
    assert said in capsys.readouterr().err


def test_every_checkpoint_can_be_chosen(run: RunDirectory, config: RunConfig) -> None:
    env = Env(config, 1)
    first, last = (load_policy(run, env, step) for step in run.checkpoint_steps())
    newest = load_policy(run, env)
    weights = [np.asarray(policy.parameters.actor[0][0]) for policy in (first, last, newest)]
    assert not np.array_equal(weights[0], weights[1])
    np.testing.assert_array_equal(weights[1], weights[2])


def test_where_a_checkpoint_cannot_be_read_the_last_policy_goes_on(config: RunConfig, tmp_path: Path) -> None:
    run = untrained(config, tmp_path / "run")
    with view(config, run, "trained") as viewer:
        shutil.rmtree(run.checkpoints / f"step_{CHECKPOINTS[0]:012d}")
        viewer.panel.checkpoint = CHECKPOINTS[0]
        viewer.step()
        assert "is damaged" in viewer.panel.refusal
        assert viewer.panel.checkpoint == CHECKPOINTS[1]


def test_a_damaged_checkpoint_is_not_offered(
    config: RunConfig, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run = untrained(config, tmp_path / "run")
    (run.checkpoints / f"step_{CHECKPOINTS[1]:012d}" / "state.safetensors").write_bytes(b"no arrays")
    assert run.checkpoint_steps() == [CHECKPOINTS[0]]
    assert "is left out" in caplog.text


@pytest.mark.parametrize(("host", "local"), [("127.0.0.1", True), ("localhost", True), ("0.0.0.0", False)])
def test_other_machines_are_let_in_with_a_warning_only(
    run: RunDirectory,
    host: str,
    local: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(Viewer, "run", lambda *_: None)
    assert cli.main(["view", str(run.path), "--agent", "zero", "--host", host, "--port", str(free_port())]) == cli.DONE
    assert ("Warning:" in capsys.readouterr().err) is not local


def test_ctrl_c_ends_it_quietly(run: RunDirectory) -> None:
    words = [sys.executable, "-m", "reachlab", "view", str(run.path), "--port", str(free_port())]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout
        assert process.stdout.readline().startswith("Viewer: http://127.0.0.1:")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (0, "", "")


# --- obstacles ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_obstacle_that_is_pulled_is_there_in_the_scene_and_in_the_engine(tmp_path: Path) -> None:
    config = configure("clutter", num_envs=8, hidden=(8,), obstacles=(1, 1), randomise=())
    with view(config, untrained(config, tmp_path / "run")) as viewer:
        assert MOVABLE in viewer.panel.said
        place = np.array([0.6, 0.3, 0.5])
        viewer._pulled.put((0, place))
        viewer.frame(0.0)
        np.testing.assert_allclose(viewer.player.moment.blocks[0].position, place, atol=1e-6)
        np.testing.assert_allclose(viewer.stage.bodies[0].position, place, atol=1e-6)
        viewer._pulled.put((0, viewer.player.moment.tool))
        viewer.frame(0.0)
        viewer.step()
        assert viewer.player.failed == TOUCHED
        assert viewer.stage.bodies[0].color == tuple(round(255 * part) for part in marks.TOUCHED)
