"""What the observation camera shows, and which pictures are drawn."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict

from reachlab.agents.policy import Policy
from reachlab.control.bodies import Bodies, absent
from reachlab.control.situation import Goal
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState, Transition
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.evaluation import episodes
from reachlab.evaluation.episodes import Episodes
from reachlab.evaluation.report import evaluate
from reachlab.learn.learner import make_initial_policy
from reachlab.learn.rollout import host_collector
from reachlab.learn.train import train
from reachlab.render import offscreen
from reachlab.render.observation_camera import ObservationCamera
from reachlab.render.view_randomisation import SAMPLES, SHIFT, TURN, Views, make_views
from reachlab.robots.loading import load_robot
from reachlab.settings.config import LoopConfig
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.sims.simulator import SimState, make_simulator
from reachlab.tasks.camera import FIELD_OF_VIEW
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.schema import SIZE
from situations import begin

ROBOT = load_robot("iiwa14", "link_7")
HOME = np.array(ROBOT.home)
TARGETS = np.array([[0.3, 0.2, -0.0083], [0.6, -0.2, -0.0083], [0.5, 0.05, -0.0083], [0.65, 0.25, -0.0083]])


def nominal(num_envs: int) -> Views:
    return make_views(np.zeros((num_envs, SAMPLES)), ROBOT)


def arms(q: np.ndarray) -> SimState:
    """Arms with joints `[B, n]` and nothing beside them."""
    still, none = np.zeros((len(q), 7), np.float32), np.zeros((len(q), 0), np.float32)
    state = SimState(
        q=jnp.asarray(q),
        qd=jnp.asarray(still),
        tool_position=jnp.asarray(still[:, :3]),
        tool_quaternion=jnp.asarray(still[:, 3:]),
        bodies=nothing(len(q)),
        contact=jnp.asarray(none, bool),
        opening=jnp.asarray(none),
    )
    return jax.tree.map(np.asarray, state)


def nothing(count: int) -> Bodies:
    """Nothing beside so many arms."""
    return jax.tree.map(np.asarray, absent(count, 0))


def at_home(num_envs: int) -> np.ndarray:
    return np.tile(HOME, (num_envs, 1))


@pytest.fixture(scope="module")
def camera() -> Iterator[ObservationCamera]:
    camera = ObservationCamera(ROBOT, threads=2)
    yield camera
    camera.close()


def pixel(point: np.ndarray, views: Views) -> np.ndarray:
    """Row and column `[2]` of a point `[3]`, by the pinhole's formula."""
    right, up, back = views.rotation[0].T @ (point - views.position[0])
    scale = SIZE / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    return SIZE / 2 + scale * np.array([-up, right]) / -back


def test_pictures_have_defaults_of_their_own() -> None:
    pictured = {name for name, design in OBSERVATIONS.items() if design.pictured}
    usual = configure().loop.action_repeat
    assert {name for name in OBSERVATIONS if configure(observation=name).loop.action_repeat != usual} == pictured


# --- where it stands ------------------------------------------------------------------------------


def test_the_camera_stands_where_the_tutorial_puts_it() -> None:
    views = nominal(1)
    assert views.position[0] == pytest.approx([0.7894, 0.0, 0.7078], abs=1e-4)
    right, up, back = views.rotation[0].T
    assert right == pytest.approx([0, 1, 0])
    assert (up[2], back[2]) == pytest.approx((0.3420, 0.9397), abs=1e-4)
    assert pixel(np.array([0.55, 0.0, 0.05]), views) == pytest.approx([SIZE / 2, SIZE / 2])


def test_random_views_stay_within_2_cm_and_2_degrees_on_each_axis() -> None:
    plain, views = nominal(1), make_views(np.random.default_rng(0).uniform(-1, 1, (1000, SAMPLES)), ROBOT)
    assert np.abs(views.position - plain.position).max() == pytest.approx(SHIFT, rel=0.02)
    turned = np.einsum("bij,kj->bik", views.rotation, plain.rotation[0])
    angles = np.degrees(np.arccos((np.trace(turned, axis1=1, axis2=2) - 1) / 2))
    assert TURN < angles.max() < TURN * 3**0.5
    assert (views.target < views.table).all()


# --- what it shows --------------------------------------------------------------------------------


@pytest.mark.parametrize("sim", SIMULATORS)
def test_the_target_is_shown_where_it_is(sim: str) -> None:
    try:
        simulator = make_simulator(sim, ROBOT, configure(sim=sim).physics, len(TARGETS))
    except InputError as error:
        pytest.skip(str(error))
    q, goal, views = at_home(len(TARGETS)), Goal.at(jnp.asarray(TARGETS)), nominal(len(TARGETS))
    simulator.reset(None, begin(q, goal), None)
    pictures = simulator.render_observations(arms(q), goal, views, np.arange(len(TARGETS)))
    assert pictures.shape == (len(TARGETS), SIZE, SIZE)
    assert pictures.dtype == np.uint8
    empty = np.median(pictures, axis=0)
    for picture, target in zip(pictures, TARGETS, strict=True):
        changed = np.argwhere(empty - picture > 40)
        assert 8 < len(changed) < 80  # of 12 cm by 3 cm, about 1 cm a pixel
        assert changed.mean(axis=0) == pytest.approx(pixel(target, views), abs=2.5)
    simulator.close()


def test_the_arm_is_shown_to_move(camera: ObservationCamera) -> None:
    q = at_home(2)
    q[1, 3] -= 0.4
    one, other = camera.pictures(q, TARGETS[[0, 0]], nothing(2), nominal(2))
    assert (np.abs(one.astype(int) - other) > 20).sum() > 50


def test_obstacles_are_shown_and_move_nothing_else(camera: ObservationCamera) -> None:
    place, views = np.array([0.6, 0.15, 0.05]), nominal(1)
    ball = replace(absent(1, 1, radius=0.04), position=jnp.asarray(place[None, None]))
    without = camera.pictures(at_home(1), TARGETS[1:2], nothing(1), views)
    beside = camera.pictures(at_home(1), TARGETS[1:2], jax.tree.map(np.asarray, ball), views)
    changed = np.argwhere(without[0] != beside[0])
    assert len(changed) > 20
    assert np.linalg.norm(changed - pixel(place, views), axis=1).max() < 8


def test_an_arm_of_many_shapes_hides_neither_goal_nor_bodies(tmp_path: Path) -> None:
    balls = "".join(f'<geom type="sphere" size=".002" pos="0 {0.00005 * i} 0" mass="0"/>' for i in range(600))
    parts = "".join(
        f'<body name="{name}" pos="0 0 .2"><joint name="{name}" axis="{axis}" range="-2 2"/>'
        '<geom type="capsule" size=".03" fromto="0 0 0 0 0 .2" mass="1"/>'
        for name, axis in (("turn", "0 0 1"), ("lift", "0 1 0"), ("bend", "0 1 0"))
    )
    file = tmp_path / "many.xml"
    bodies = f"{parts}{balls}<site name='tool' pos='0 0 .25'/></body></body></body>"
    file.write_text(f"<mujoco><compiler angle='radian'/><worldbody>{bodies}</worldbody></mujoco>")
    robot = load_robot(str(file))
    drawn = ObservationCamera(robot, threads=1)
    q, views = np.array([robot.at_home]), make_views(np.zeros((1, SAMPLES)), robot)
    place = np.mean(robot.workspace, axis=0)[None]
    ball = jax.tree.map(
        np.asarray, replace(absent(1, 1, radius=0.04), position=jnp.asarray(place[:, None] - [0, 0.1, 0]))
    )
    here, aside, beside = (
        drawn.pictures(q, goal, bodies, views)[0].astype(int)
        for goal, bodies in ((place, nothing(1)), (place + np.array([0.0, 0.1, 0.0]), nothing(1)), (place, ball))
    )
    drawn.close()
    assert (np.abs(here - aside) > 20).sum() > 5
    assert (np.abs(here - beside) > 20).sum() > 5


def test_a_picture_depends_on_nothing_but_its_environment(camera: ObservationCamera) -> None:
    q, views = at_home(4), make_views(np.random.default_rng(0).uniform(-1, 1, (4, SAMPLES)), ROBOT)
    together, again = (camera.pictures(q, TARGETS, nothing(4), views) for _ in range(2))
    alone = ObservationCamera(ROBOT, threads=1)
    each = [jax.tree.map(operator.itemgetter(slice(i, i + 1)), (q, TARGETS, nothing(4), views)) for i in range(4)]
    parts = [alone.pictures(*one) for one in each]
    alone.close()
    assert np.array_equal(together, again)
    assert np.array_equal(together, np.concatenate(parts))


@pytest.mark.parametrize("sim", ["mujoco", "pybullet"])
def test_an_object_and_its_place_are_shown_where_they_are(sim: str) -> None:
    config = configure("push", robot="panda", observation="image", action="joint_delta", sim=sim, randomise=())
    env = Env(config, 1)
    state = env.init(env_keys(3, 1))
    here = env.setup.task.goal_box(env.setup)
    middle, aside = jnp.asarray(np.mean(here, axis=0)[None]), jnp.array([[0.0, 0.12, 0.0]])

    def seen(place: jax.Array, goal: jax.Array) -> np.ndarray:
        bodies = replace(state.arm.bodies, position=place[:, None])
        moved = replace(state, arm=replace(state.arm, bodies=bodies), goal=replace(state.goal, position=goal))
        picture = env.render_observation(moved)
        assert picture is not None
        return picture[0].astype(int)

    views = make_views(np.zeros((1, SAMPLES)), env.setup.robot, objects=True)
    both = seen(middle + aside, middle - aside)
    elsewhere = {"object": seen(middle, middle - aside), "goal": seen(middle + aside, middle)}
    under = jnp.array([[0.0, 0.0, env.setup.robot.table_top - middle[0, 2]]])  # a cross lies on the table
    for other, place in zip(elsewhere.values(), (middle + aside, middle - aside + under), strict=True):
        changed = np.argwhere(np.abs(both - other) > 25)
        expected = pixel(np.asarray(place)[0], views)
        near = np.linalg.norm(changed - expected, axis=1) < 10
        assert near.sum() > 8
        assert changed[near].mean(axis=0) == pytest.approx(expected, abs=2.5)
    env.close()


def test_no_environments_are_no_pictures(camera: ObservationCamera) -> None:
    assert camera.pictures(at_home(0), TARGETS[:0], nothing(0), nominal(0)).shape == (0, SIZE, SIZE)


def test_every_episode_has_its_own_view_where_views_are_random() -> None:
    env = Env(configure(observation="image", randomise=("view",)), 3)
    state = env.init(env_keys(0, 3))
    state = replace(state, goal=Goal.at(state.goal.position.at[:].set(state.goal.position[0])))
    pictures = np.asarray(env.observe_now(state))
    assert not np.array_equal(pictures[0], pictures[1])
    assert np.array_equal(pictures, np.asarray(env.observe_now(state)))
    begun = env.reset(state, np.array([False, False, True]))
    again = np.asarray(env.observe_now(replace(begun, goal=state.goal)))
    assert np.array_equal(pictures[:2], again[:2])
    assert not np.array_equal(pictures[2], again[2])
    env.close()


def test_without_opengl_one_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def none(*_: object) -> None:
        raise InputError("pictures need OpenGL (egl), which does not start here. apt install libegl1")

    monkeypatch.setattr(offscreen, "gl_context", none)
    env = Env(configure(observation="image"), 1)
    state = env.init(env_keys(0, 1))
    with pytest.raises(InputError, match="apt install libegl1"):
        env.observe_now(state)
    env.step(state, np.zeros((1, 3), np.float32))  # all else works
    env.close()
    with pytest.raises(InputError, match="apt install libegl1"):
        train(configure(observation="image", num_envs=8), tmp_path / "run")
    assert not (tmp_path / "run").exists()


# --- no frame that nobody uses --------------------------------------------------------------------


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of pictures drawn, call by call."""
    counts: list[int] = []
    draw = ObservationCamera.pictures

    def counted(
        self: ObservationCamera, actuated: np.ndarray, goal: np.ndarray, bodies: Bodies, views: Views
    ) -> np.ndarray:
        counts.append(len(actuated))
        return draw(self, actuated, goal, bodies, views)

    monkeypatch.setattr(ObservationCamera, "pictures", counted)
    return counts


@pytest.fixture
def env() -> Iterator[Env]:
    env = Env(configure(observation="image", max_steps=6), 3)
    yield env
    env.close()


def untrained(env: Env) -> Policy:
    return make_initial_policy(env.config, env, jax.random.key(0))


def test_an_evaluation_draws_each_episode_while_it_lasts(
    env: Env, drawn: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    count = episodes._count

    def sooner(before: Episodes, state: EnvState, transition: Transition, **settings: Any) -> Episodes:
        early = transition.done | (state.clock == 2) & (np.arange(3) == 1)
        return count(before, state, replace(transition, done=early), **settings)

    monkeypatch.setattr(episodes, "_count", sooner)
    report = evaluate(env, "trained", untrained(env), seed=0, episodes=3)
    assert sum(drawn) == 6 + 2 + 6 == report.steps_mean * 3


@pytest.mark.parametrize("agent", ["ik", "random", "zero"])
def test_agents_that_need_no_picture_have_none_drawn(env: Env, drawn: list[int], agent: str) -> None:
    evaluate(env, agent, seed=0, episodes=3)
    assert drawn == []


def test_a_rollout_draws_one_picture_a_step_and_one_for_every_start(env: Env, drawn: list[int]) -> None:
    state = env.init(env_keys(0, 3))
    _, rollout = host_collector()(env, untrained(env), state, jax.random.key(0), LoopConfig(rollout_steps=8))
    assert sum(drawn) == 3 + 8 * 3 + int(np.asarray(rollout.done).sum())
    observed, after, done = (np.asarray(x) for x in (rollout.observation, rollout.next_observation, rollout.done))
    assert done[5].all()
    assert np.array_equal(observed[1:6], after[:5])
    assert not np.array_equal(observed[6], after[5])  # the final observation is kept, the next begins anew


def test_a_repeated_action_costs_one_picture(env: Env, drawn: list[int]) -> None:
    state = env.init(env_keys(0, 3))
    _, rollout = host_collector()(
        env, untrained(env), state, jax.random.key(0), LoopConfig(rollout_steps=5, action_repeat=4)
    )
    assert sum(drawn) == 3 + 5 * 3 + int(np.asarray(rollout.done).sum())
    assert np.asarray(rollout.clock)[0].tolist() == [4, 4, 4]
    assert np.asarray(rollout.done)[1].all()


# --- faces ----------------------------------------------------------------------------------------


def make(observation: str, **settings: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make("reachlab:reachlab/Reach-v0", observation=observation, **settings)


def test_gymnasium_gives_84_by_84_bytes() -> None:
    env = make("image")
    assert env.observation_space == Box(0, 255, (84, 84), np.uint8)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert env.observation_space.contains(env.step(env.action_space.sample())[0])
    env.close()


def test_gymnasium_gives_picture_and_tool_as_a_dict() -> None:
    env = make("image+tool")
    assert isinstance(env.observation_space, Dict)
    observation, info = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert observation["tool"] == pytest.approx([0.5321, -0.0011, 0.4963], abs=1e-3)
    assert info["distance"] > 0.4
    env.close()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_environments_of_a_batch_observe_what_single_ones_observe(mode: str) -> None:
    settings: dict[str, Any] = {"observation": "image+tool", "max_steps": 2}
    batch = gymnasium.make_vec("reachlab:reachlab/Reach-v0", num_envs=2, autoreset_mode=mode, **settings)
    single = make(**settings)
    together, _ = batch.reset(seed=3)
    alone, _ = single.reset(seed=4)
    assert np.array_equal(together["image"][1], alone["image"])
    info: dict[str, Any] = {}
    truncated = np.zeros(2, bool)
    for _ in range(2):
        together, _, _, truncated, info = batch.step(np.zeros((2, 3), np.float32))
        alone, *_ = single.step(np.zeros(3, np.float32))
    assert truncated.all()
    final = info["final_obs"][1] if mode == "SameStep" else {name: part[1] for name, part in together.items()}
    assert np.array_equal(final["image"], alone["image"])
    for env in (batch, single):
        env.close()
