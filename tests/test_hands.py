"""Tasks in which a hand grips, lets go or strikes: their scripts, what a command drives, and how firmly is held."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mounted import mounted
from params import tried
from reachlab.agents.acting import make_act
from reachlab.control.bodies import Shape
from reachlab.control.situation import up_to_date
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.given_goal import goal_at, make_place
from reachlab.envs.gymnasium_goal import ReachGoalVectorEnv
from reachlab.envs.gymnasium_vector import ReachVectorEnv
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.envs.setup import configure_env
from reachlab.evaluation.handled import begin_handling
from reachlab.robots.loading import load_robot
from reachlab.settings.validation import InputError
from reachlab.tasks.handling import SHAPES, Handling
from reachlab.tasks.out_of_reach import SPREAD
from reachlab.tasks.slide import Slide
from reachlab.tasks.tabletop import reach_on_table, working_box
from reachlab.tasks.walls import LET_GO

EPISODES = 128

LEAST = {"lift": 0.97, "place": 0.96, "slide": 0.87}
"""Least share of successes of each script, nominal."""


def played(task: str, robot: str = "panda", **settings: Any) -> tuple[Env, EnvState, EnvState, np.ndarray]:
    """An environment, its states at the start and after the script's episodes, and which were successes."""
    env = Env(configure(task, robot=robot, **{"randomise": (), **settings}), EPISODES)
    start = state = env.init(episode_keys(3, REPORT_STREAM, 0, EPISODES))
    act, key, success = env.compile_whole(make_act(env, "ik")), jax.random.key(0), np.zeros(EPISODES, bool)
    for _ in range(env.config.rules.max_steps):
        state, transition, key = act(None, state, key)
        success = np.asarray(transition.terms["success"])
    return env, start, state, success


@pytest.mark.parametrize("task", LEAST)
@pytest.mark.parametrize("robot", tried(["panda", "ur5e"], ["panda"]))
def test_scripts_do_what_is_asked(task: str, robot: str) -> None:
    env, start, state, success = played(task, robot)
    assert success.mean() >= LEAST[task] - 0.15 * (robot != "panda")
    moved = np.linalg.norm(np.asarray(state.arm.bodies.position - start.arm.bodies.position)[:, -1], axis=1)
    assert (moved[success] > 0.03).all(), "no episode is solved before it begins"
    if task == "place":
        away = np.linalg.norm(
            np.asarray(state.arm.bodies.position)[:, -1] - np.asarray(state.arm.tool_position), axis=1
        )
        assert (away[success] > LET_GO).all()
    if task == "slide":
        far = np.linalg.norm(np.asarray(state.goal.position)[:, :2], axis=1)
        assert far.min() >= reach_on_table(env.setup.robot) + Slide.beyond[0] - 1e-5


def test_a_report_says_which_objects_were_left_alone_and_which_were_dropped() -> None:
    env = Env(configure("lift", robot="panda", randomise=()), 4)
    state = env.init(episode_keys(1, REPORT_STREAM, 0, 4))
    handled = begin_handling(state.arm, env.setup)
    assert handled is not None
    assert handled.shares() == {"untouched": 1.0, "dropped": 0.0}
    act, key = make_act(env, "ik"), jax.random.key(0)
    for _ in range(60):
        state, _, key = act(None, state, key)
        handled = handled.after(state.arm, env.setup)
    raised = np.asarray(state.arm.bodies.position[:, -1, 2]) > 0.07
    assert raised.any()
    assert handled.shares() == {"untouched": 0.0, "dropped": 0.0}
    moved, command = state.arm, state.command.at[:, -1].set(1.0)  # the hand opens, and stays where it is
    for _ in range(20):
        moved = env.simulator.step(moved, command)
        fallen = replace(state.arm, bodies=moved.bodies)
        handled = handled.after(fallen, env.setup)
    assert (np.asarray(handled.dropped) >= raised).all()
    assert begin_handling(state.arm, Env(configure("precise"), 1).setup) is None


@pytest.mark.parametrize("task", ["push", "lift", "place"])
def test_scripts_do_it_with_arms_that_differ(task: str) -> None:
    """Friction holds a hand that has little left to go, and one that is led by where it is creeps under a payload."""
    *_, success = played(task, randomise=("dynamics",))
    assert success.mean() >= 0.98


def test_a_puck_is_struck_where_joints_are_measured_late() -> None:
    *_, success = played("slide", randomise=("delay",))
    assert success.mean() >= 0.65


def test_a_controller_knows_where_joints_have_come_to_since_they_were_measured() -> None:
    env = Env(configure("track", robot="panda", randomise=("delay",)), EPISODES)
    state, act, key = env.init(episode_keys(3, REPORT_STREAM, 0, EPISODES)), make_act(env, "ik"), jax.random.key(0)
    for _ in range(40):
        state, _, key = act(None, state, key)
    now = env.situation(state)
    off, measured = (
        np.linalg.norm(np.asarray(one.tool_position - state.arm.tool.position), axis=1)
        for one in (up_to_date(env.setup, now), now)
    )
    assert np.median(off) < 0.35 * np.median(measured), "the target goes on meanwhile"
    assert env.setup.late == pytest.approx(0.025), "a control period of 20 ms, and up to 10 ms more"


def test_joints_without_lag_are_where_they_were_commanded() -> None:
    *_, success = played("precise", sim="kinematic", randomise=("delay",))
    assert success.all()


def test_a_puck_is_drawn_round_and_its_goal_is_in_the_picture() -> None:
    env = Env(configure("slide", robot="panda", randomise=()), EPISODES)
    state = env.init(episode_keys(0, REPORT_STREAM, 0, EPISODES))
    (puck,) = env.shown.blocks(state)
    radius = env.setup.rules.object_size
    assert puck.kind == Shape.CYLINDER
    assert puck.size[:2] == pytest.approx([radius, radius / 3])
    farthest = int(np.linalg.norm(np.asarray(state.goal.position), axis=1).argmax())
    red, green, blue = env.render(state, farthest).astype(int).transpose(2, 0, 1)
    assert ((red > 120) & (green < 60) & (blue < 70)).sum() > 30


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "place", "yaw"), [("place", "0 0.5 0", 0.0), ("place", "0 0 0", np.pi / 2), ("slide", "0.2 0 0", np.pi)]
)
def test_arms_that_stand_elsewhere_or_face_another_way_do_it_too(
    task: str, place: str, yaw: float, tmp_path: Path
) -> None:
    env, start, _, success = played(task, mounted(tmp_path, place, yaw))
    assert env.setup.robot.front == pytest.approx(yaw)
    low, high = env.setup.task.goal_box(env.setup)
    goals = np.asarray(start.goal.position)
    assert ((goals >= low - 1e-5) & (goals <= high + 1e-5)).all()
    assert success.mean() >= LEAST[task] - 0.05


@pytest.mark.parametrize("task", ["push", "lift", "place"])
def test_objects_begin_apart_from_their_goals_and_from_the_wall_on_a_small_table_too(task: str) -> None:
    env = Env(configure(task, robot="so101", randomise=("objects",), object_size=0.015), 512)
    state = env.init(episode_keys(0, REPORT_STREAM, 0, 512))
    bodies, goals = state.arm.bodies, np.asarray(state.goal.position)
    middle, half = np.asarray(bodies.position)[:, -1], np.asarray(bodies.extent)[:, -1]
    assert np.linalg.norm(middle - goals, axis=1).min() > env.setup.rules.success_distance + 0.01
    if task == "place":
        wall, thick = np.asarray(bodies.position)[:, 0, 1], np.asarray(bodies.extent)[:, 0, 1]
        assert (np.abs(middle[:, 1] - wall) > thick + np.sqrt(2) * half[:, 0]).all()
        assert (np.abs(goals[:, 1] - wall) > thick + half[:, 0]).all()
        assert ((middle[:, 1] < wall) != (goals[:, 1] < wall)).all()


def test_a_wall_that_leaves_no_room_for_an_object_is_refused() -> None:
    with pytest.raises(InputError, match=r"an object has to be 59 mm from the wall, and the hand of 'so101' works in"):
        Env(configure("place", robot="so101", object_size=0.03), 1)


def test_a_goal_that_is_given_is_where_it_was_asked_for_or_refused() -> None:
    env = Env(configure("lift", robot="panda", randomise=("objects",)), 1)
    setup, place = env.setup, make_place(env.setup)
    low, high = setup.task.goal_box(setup)
    asked = (low + high) / 2
    for key in episode_keys(0, REPORT_STREAM, 0, 4):
        goal = env.functions.sample_episode(key[None], goal_at(setup, asked, place)).goal
        np.testing.assert_allclose(np.asarray(goal.position)[0], asked, atol=1e-6)
    behind = Env(configure("place", robot="panda"), 1).setup
    low, high = behind.task.goal_box(behind)
    with pytest.raises(InputError, match=r"the task asks for nothing at target .+: the nearest is"):
        goal_at(behind, (low + high) / 2, make_place(behind))


def test_a_goal_that_is_moved_is_as_high_as_its_object() -> None:
    env = Env(configure("place", robot="panda", randomise=("objects",)), 16)
    goals = env.init(episode_keys(0, REPORT_STREAM, 0, 16)).goal
    place, home = make_place(env.setup), np.array(env.setup.robot.home)
    for i in range(16):
        before = jax.tree.map(lambda part, i=i: part[i : i + 1], goals)
        nominal = np.asarray(before.position)[0].copy()
        nominal[2] = env.setup.task.goal_box(env.setup)[0][2]
        after, found = place(before, nominal, np.zeros(0), home)
        assert found
        np.testing.assert_allclose(np.asarray(after.position), np.asarray(before.position), atol=1e-6)


@pytest.mark.parametrize("task", tried(["lift", "push", "place"], ["lift"]))
def test_scripts_do_what_is_asked_within_the_limits_of_a_controller_too(task: str) -> None:
    assert played(task, shaping=True, max_steps={"lift": 150, "push": 300, "place": 400}[task])[-1].mean() >= 0.95


def test_what_varies_is_held_too() -> None:
    assert played("lift", randomise=("objects",))[-1].mean() >= 0.96


@pytest.mark.parametrize("shape", ["cylinder", "ball"])
def test_other_shapes_are_gripped(shape: str) -> None:
    assert shape in SHAPES
    assert played("lift", object_shape=shape)[-1].mean() >= 0.9


def test_what_rolls_or_is_too_low_is_not_pushed() -> None:
    for task, shape, sentence in (
        ("push", "ball", "a ball that is pushed rolls on"),
        ("push", "puck", "a puck is too low to be pushed by these fingers"),
        ("slide", "ball", "a ball that is struck rolls on"),
    ):
        with pytest.raises(InputError, match=sentence):
            configure_env(task, object_shape=shape)
    with pytest.raises(InputError, match=r"a puck of object_size 0.02 is too low to be struck: choose at least 0.025"):
        configure_env("slide", object_size=0.02)
    configure_env("slide", object_shape="cylinder", object_size=0.02)


def test_a_ball_that_rolls_comes_to_rest() -> None:
    """Friction against rolling, 1 mm of the weight: 0.2 m/s end after 0.7 v² r / (g · 1 mm), some 6 cm."""
    env = Env(configure("lift", robot="panda", object_shape="ball", randomise=()), 1)
    state = env.init(episode_keys(3, REPORT_STREAM, 0, 1))
    bodies = state.arm.bodies
    begun = np.asarray(bodies.position)[0, -1]
    rolling = jnp.array([0.2, 0.0, 0.0, 0.0, 0.2 / float(bodies.extent[0, -1, 2]), 0.0])
    state = env.rearrange(state, replace(bodies, velocity=jnp.asarray(bodies.velocity).at[0, -1].set(rolling)))
    for _ in range(60):
        state, _ = env.step(state, np.zeros((1, len(env.action_bounds[0])), np.float32), instead=state.command)
    moved, last = np.asarray(state.arm.bodies.position)[0, -1] - begun, np.asarray(state.arm.bodies.velocity)[0, -1]
    assert 0.03 < moved[0] < 0.09
    assert abs(last[0]) < 0.01


def test_what_place_asks_for_is_told() -> None:
    setup = Env(configure("place", robot="panda"), 1).setup
    assert setup.task.succeeds(setup.rules, setup.period).endswith(
        f"no joint faster than 0.05 rad/s, with the hand {1000 * LET_GO:g} mm away"
    )


def test_smaller_objects_on_the_table_are_in_the_observation_space() -> None:
    envs = ReachVectorEnv(num_envs=64, task="lift", robot="panda", randomise=("objects",))
    observations, _ = envs.reset(seed=0)
    assert envs.observation_space.contains(observations)
    envs.close()


@pytest.mark.parametrize("randomise", [("objects",), ("sight",)])
def test_rewards_of_goals_are_of_where_an_object_truly_is(randomise: tuple[str, ...]) -> None:
    settings = {"task": "push", "robot": "panda", "observation": "goal+state", "reward": "goal_distance"}
    envs = ReachGoalVectorEnv(num_envs=8, randomise=randomise, **settings)
    envs.reset(seed=0)
    for _ in range(20):
        observation, rewards, _, _, info = envs.step(envs.action_space.sample())
        again = envs.compute_reward(observation["achieved_goal"], observation["desired_goal"], info)
        np.testing.assert_allclose(rewards, again, atol=1e-6)
    envs.close()


def test_collisions_that_have_no_effect_are_refused() -> None:
    for task in ("push", "clutter"):
        with pytest.raises(InputError, match="collisions has no effect beside other bodies"):
            configure_env(task, collisions=True)


def test_steps_of_the_engine_are_short_enough_for_contact() -> None:
    with pytest.raises(
        InputError,
        match=r"of 20 ms are too long for objects: with control_period 0.02, physics_steps must be at least 4",
    ):
        Env(configure("push", physics_steps=1), 1)
    Env(configure("push", physics_steps=4), 1)
    with pytest.raises(InputError, match="gripper 'hand' is not one of: own, parallel"):
        Env(configure("lift", gripper="hand"), 1)


def test_a_command_drives_the_fingers_together_and_no_faster_than_they_are() -> None:
    env = Env(configure("lift", robot="panda", randomise=()), 2)
    state = env.init(episode_keys(3, REPORT_STREAM, 0, 2))
    gripper = env.setup.robot.gripper
    assert gripper is not None
    assert env.setup.robot.actuators[-1] == "gripper"
    assert np.asarray(state.command).shape == (2, 8)
    np.testing.assert_allclose(np.asarray(state.arm.opening), gripper.widest, atol=1e-3)
    closes = np.zeros((2, 8), np.float32)
    closes[0, -1] = -1.0
    openings = []
    for _ in range(20):
        state, _ = env.step(state, closes, instead=state.command + jnp.asarray(closes) * gripper.speed * 0.02)
        openings.append(np.asarray(state.arm.opening)[:, 0])
    assert openings[-1][0] == pytest.approx(gripper.widest - 20 * 0.02 * gripper.speed, abs=0.004)
    assert openings[-1][1] == pytest.approx(gripper.widest, abs=1e-3)


def test_the_part_of_the_table_is_moved_outward_where_an_arm_needs_it() -> None:
    for name, moves in (("panda", False), ("iiwa14", True)):
        robot = load_robot(name, gripper="parallel")
        low, high = working_box(robot)
        middle = np.mean(robot.workspace, axis=0)[0]
        assert ((low[0] + high[0]) / 2 > middle + 0.01) == moves


def test_friction_of_a_puck_varies_little_and_its_grip_is_that_of_fingers() -> None:
    env = Env(configure("slide", robot="panda", randomise=("objects",)), 1)
    scene = env.setup.task.scene(env.setup)
    assert scene.friction_spread == (1 - SPREAD, 1 + SPREAD)
    assert scene.grip > 5 * scene.friction
    assert Handling.object_friction == 0.6
