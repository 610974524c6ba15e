"""Simulators: continuing from a saved state, independence of each other, and agreement."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.soak import bad_actions, interleavings
from params import tried
from reachlab.control.situation import Goal
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.render.marks import Marks
from reachlab.render.offscreen import Camera
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.loading import load_robot
from reachlab.settings.config import SimConfig
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.sims.mujoco import MujocoSimulator
from reachlab.sims.rendering import Drawn
from reachlab.sims.simulator import make_simulator
from situations import begin

NUM_ENVS = 4


@pytest.mark.compiled
def test_mujoco_continues_from_a_saved_state_bit_for_bit_at_any_thread_count():
    config, robot = configure(sim="mujoco"), load_robot("iiwa14")
    whole = MujocoSimulator(robot, config.physics, NUM_ENVS, threads=1)
    other = MujocoSimulator(robot, config.physics, NUM_ENVS, threads=2)
    home = np.tile(np.array(robot.home, np.float32), (NUM_ENVS, 1))
    commands = home + np.random.default_rng(0).uniform(-0.3, 0.3, (120, *home.shape)).astype(np.float32)
    arm = whole.reset(None, begin(home), None)
    for command in commands[:20]:
        arm = whole.step(arm, command)
    saved = jax.tree.map(np.array, arm)
    for command in commands[20:]:
        arm = whole.step(arm, command)
    other.reset(None, begin(home + 0.1), None)
    again = saved
    for command in commands[20:]:
        again = other.step(again, command)
    assert np.asarray(arm.engine).dtype == np.uint32
    assert np.array_equal(np.asarray(arm.engine), np.asarray(again.engine))
    assert np.array_equal(arm.q, again.q)


@pytest.mark.parametrize("sim", tried(SIMULATORS, ["mujoco"]))
@pytest.mark.compiled
def test_two_environments_in_turns_are_each_as_alone(sim):
    assert interleavings(sim, 3)["value"] == 3


@pytest.mark.parametrize("sim", tried(SIMULATORS, ["mujoco"]))
def test_bad_actions_raise_and_leave_the_state_as_it_was(sim):
    measured = bad_actions(sim, 300, share=0.2)
    assert measured["value"] == 0
    assert measured["config"]["refused"] > 20


def test_pybullet_follows_joint_commands_as_the_kinematic_simulator_does():
    robot, physics = load_robot("iiwa14"), configure().physics
    bullet, kinematic = (make_simulator(name, robot, physics, 2) for name in ("pybullet", "kinematic"))
    q = np.tile(np.array(robot.home, np.float32), (2, 1))
    goal = Goal.at(jnp.array([[0.5, 0.0, -0.0083]] * 2))
    here, there = (sim.reset(None, begin(q, goal), None) for sim in (kinematic, bullet))
    for step in np.random.default_rng(4).uniform(-0.02, 0.02, (100, 2, 7)).astype(np.float32):
        q = q + step
        here, there = kinematic.step(here, q), bullet.step(there, q)
        pose, tool = forward_kinematics(robot.chain, here.q), there.tool
        assert tool is not None
        assert np.abs(np.asarray(pose.position) - tool.position).max() < 1e-4
        assert np.abs(np.abs((np.asarray(pose.quaternion) * tool.quaternion).sum(1)) - 1).max() < 1e-4
    bullet.close()
    bullet.close()


def test_mujoco_arm_follows_its_commands_no_faster_than_its_joints_may():
    env = Env(configure(sim="mujoco", action="joint_delta", joint_scale=1.0), NUM_ENVS)
    state = env.init(env_keys(0, NUM_ENVS))
    speed = np.array(env.setup.robot.speed)
    before = np.asarray(state.command)
    state, _ = env.step(state, np.ones((NUM_ENVS, 7), np.float32))
    assert np.allclose(np.asarray(state.command) - before, speed * env.config.physics.control_period, atol=1e-6)


def test_gravity_pulls_the_mujoco_arm_down_unless_compensated():
    robot = load_robot("iiwa14")
    home = np.array(robot.home, np.float32)[None]
    sag = {}
    for compensated in (False, True):
        physics = configure(sim="mujoco", gravity_compensation=compensated).physics
        simulator = make_simulator("mujoco", robot, physics, 1)
        arm = start = simulator.reset(None, begin(home), None)
        for _ in range(100):
            arm = simulator.step(arm, home)
        sag[compensated] = float(start.tool_position[0, 2] - forward_kinematics(robot.chain, arm.q).position[0, 2])
    assert 0.005 < sag[False] < 0.05
    assert abs(sag[True]) < 1e-4


def measured_lag(robot: str, physics: SimConfig, dynamics: np.ndarray, randomise: tuple[str, ...]) -> np.ndarray:
    """Times `[B, n]` by which joints follow commands that go on evenly, of arms of `dynamics [B, k]` [s]."""
    arm, num_envs, steps = load_robot(robot), len(dynamics), 60
    simulator = make_simulator("mujoco", arm, physics, num_envs, randomise=randomise)
    middle, speed = np.mean([arm.chain.lower, arm.chain.upper], axis=0), 0.1 * np.array(arm.speed)
    ways = middle + speed * physics.control_period * np.arange(steps + 1)[:, None]
    commands = np.tile(ways.astype(np.float32)[:, None], (1, num_envs, 1))
    state = simulator.reset(None, begin(commands[0])._replace(dynamics=dynamics), None)
    for command in commands[1:]:
        state = simulator.step(state, command)
    return (ways[-1] - np.asarray(state.q)) / speed + physics.control_period / 2  # a command is held for a period


@pytest.mark.parametrize("robot", ["iiwa14", "so101"])
@pytest.mark.parametrize("lag", [0.03, 0.2])
def test_mujoco_joints_follow_by_the_lag_that_was_measured(robot: str, lag: float):
    env = Env(configure("precise", robot=robot, servo_lag=lag, gravity_compensation=True, randomise=()), 1)
    assert np.allclose(env.setup.lag, lag)
    assert np.allclose(measured_lag(robot, env.config.physics, np.zeros((1, 0)), ()), lag, atol=0.003)


@pytest.mark.parametrize("robot", ["iiwa14", "so101"])
@pytest.mark.parametrize("others", [(), ("dynamics",)])
def test_mujoco_joints_follow_a_fifth_to_one_and_a_half_times_as_late_where_that_varies(
    robot: str, others: tuple[str, ...]
):
    env = Env(configure("precise", robot=robot, gravity_compensation=True, randomise=(*others, "lag")), 16)
    numbers = 2 * env.setup.robot.chain.n + 1 if others else 0
    drawn = np.asarray(env.functions.sample_episode(env_keys(0, 16)).dynamics)
    assert drawn.shape == (16, numbers + 1)
    assert drawn[:, -1].min() < -0.5
    assert drawn[:, -1].max() > 0.5
    arms = np.zeros((5, numbers + 1), np.float32)
    arms[:, -2:-1] = -1  # no payload
    arms[:, -1] = -1, -0.5, 0, 0.5, 1
    late = measured_lag(robot, env.config.physics, arms, env.config.randomise)
    shares = np.array([0.2, 0.6, 1.0, 1.25, 1.5])[:, None]
    assert np.allclose(late, shares * np.array(env.setup.lag), atol=0.004)


@pytest.mark.parametrize("robot", tried(ROBOTS, ["panda", "so101"]))
def test_arms_that_come_with_it_rest_however_soon_they_follow(robot: str):
    env, arms = Env(configure("precise", robot=robot, randomise=("dynamics", "lag")), 8), 8
    home = np.tile(np.array(env.setup.robot.home, np.float32), (arms, 1))
    dynamics = np.random.default_rng(0).choice([-1.0, 1.0], (arms, 2 * home.shape[1] + 2))
    dynamics[:, -1] = -1  # as soon as any
    state = env.simulator.reset(None, begin(home)._replace(dynamics=dynamics), None)
    away = home + 0.2 * np.sign(np.mean([env.setup.robot.chain.lower, env.setup.robot.chain.upper], axis=0) - home)
    for _ in range(100):
        state = env.simulator.step(state, away.astype(np.float32))
    assert np.abs(np.asarray(state.qd)).max() < 0.02
    soon = Env(configure("precise", robot=robot, randomise=(), servo_lag=0.02), 1)
    assert np.allclose(soon.setup.lag, 0.02)


def test_servos_that_would_swing_are_refused():
    said = r"servos of robot 'iiwa14' that follow by 0.02 s swing in steps of the engine of 20 ms"
    with pytest.raises(InputError, match=said):
        Env(configure("precise", randomise=("lag",), physics_steps=1), 2)


def test_what_varies_of_the_arms_is_drawn_alike_whether_their_lag_varies_or_not():
    envs = [Env(configure("precise", randomise=varied), 3) for varied in (("dynamics",), ("lag", "dynamics"))]
    one, other = (np.asarray(env.functions.sample_episode(env_keys(0, 3)).dynamics) for env in envs)
    assert np.array_equal(one, other[:, :-1])


@pytest.fixture(scope="module")
def env():
    return Env(configure(sim="mujoco"), NUM_ENVS)


def test_mujoco_continues_from_the_state_it_is_given_whichever_it_gave_last(env):
    push = np.full_like(np.asarray((start := env.init(env_keys(0, NUM_ENVS))).last_action), 0.3)
    first, _ = env.step(start, push)
    again, _ = env.step(start, push)
    for one, other in zip(jax.tree.leaves(first.arm), jax.tree.leaves(again.arm), strict=True):
        assert np.array_equal(one, other)
    with pytest.raises(ValueError, match="read-only"):
        np.asarray(again.arm.engine)[:] = 0  # it is compared by identity


def test_mujoco_refuses_to_continue_from_a_broken_state_and_then_continues_from_a_sound_one(env, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the engine leaves its log where it runs
    state = env.init(env_keys(0, NUM_ENVS))
    still = np.zeros_like(np.asarray(state.last_action))
    broken = np.array(state.arm.engine)
    broken.view(np.float64)[2] = np.nan
    with pytest.raises(FloatingPointError, match="BADQPOS in environment 2"):
        env.step(replace(state, arm=replace(state.arm, engine=broken)), still)
    assert np.isfinite(np.asarray(env.step(state, still)[0].arm.q)).all()


def test_one_thread_draws_for_all_simulators(monkeypatch):
    monkeypatch.setattr(Camera, "__init__", lambda *_: None)
    monkeypatch.setattr(Camera, "picture", lambda *_: threading.get_ident())
    robot = load_robot("iiwa14")
    at: Any = SimpleNamespace(q=np.zeros((1, 7)), opening=np.zeros((1, 0)), position=np.zeros((1, 3)))
    threads = {int(Drawn(robot).render(at, at, 0, Marks(0.1))) for _ in range(3)}
    assert len(threads) == 1, "what a thread had taken for its pictures is not given back when it ends"
    assert threads != {threading.get_ident()}
