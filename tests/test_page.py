"""The page in which policies run by themselves: it computes what the environment does, and follows a hand."""

from __future__ import annotations

import contextlib
import io
import itertools
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from browser.driver import chromium, executable, opened, traffic, wait_until
from browser.live import SIZES, arrived, moment, open_live
from browser.played import in_page, natively
from reachlab.cli import main as cli
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.learn.ppo_method import TrainState, initial_state
from reachlab.learn.train import train
from reachlab.runs.directory import RunDirectory
from reachlab.settings.config import RunConfig
from reachlab.tasks.schema import SIZE
from reachlab.watch.page.page import write_page
from reachlab.watch.page.server import LOCAL
from reachlab.watch.page.shown import load_shown
from reachlab.watch.player import Player

pytestmark = pytest.mark.slow

BESIDE = ("panda/push", "panda/lift", "panda/clutter")
"""Policies whose arms have something beside them."""

EPISODES = 200
"""Held-out episodes that are compared."""

SAME = 1e-4
"""Distance within which two ways of a tool are the same [m]."""

FEW_STEPS = 160_000
"""Training after which some episodes of the tutorial's task succeed, and some do not."""

DRAGGED = 80
"""How far the pointer moves in a drag [pixels]."""


def unlearnt(config: RunConfig, path: Path) -> Path:
    """A run whose policy has random weights, and so corrects inverse kinematics at random."""
    env = Env(config, config.loop.num_envs)
    run = RunDirectory(path)
    run.create(config)
    state: TrainState = env.compile_whole(lambda seed: initial_state(env, config, seed))(np.uint32(0))
    random, policy = np.random.default_rng(0), state.learner.policy
    moved = jax.tree.map(lambda x: (x + 0.1 * random.normal(size=x.shape)).astype(x.dtype), policy.parameters)
    learner = replace(state.learner, policy=replace(policy, parameters=moved))
    run.write_checkpoint(0, replace(state, learner=learner))
    env.close()
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("live")


@pytest.fixture(scope="module")
def tutorial(folder: Path) -> Path:
    config = configure(
        "tutorial", total_steps=FEW_STEPS, stop_early=False, report_episodes=10, validation_interval=1000
    )
    train(config, folder / "tutorial")
    return folder / "tutorial"


@pytest.fixture(scope="module")
def precise(folder: Path) -> Path:
    return unlearnt(configure("precise", robot="panda", num_envs=8, hidden=(16,)), folder / "precise")


@pytest.fixture(scope="module")
def both(folder: Path, tutorial: Path, precise: Path) -> Path:
    write_page([load_shown(tutorial), load_shown(precise)], folder / "both.html")
    return folder / "both.html"


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
    """A page that says nothing on its console and asks nobody for anything."""
    said: list[str] = []
    with opened(browser, *SIZES[0]) as page:
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        seen = traffic(page)
        yield page
        assert not said
        assert all(url.startswith(("file:", "data:", "blob:")) for url in seen.requests)


# --- what it computes -----------------------------------------------------------------------------


def compared(page: Page, env: Env, policy: Any, number: int, agent: str) -> np.ndarray:
    """Successes `[B]` of an agent, which are those that the page computes, on the same ways of the tool."""
    begin, native = natively(env, policy, agent)
    found = in_page(page, begin, number, agent, env.setup.period)
    np.testing.assert_array_equal(found.success, native.success)
    assert np.abs(found.steps - native.steps).max() <= 1
    for i, steps in enumerate(np.minimum(found.steps, native.steps) + 1):
        assert np.linalg.norm(found.tools[:steps, i] - native.tools[:steps, i], axis=1).max() < SAME
    return native.success


def test_the_page_plays_episodes_as_the_kinematic_simulator_does(page: Page, both: Path, tutorial: Path) -> None:
    open_live(page, both)
    page.evaluate("reachlab.live.panel.pause(true)")
    shown = load_shown(tutorial)
    env = Env(shown.env.config, EPISODES)
    learnt = compared(page, env, shown.policy, 0, "trained")
    assert 0.05 < learnt.mean() < 0.999, "not all the same"
    assert compared(page, env, shown.policy, 0, "ik").mean() > 0.9


def test_the_page_plays_episodes_as_the_engine_of_training_does(page: Page, both: Path, precise: Path) -> None:
    shown = load_shown(precise)
    assert shown.env.config.sim == "mujoco"
    env = Env(shown.env.config, 20)
    open_live(page, both)
    page.evaluate("reachlab.live.panel.pause(true)")
    assert compared(page, env, shown.policy, 1, "ik").mean() > 0.9
    compared(page, env, shown.policy, 1, "trained")
    env.close()


STEPPED = """([goal, far]) => {
    const { run } = reachlab.live.player, Episode = reachlab.live.player.episode.constructor;
    const episode = new Episode(run, run.draw(), run.simulator), commands = [episode.command];
    const step = (instead) => commands.push((episode.step("ik", instead), episode.command));
    for (let k = 0; k < 20; k++) step(null);
    episode.place(goal);
    for (let k = 0; k < 20; k++) step(null);
    for (let k = 0; k < 20; k++) step(far);
    return commands.map((command) => [...command]);
}"""
"""Commands on the way to a goal, to another one, and to joints that are asked for at once."""


def test_commands_in_the_page_keep_the_limits_that_training_kept(page: Page, folder: Path) -> None:
    config = configure("precise", robot="panda", num_envs=8, hidden=(16,), shaping=True)
    shown = load_shown(unlearnt(config, folder / "shaped"))
    env = Env(shown.env.config, 20)
    write_page([shown], folder / "shaped.html")
    open_live(page, folder / "shaped.html")
    page.evaluate("reachlab.live.panel.pause(true)")
    assert compared(page, env, shown.policy, 0, "ik").mean() > 0.9
    compared(page, env, shown.policy, 0, "trained")
    limits, period = env.setup.robot.commands, env.setup.period
    far = (env.setup.robot.home + 0.5 * np.asarray(limits.speed)).tolist()
    env.close()
    commands = np.array(page.evaluate(STEPPED, [[0.5, 0.2, 0.5], far]))
    for power, limit in enumerate((limits.speed, limits.acceleration, limits.jerk), start=1):
        changes = np.abs(np.diff(commands, power, axis=0)).max(axis=0) / period**power
        assert (changes <= 1.001 * np.asarray(limit)).all()
    assert np.abs(commands[-1] - commands[-20]).max() > 0.1, "else this test asks for nothing"


@pytest.fixture(scope="module")
def bodies(folder: Path) -> Path:
    write_page([load_shown(Path(run)) for run in BESIDE], folder / "bodies.html")
    return folder / "bodies.html"


@pytest.mark.parametrize("run", BESIDE)
def test_bodies_move_in_the_page_as_in_training(page: Page, bodies: Path, run: str) -> None:
    shown, number = load_shown(Path(run)), BESIDE.index(run)
    env = Env(shown.env.config, 12)
    begin, native = natively(env, shown.policy, "trained")
    env.close()
    open_live(page, bodies)
    page.evaluate("reachlab.live.panel.pause(true)")
    found = in_page(page, begin, number, "trained", env.setup.period)
    assert (found.success == native.success).mean() > 0.9
    apart = np.abs(found.states - native.states).max(axis=1)
    # Where a cube is struck on its edge, the last digit decides how it turns.
    assert np.nanmedian(apart) < SAME
    if "clutter" not in run:
        start = np.array([one["bodies_position"] for one in begin])
        assert (np.linalg.norm(start - found.states[:, -3:], axis=1) > 0.02).all(), "the cube is moved"


def test_a_goal_that_is_moved_is_followed_as_python_does(page: Page, both: Path, tutorial: Path) -> None:
    shown = load_shown(tutorial)
    player = Player(Env(shown.env.config, 1), seed=1)
    start, first = (np.array(row, float).tolist() for row in (player.moment.q, player.moment.target))
    other = [0.55, 0.2, first[2]]
    told: list[list[Any]] = []

    def play(steps: int) -> None:
        for _ in range(steps):
            if player.over:
                player.proceed()
            player.step("trained", shown.policy)
            told.append([*np.array(player.moment.tool, float).tolist(), player.clock, player.failed, player.over])

    player.follow(True)
    play(200)
    player.move_target(np.array(other))
    play(400)
    player.follow(False)
    play(50)
    open_live(page, both)
    found = page.evaluate(
        """([start, first, other]) => {
            const { player } = reachlab.live, told = [];
            reachlab.live.panel.pause(true);
            const play = (steps) => {
                for (let i = 0; i < steps; i++) {
                    if (player.over) player.proceed();
                    player.step("trained");
                    const { tool, clock } = player.episode;
                    told.push([...tool, clock, player.failed, player.over]);
                }
            };
            player.begin({ q: start, goal_position: first });
            player.follow(true);
            play(200);
            player.moveGoal(other);
            play(400);
            player.follow(false);
            play(50);
            return told;
        }""",
        [start, first, other],
    )
    before = next((i for i, row in enumerate(told) if row[-1]), len(told))  # then begins another random episode
    assert before > 400
    assert [row[3:] for row in found[:before]] == [row[3:] for row in told[:before]]
    ways = np.array([row[:3] for row in found[:before]]), np.array([row[:3] for row in told[:before]])
    assert np.linalg.norm(ways[0] - ways[1], axis=1).max() < SAME


# --- by hand --------------------------------------------------------------------------------------


def choose_precise(page: Page, agent: str = "ik") -> None:
    page.locator("#policy").select_option(index=1)
    page.wait_for_function("document.title.startsWith('Franka')")
    page.get_by_role("button", name=agent).click()


def apart(one: list[float], other: list[float]) -> float:
    return float(np.linalg.norm(np.subtract(one, other)))


def test_the_arm_follows_the_mouse_and_rests_there(page: Page, both: Path) -> None:
    open_live(page, both)
    choose_precise(page)
    arrived(page)
    before = moment(page)
    page.mouse.move(before["x"], before["y"])
    page.mouse.down()
    page.mouse.move(before["x"] + DRAGGED, before["y"] - DRAGGED, steps=5)
    wait_until(lambda: apart(moment(page)["goal"], before["goal"]) > 0.03, "the goal's move")
    arrived(page)
    held = moment(page)
    assert apart(held["tool"], held["goal"]) < 0.01
    assert apart(held["tool"], before["tool"]) > 0.02
    low, high = (np.array(held["box"][side]) for side in ("low", "high"))
    page.mouse.move(before["x"], -2000, steps=3)
    wait_until(lambda: bool(np.isclose(moment(page)["goal"], [low, high]).any()), "the box's end")
    assert (np.array(moment(page)["goal"]) <= high + 1e-9).all()
    page.mouse.up()
    assert moment(page)["episodes"] == held["episodes"]


def test_a_cube_that_is_dragged_falls_and_is_pushed_again(page: Page, bodies: Path) -> None:
    open_live(page, bodies)
    expect(page.locator("#hint")).to_contain_text("or a body")
    page.get_by_label("Endless").check()
    arrived(page)
    before = moment(page)
    x, y = before["bodies"][0][3:5]
    page.mouse.move(x + 12, y)  # beside the goal's middle
    page.mouse.down()
    page.mouse.move(x + 12 - DRAGGED, y - DRAGGED, steps=5)
    wait_until(lambda: apart(moment(page)["bodies"][0][:2], before["bodies"][0][:2]) > 0.04, "the cube's move")
    wait_until(lambda: moment(page)["bodies"][0][2] > before["bodies"][0][2] + 0.015, "it to be held above the table")
    assert apart(moment(page)["goal"], before["goal"]) < 1e-6
    page.mouse.up()
    wait_until(lambda: moment(page)["bodies"][0][2] < before["bodies"][0][2] + 0.005, "its fall")
    arrived(page)
    assert apart(moment(page)["bodies"][0][:3], before["goal"]) < 0.02


@pytest.mark.usefixtures("entered")
def test_a_body_that_a_task_moves_may_be_dragged(page: Page, tmp_path: Path) -> None:
    run = unlearnt(configure("rail", num_envs=8, hidden=(8,)), tmp_path / "rail")
    write_page([load_shown(run)], tmp_path / "rail.html")
    open_live(page, tmp_path / "rail.html")
    x, y = moment(page)["bodies"][0][3:5]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - DRAGGED, y, steps=5)
    page.mouse.up()
    steps = moment(page)["steps"]
    wait_until(lambda: moment(page)["steps"] > steps + 20, "it to go on")
    after = moment(page)
    assert np.isfinite([after["distance"], *after["goal"], *after["bodies"][0]]).all()
    low, high = (after["box"][end][1] for end in ("low", "high"))
    assert low - 1e-6 <= after["bodies"][0][1] <= high + 1e-6, "it stays on its rail"


def test_sliders_make_another_arm_and_another_cube(page: Page, bodies: Path) -> None:
    open_live(page, bodies)
    page.get_by_label("Endless").check()
    arrived(page)
    weigh = "[...reachlab.live.player.run.simulator.model.body_mass].reduce((sum, mass) => sum + mass, 0)"
    stiff = "reachlab.live.player.run.simulator.model.actuator_gainprm[0]"
    heavy, gain = page.evaluate(weigh), page.evaluate(stiff)
    page.get_by_label("Object mass").fill(str(np.log(3)))
    page.get_by_label("Servo gain").fill(str(np.log(0.5)))
    assert page.evaluate(weigh) - heavy == pytest.approx(0.2, abs=1e-3)
    assert page.evaluate(stiff) == pytest.approx(0.5 * gain)
    page.get_by_role("button", name="Reset").click()
    arrived(page)
    choose = page.locator("#policy")
    choose.select_option(index=2)
    page.wait_for_function("reachlab.live.player.run.facts.task === 'clutter'")
    assert not page.get_by_label("Object mass").is_visible()
    choose.select_option(index=0)
    page.wait_for_function("reachlab.live.player.run.facts.task === 'push'")
    assert page.evaluate(stiff) == pytest.approx(gain)


def test_the_arm_follows_a_finger(browser: Browser, both: Path) -> None:
    width, height = SIZES[1]
    page = browser.new_page(viewport={"width": width, "height": height}, has_touch=True, is_mobile=True)
    open_live(page, both)
    choose_precise(page)
    before = moment(page)
    touch = page.context.new_cdp_session(page)

    def finger(kind: str, *place: float) -> None:
        points = [{"x": place[0], "y": place[1]}] if place else []
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    finger("touchStart", before["x"], before["y"])
    for share in (0.5, 1.0):
        finger("touchMove", before["x"] - share * DRAGGED, before["y"] - share * DRAGGED)
    wait_until(lambda: apart(moment(page)["goal"], before["goal"]) > 0.03, "the goal's move")
    arrived(page)
    assert apart(moment(page)["tool"], moment(page)["goal"]) < 0.01
    finger("touchEnd")
    page.close()


def test_a_drag_elsewhere_turns_the_view_and_the_goal_stays(page: Page, both: Path) -> None:
    open_live(page, both)
    expect(page.locator("#hint")).to_have_text("Drag the goal; drag elsewhere to turn the view.")
    page.get_by_role("button", name="Pause").click()
    before, camera = moment(page), page.evaluate("reachlab.live.drawing.camera.position.toArray()")
    page.mouse.move(60, 60)
    page.mouse.down()
    page.mouse.move(260, 90, steps=5)
    page.mouse.up()
    wait_until(lambda: page.evaluate("reachlab.live.drawing.camera.position.toArray()") != camera, "another view")
    after = moment(page)
    assert after["goal"] == before["goal"]
    assert (after["x"], after["y"]) != (before["x"], before["y"])


def test_every_control_does_what_it_says(page: Page, both: Path) -> None:
    open_live(page, both)
    assert page.title() == "KUKA LBR iiwa 14 R820 · tutorial · reachlab"
    page.get_by_role("button", name="ik").click()
    page.get_by_role("button", name="max").click()
    wait_until(lambda: moment(page)["successes"] > 5, "episodes")
    page.get_by_role("button", name="Pause").click()
    page.wait_for_timeout(100)
    still = moment(page)
    page.get_by_role("button", name="Reset").click()
    page.wait_for_timeout(100)
    begun = moment(page)
    assert begun["steps"] == still["steps"]
    assert begun["clock"] == 0
    assert begun["goal"] != still["goal"]
    page.get_by_role("button", name="Step").click()
    wait_until(lambda: moment(page)["clock"] == 1, "a step")
    ahead = "reachlab.live.drawing.camera.getWorldDirection(new THREE.Vector3()).toArray()"
    views = {}
    for side in ("side", "above", "front"):
        page.get_by_role("button", name=side).click()
        page.wait_for_timeout(100)
        views[side] = page.evaluate(ahead)
    assert views["above"][2] < -0.99
    assert abs(np.dot(views["side"][:2], views["front"][:2])) < 0.01
    choose_precise(page)
    page.get_by_label("Endless").check()
    page.get_by_role("button", name="Continue").click()
    wait_until(lambda: moment(page)["clock"] > 150, "time beyond an episode's")
    assert moment(page)["episodes"] == 0


@pytest.mark.parametrize("size", SIZES, ids=["computer", "telephone"])
def test_the_arm_is_in_view_and_the_panel_beside_it(browser: Browser, both: Path, size: tuple[int, int]) -> None:
    with opened(browser, *size) as page:
        open_live(page, both)
        assert page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]") == [*size]
        scene, panel = page.locator("#scene").bounding_box(), page.locator("aside").bounding_box()
        assert scene
        assert panel
        # Half a pixel is that of a browser that rounds.
        right, below = panel["x"] - scene["x"] - scene["width"], panel["y"] - scene["y"] - scene["height"]
        assert max(right, below) > -0.5
        corners = page.evaluate("reachlab.live.drawing.shown.points.map(point => reachlab.live.hand.onScreen(point))")
        x, y, _ = np.transpose(corners)
        assert (x > scene["x"]).all()
        assert (x < scene["x"] + scene["width"]).all()
        assert (y > scene["y"]).all()
        assert (y < scene["y"] + scene["height"]).all()


NARROW = ((320, 568), (667, 375), (740, 360))
"""Windows of telephones that are small or held sideways."""


@pytest.mark.parametrize("size", [*SIZES, *NARROW])
def test_nothing_of_the_panel_is_cut_off(browser: Browser, both: Path, size: tuple[int, int]) -> None:
    with opened(browser, *size) as page:
        open_live(page, both)
        page.evaluate("document.getElementById('title').textContent = 'arm_of_a_long_name_and_its_gripper_calibrated'")
        page.get_by_text("Joints", exact=True).click()
        wide, shown = page.evaluate(
            "(panel => [panel.scrollWidth, panel.clientWidth])(document.querySelector('aside'))"
        )
        assert wide <= shown


def test_controls_have_names_and_say_what_they_stand_for(page: Page, both: Path) -> None:
    open_live(page, both)
    for group in ("Agent", "Speed", "View"):
        assert page.get_by_role("group", name=group).get_by_role("button").count() > 1
    choose_precise(page)
    gain = page.get_by_label("Servo gain")
    gain.fill(str(np.log(0.5)))
    assert gain.get_attribute("aria-valuetext") == "0.50 ×"
    page.get_by_role("button", name="Pause").click()
    page.get_by_text("Joints", exact=True).click()
    expect(page.locator("#joints .slider input").first).to_have_attribute("aria-valuetext", re.compile(r"^-?\d+\.\d°$"))


def test_shapes_of_bodies_are_freed(page: Page, bodies: Path) -> None:
    open_live(page, bodies)
    page.locator("#policy").select_option(index=2)
    page.wait_for_function("reachlab.live.player.run.facts.task === 'clutter'")
    held = "reachlab.live.drawing.renderer.info.memory.geometries"
    counts = []
    for _ in range(12):
        page.get_by_role("button", name="Reset").click()
        page.wait_for_timeout(100)
        counts.append(page.evaluate(held))
    assert max(counts[2:]) <= min(counts[2:]) + 10, "as many bodies as there are at most, not those of each episode"


def test_slow_computers_draw_fewer_triangles_of_the_same_shapes(page: Page, both: Path) -> None:
    open_live(page, both)
    page.evaluate("reachlab.live.drawing.simplify()")
    read = """reachlab.live.drawing.shapes.map(({ index, attributes }) =>
        [[...index.array], [...attributes.position.array]])"""
    simple, parts = page.evaluate(read), page.evaluate("reachlab.live.drawing.shown.parts")
    assert sum(len(index) for index, _ in simple) < 0.6 * sum(3 * part["faces"] for part in parts)
    for (index, places), part in zip(simple, parts, strict=True):
        corners = np.reshape(places, (-1, 3))[index]
        reach = [part["low"], np.add(part["low"], part["size"])]
        np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], reach, rtol=0, atol=0.003)
    page.evaluate("reachlab.live.drawing.simplify()")  # as for a second arm, which shares shapes
    assert page.evaluate(read) == simple


def test_a_lost_context_is_made_anew_on_the_same_ground(browser: Browser, both: Path) -> None:
    lose = "window.lost = reachlab.live.drawing.renderer.getContext().getExtension('WEBGL_lose_context')"
    with opened(browser, *SIZES[0]) as page:
        open_live(page, both)
        page.evaluate(f"{lose}; lost.loseContext(); setTimeout(() => lost.restoreContext(), 200)")
        page.wait_for_timeout(1000)
        bright = page.screenshot(clip={"x": 4, "y": 4, "width": 4, "height": 4})
    assert np.asarray(Image.open(io.BytesIO(bright)).convert("RGB")).min() > 200


# --- what is drawn and what is drawn at random ----------------------------------------------------


DRAW = "number => reachlab.live.run(number).then(run => Array.from({ length: 60 }, () => run.draw()))"
"""Begins of episodes of a run."""


def test_random_goals_are_those_of_the_task(page: Page, folder: Path) -> None:
    names = ("pose", "track")
    configs = [configure(name, robot="so101" if name == "pose" else "ur5e", num_envs=8, hidden=(8,)) for name in names]
    runs = [unlearnt(config, folder / name) for name, config in zip(names, configs, strict=True)]
    write_page(list(map(load_shown, runs)), folder / "goals.html")
    open_live(page, folder / "goals.html")
    for number, run in enumerate(runs):
        env = load_shown(run).env
        low, high = env.setup.task.goal_box(env.setup)
        drawn = page.evaluate(DRAW, number)
        places = np.array([one["goal_position"] for one in drawn])
        assert (places >= low - 1e-3).all()
        assert (places <= high + 1e-3).all()
        assert (np.ptp(places, axis=0) > 0.5 * (high - low)).all()
        away = np.array([one["q"] for one in drawn]) - env.setup.robot.home
        assert 0.8 * env.setup.rules.start_noise < np.abs(away).max() <= env.setup.rules.start_noise + 1e-6


# --- what the page has beside -----------------------------------------------------------------------


def test_a_goal_is_turned_by_its_axes(page: Page, folder: Path) -> None:
    run = unlearnt(configure("pose", robot="panda", num_envs=8, hidden=(8,)), folder / "turned")
    write_page([load_shown(run, agent="ik")], folder / "turned.html")
    open_live(page, folder / "turned.html")
    page.get_by_label("Endless").check()
    arrived(page)
    before = moment(page)
    turned = "reachlab.live.player.episode.state.goal_quaternion"
    begun = page.evaluate(f"[...{turned}]")
    moved = []
    for knob in range(3):
        x, y = moment(page)["knobs"][knob][3:5]
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 20, y - 15, steps=4)
        page.mouse.up()
        page.wait_for_timeout(200)
        moved.append(page.evaluate(f"[...{turned}]"))
    angles = [2 * np.arccos(min(abs(np.dot(one, two)), 1)) for one, two in itertools.pairwise([begun, *moved])]
    assert max(angles) > 0.05
    assert apart(moment(page)["goal"], before["goal"]) < 3e-4
    arrived(page)
    assert page.evaluate("reachlab.live.player.episode.angle") < 0.05
    assert moment(page)["episodes"] == before["episodes"]


def test_joints_are_moved_by_sliders_and_shown_at_their_limits(page: Page, both: Path) -> None:
    open_live(page, both)
    choose_precise(page)
    page.get_by_text("Joints", exact=True).click()
    rows = page.locator("#joints .slider")
    assert rows.count() == 7
    wait_until(lambda: rows.nth(0).locator("output").inner_text().endswith("°"), "where the joint is")
    lower, upper = (page.evaluate(f"reachlab.live.shown.facts.limits.{side}[0]") for side in ("lower", "upper"))
    rows.nth(0).locator("input").fill(str(upper))
    assert page.get_by_role("button", name="sliders").get_attribute("aria-pressed") == "true"
    joint = "reachlab.live.player.episode.state.q[0]"
    wait_until(lambda: page.evaluate(joint) > upper - 0.05 * (upper - lower), "the joint's way")
    wait_until(lambda: "limit" in (rows.nth(0).get_attribute("class") or ""), "its limit")
    assert moment(page)["failed"] == ""
    page.get_by_label("Frames of the links").check()
    wait_until(lambda: page.evaluate("reachlab.live.drawing.arms[0].frames.every(({ visible }) => visible)"), "frames")
    page.get_by_role("button", name="ik").click()
    page.get_by_role("button", name="Reset").click()
    arrived(page)


def test_several_episodes_and_two_agents_are_shown_at_once(page: Page, bodies: Path) -> None:
    open_live(page, bodies)
    page.get_by_role("button", name="max").click()
    page.get_by_label("At once").select_option("four episodes")
    players = "reachlab.live.players"
    ended = f"{players}.length === 4 && {players}.every(({{ episodes }}) => episodes)"
    wait_until(lambda: page.evaluate(ended), "ends")
    goals = page.evaluate(f"{players}.map(({{ episode }}) => episode.goal[0])")
    assert len(set(goals)) == 4
    page.get_by_label("At once").select_option("policy and baseline")
    wait_until(lambda: page.evaluate(f"{players}.length === 2 && {players}[1].episodes > 2"), "more ends")
    episodes = page.evaluate(f"{players}.map(({{ episodes, episode }}) => [episodes, ...episode.goal])")
    assert abs(episodes[0][0] - episodes[1][0]) <= 1
    labels = [page.locator(f"#who{i}").inner_text() for i in (0, 1)]
    assert labels[0].startswith("trained: ")
    assert labels[1].startswith("script: ")
    page.get_by_label("At once").select_option("one episode")
    wait_until(lambda: page.evaluate(f"{players}.length === 1"), "one arm")
    wait_until(lambda: not page.locator("#who0").is_visible(), "no label")


def test_failures_of_an_evaluation_are_played_again(page: Page, tutorial: Path, folder: Path) -> None:
    words = ["--episodes", "200", "--seed", "3"]
    assert cli.main(["eval", str(tutorial), "--agent", "trained", *words]) == cli.DONE
    shown = load_shown(tutorial)
    assert shown.failed
    assert {seed for seed, _ in shown.failed} == {3}
    write_page([shown], folder / "failed.html")
    open_live(page, folder / "failed.html")
    page.locator("#episodes").select_option(f"failures ({len(shown.failed)})")
    page.get_by_role("button", name="max").click()
    wait_until(lambda: moment(page)["episodes"] >= len(shown.failed), "all of them")
    after = moment(page)
    assert after["successes"] <= 0.1 * after["episodes"]


def test_every_checkpoint_can_be_chosen(page: Page, folder: Path) -> None:
    run = folder / "two"
    few = {"num_envs": 8, "hidden": (8,), "total_steps": 2000, "checkpoint_interval": 0.0, "report_episodes": 1}
    train(configure("precise", **few), run)
    steps = sorted((int(one.name.removeprefix("step_")) for one in (run / "checkpoints").iterdir()), reverse=True)
    assert len(steps) > 1
    assert cli.main(["view", str(run), "--checkpoints", "--out", str(folder / "two.html")]) == cli.DONE
    open_live(page, folder / "two.html")
    named = page.locator("#policy option").all_inner_texts()
    assert [name.partition(", ")[2] for name in named] == [f"{step:,} steps" for step in steps]


# --- what Python computes -------------------------------------------------------------------------


@contextlib.contextmanager
def served(*words: str) -> Iterator[str]:
    """Address of a page that a process serves, which ends quietly."""
    command = [sys.executable, "-m", "reachlab", "view", *words, "--port", "21000"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        line = process.stdout.readline()
        assert line.startswith(f"Page: http://{LOCAL}:")
        try:
            yield line.split()[1]
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=30)
        assert process.returncode == 0


@pytest.fixture
def asking(browser: Browser) -> Iterator[Page]:
    """A page that asks nobody but its own server."""
    with opened(browser, *SIZES[0]) as page:
        seen = traffic(page)
        yield page
        assert all(url.startswith((f"http://{LOCAL}:", "data:", "blob:")) for url in seen.requests)


def streamed(page: Page, url: str) -> None:
    page.goto(url)
    page.wait_for_function("window.reachlab && reachlab.moment()", timeout=60_000)


def test_a_page_that_is_served_computes_what_it_can(asking: Page, precise: Path) -> None:
    with served(str(precise)) as url:
        seen = traffic(asking)
        streamed(asking, url)
        wait_until(lambda: moment(asking)["steps"] > 20, "steps")
        assert not [one for one in seen.requests if one.endswith("/play")]
        file = precise / "page.html"
        wait_until(file.exists, "the page as a file")
    assert "connect-src" not in file.read_text(encoding="utf-8")


AT_REST = "(player => !player.waits && !player.asked.steps)(reachlab.live.player)"
"""Whether all steps that a streamed arm was asked for have been told to the page."""


@pytest.mark.skipif(find_spec("pybullet") is None, reason="needs the extra pybullet")
def test_an_arm_in_pybullet_is_streamed_and_follows_the_mouse(asking: Page, tutorial: Path) -> None:
    with served(str(tutorial), "--sim", "pybullet", "--agent", "ik") as url:
        streamed(asking, url)
        asking.get_by_label("Endless").check()
        arrived(asking)
        before = moment(asking)
        asking.mouse.move(before["x"], before["y"])
        asking.mouse.down()
        asking.mouse.move(before["x"] + DRAGGED, before["y"], steps=5)
        wait_until(lambda: apart(moment(asking)["goal"], before["goal"]) > 0.03, "the goal's move")
        arrived(asking)
        asking.mouse.up()
        assert apart(moment(asking)["tool"], moment(asking)["goal"]) < 0.1
        asking.get_by_role("button", name="Pause").click()
        wait_until(lambda: asking.evaluate(AT_REST), "the pause")
        steps = asking.evaluate("reachlab.live.player.steps")
        asking.get_by_role("button", name="Step").click()
        wait_until(lambda: asking.evaluate("reachlab.live.player.steps") == steps + 1, "a step")
        asking.get_by_text("Joints", exact=True).click()
        joint = asking.evaluate("reachlab.live.player.episode.state.q[0]")
        asking.get_by_role("button", name="Continue").click()
        asking.locator("#joints .slider input").first.fill(str(joint + 0.5))
        wait_until(
            lambda: abs(asking.evaluate("reachlab.live.player.episode.state.q[0]") - joint - 0.5) < 0.02, "the joint"
        )
    wait_until(lambda: "has ended" in asking.inner_text("#problem"), "the end is said")


OBSERVED = """(() => {
    const image = document.getElementById("picture"), canvas = document.createElement("canvas");
    if (!image.complete || !image.naturalWidth) return null;
    [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
    const context = canvas.getContext("2d");
    context.drawImage(image, 0, 0);
    const bytes = context.getImageData(0, 0, canvas.width, canvas.height).data;
    return Array.from(bytes).filter((_, i) => i % 4 === 0);
})()"""
"""Greys of the picture that the panel shows, row by row; null while there is none."""


@pytest.fixture(scope="module")
def pictures(folder: Path) -> Path:
    return unlearnt(configure("tutorial", observation="image", num_envs=8, hidden=(8,)), folder / "pictures")


def test_the_picture_that_a_policy_observes_is_shown(asking: Page, pictures: Path) -> None:
    with served(str(pictures), "--agent", "ik") as url:
        streamed(asking, url)
        wait_until(lambda: asking.evaluate(OBSERVED) is not None, "a picture")
        first = asking.evaluate(OBSERVED)
        assert len(first) == SIZE**2
        assert len(set(first)) > 5
        wait_until(lambda: asking.evaluate(OBSERVED) not in (None, first), "another picture")


def test_what_cannot_be_computed_is_recorded_in_a_file(
    page: Page, folder: Path, pictures: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, out = str(pictures), folder / "recorded.html"
    assert cli.main(["view", run, "panda/push", "--agent", "ik", "--episodes", "3", "--out", str(out)]) == cli.DONE
    assert "pictures is recorded for the page, 3 episodes" in capsys.readouterr().err
    open_live(page, out)
    expect(page.locator("#hint")).to_have_text("Drag to turn the view.")
    page.get_by_role("button", name="max").click()
    wait_until(lambda: page.evaluate("reachlab.live.player.number") == 2, "the third episode")
    assert page.locator("#picture").is_visible()
    before = moment(page)
    page.mouse.move(before["x"], before["y"])
    page.mouse.down()
    page.mouse.move(before["x"] + DRAGGED, before["y"])
    page.mouse.up()
    assert not page.locator("#joints").is_visible()
    page.locator("#policy").select_option(index=1)
    page.wait_for_function("reachlab.live.shown.facts.task === 'push' && reachlab.moment().reached")
    assert page.locator("#joints").is_visible()


def test_a_policy_in_onnx_is_recorded_as_one_of_another_library(
    page: Page, folder: Path, precise: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exported, out = folder / "exported", folder / "onnx.html"
    assert cli.main(["export", str(precise), "--out", str(exported)]) == cli.DONE
    assert cli.main(["view", str(exported), "--episodes", "1", "--out", str(out)]) == cli.DONE
    assert (
        "exported is recorded for the page, 1 episode: the page computes no policy of another"
        in capsys.readouterr().err
    )
    open_live(page, out)
    page.wait_for_function("reachlab.moment().over")
    assert page.evaluate("reachlab.live.panel.agent") == "trained"
    assert page.get_by_role("radio", name="trained", exact=True).or_(page.get_by_text("trained", exact=True)).count()


def test_the_page_is_small_whole_and_keeps_the_licence(both: Path) -> None:
    text = both.read_text(encoding="utf-8")
    assert len(text.encode()) < 5e6
    assert "The MIT License" in text
    assert "Copyright © 2010-2026 three.js authors" in text
    assert "MuJoCo 3.14.0" in text
    assert "Apache License" in text
    assert "{{" not in text.split("<script>")[0]
    assert not [tag for tag in ("<script src", '<link rel="stylesheet', "@import") if tag in text]
