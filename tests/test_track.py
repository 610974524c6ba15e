"""Goals that move: their paths, what is judged and reported of following them, checked against NumPy's own figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.envs.core import Env
from reachlab.envs.gymnasium_goal import ReachGoalVectorEnv
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, env_keys
from reachlab.envs.setup import make_setup
from reachlab.evaluation.episodes import Track, make_runner, run_episodes
from reachlab.evaluation.report import evaluate
from reachlab.evaluation.tracking import followed
from reachlab.jax_setup import jit
from reachlab.tasks.paths import PATHS, STAY, Place, place_at, sample_path
from reachlab.tasks.task import TaskSetup

COUNT, STEPS, PERIOD = 300, 250, 0.02
SPEED = 0.2
"""Of goals along paths [m/s]."""


# --- paths ----------------------------------------------------------------------------------------


def sampled(setup: TaskSetup, count: int = COUNT) -> Callable[[np.ndarray], Place]:
    """Places `[T, B, 3]` of random paths at so many steps `[T]`, which need not be whole."""
    keys = jax.random.split(jax.random.key(5), count)
    paths = jit(jax.vmap(lambda key: sample_path(setup, key)))(keys)
    at = jit(jax.vmap(lambda clock: place_at(setup, paths, jnp.full(count, clock))))
    return lambda clocks: jax.tree.map(lambda x: np.asarray(x, float), at(clocks.astype(np.float32)))


@pytest.fixture(scope="module", params=PATHS)
def path(request: pytest.FixtureRequest) -> tuple[str, TaskSetup, Callable[[np.ndarray], Place]]:
    setup = make_setup(configure("track", goal_paths=(request.param,), goal_speed=(SPEED, SPEED)))
    return request.param, setup, sampled(setup)


Path = tuple[str, TaskSetup, Callable[[np.ndarray], Place]]


def test_goals_stay_in_their_box(path: Path) -> None:
    _, setup, at = path
    low, high = setup.task.goal_box(setup)
    position = at(np.arange(STEPS + 1)).position
    assert (position >= low - 1e-6).all()
    assert (position <= high + 1e-6).all()
    assert (np.ptp(position, axis=(0, 1)) > 0.8 * (high - low)).all()


def test_the_velocity_is_the_derivative_of_the_position(path: Path) -> None:
    _, _, at = path
    step = 0.25
    clocks = np.arange(1, STEPS, 3) + 0.37
    before, now, after = (at(clocks + shift) for shift in (-step, 0.0, step))
    slope = (after.position - before.position) / (2 * step * PERIOD)
    even = np.linalg.norm(after.velocity - before.velocity, axis=-1) < 0.05  # no corner and no jump in between
    even &= np.linalg.norm(after.position - before.position, axis=-1) < 0.1
    assert even.mean() > 0.95
    assert now.velocity[even] == pytest.approx(slope[even], abs=2e-3)


def test_goals_are_as_fast_as_was_asked(path: Path) -> None:
    name, _, at = path
    speed = np.linalg.norm(at(np.arange(STEPS + 1)).velocity, axis=-1)
    if name == "jumps":
        assert not speed.any()
    elif name == "smooth":
        assert speed.mean() == pytest.approx(SPEED, rel=0.02)
        assert 0.5 * SPEED < speed.mean(axis=0).min() < speed.mean(axis=0).max() < 1.5 * SPEED
        assert speed.max() < 5 * SPEED, "the bound of the observation"
    else:
        assert speed == pytest.approx(SPEED, rel=1e-5)


def test_jumps_are_as_long_as_was_asked_and_come_in_time() -> None:
    setup = make_setup(configure("track", goal_paths=("jumps",), goal_jump=0.25))
    ways = np.linalg.norm(np.diff(sampled(setup)(np.arange(STEPS + 1)).position, axis=0), axis=-1)
    jumped = ways > 0
    assert ways[jumped] == pytest.approx(0.25, abs=1e-5)
    assert (np.flatnonzero(jumped.any(axis=1)) + 1).tolist() == [round(i * STAY / PERIOD) for i in (1, 2, 3)]
    assert jumped.any(axis=1).sum() * COUNT == jumped.sum()


def test_a_jump_too_long_for_the_box_stays_inside_it() -> None:
    setup = make_setup(configure("track", goal_paths=("jumps",), goal_jump=3.0))
    low, high = setup.task.goal_box(setup)
    position = sampled(setup)(np.arange(STEPS + 1)).position
    assert ((position >= low - 1e-6) & (position <= high + 1e-6)).all()
    assert position == pytest.approx(sampled(setup)(np.arange(STEPS + 1)).position)


def test_every_path_and_speed_that_was_named_occurs_and_no_other() -> None:
    setup = make_setup(configure("track", goal_paths=("circle", "jumps"), goal_speed=(0.1, 0.15)))
    speed = np.linalg.norm(sampled(setup)(np.array([10.0])).velocity[0], axis=-1)
    still = speed == 0
    assert 0.4 < still.mean() < 0.6
    assert 0.1 <= speed[~still].min() < 0.105
    assert 0.145 < speed[~still].max() <= 0.15 + 1e-6


# --- what is judged -------------------------------------------------------------------------------

SHORT: dict[str, Any] = {"max_steps": 40, "settle_steps": 10, "randomise": ()}


def test_the_error_is_the_root_mean_square_of_the_steps_that_count() -> None:
    env = Env(configure("track", **SHORT), 4)
    state, distances = env.init(env_keys(0, 4)), []
    actions = np.random.default_rng(0).uniform(-1, 1, (40, 4, 7)).astype(np.float32)
    for number, action in enumerate(actions, start=1):
        state, done = env.step(state, action)
        distances.append(np.linalg.norm(np.asarray(state.arm.tool_position) - np.asarray(state.goal.position), axis=1))
        error = np.asarray(done.counted.distance)
        counted = np.array(distances)[SHORT["settle_steps"] if number > SHORT["settle_steps"] else -1 :]
        truth = np.sqrt(np.square(counted).mean(axis=0))
        assert error == pytest.approx(truth, rel=1e-5)
        assert np.array_equal(done.terms["success"], error < env.setup.rules.success_distance)
        assert np.asarray(done.truncated).all() == (number == 40)
        assert not np.asarray(done.terminated).any()
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("sim", ["kinematic", "mujoco"])
def test_a_report_is_that_of_the_recorded_track(sim: str) -> None:
    env = Env(configure("track", sim=sim, **SHORT), 20)
    played = run_episodes(make_runner(env, "ik"), None, 3, REPORT_STREAM, 30)
    report = evaluate(env, "ik", seed=3, episodes=30)
    track = played.track
    assert track is not None
    assert track.goal.shape == track.velocity.shape == track.tool.shape == (30, 40, 3)
    distance = np.linalg.norm(track.goal - track.tool, axis=-1)[:, SHORT["settle_steps"] :]
    assert played.distance == pytest.approx(np.sqrt(np.square(distance).mean(axis=1)), rel=1e-4)
    assert report.tracking is not None
    assert report.tracking["rms_mm"] == pytest.approx(1000 * np.sqrt(np.square(distance).mean()), rel=1e-4)
    assert report.tracking["p95_mm"] == pytest.approx(1000 * np.quantile(distance, 0.95), rel=1e-4)
    assert report.success_rate == np.mean(played.success)
    env.close()


@pytest.mark.slow
def test_inverse_kinematics_know_the_velocity_only_where_they_may() -> None:
    errors = {}
    for known in (True, False):
        smooth: dict[str, Any] = {"goal_paths": ("smooth",), "goal_speed": (SPEED, SPEED), "goal_velocity": known}
        env = Env(configure("track", randomise=(), **smooth), 20)
        state = env.init(env_keys(0, 20))
        assert np.linalg.norm(np.asarray(state.goal.velocity), axis=1).min() > 0.01
        columns = np.asarray(env.observe(state))[:, -3:]
        wanted = np.asarray(state.goal.velocity) if known else np.zeros((20, 3))
        assert columns == pytest.approx(wanted)
        assert env.schema.fields[-1].constant == (not known,) * 3
        errors[known] = evaluate(env, "ik", seed=1, episodes=20).tracking
        env.close()
    with_it, without = errors[True], errors[False]
    assert with_it is not None
    assert without is not None
    assert with_it["rms_mm"] < 0.5 * without["rms_mm"]
    assert abs(with_it["lag_s"]) < 0.02 < without["lag_s"]


# --- figures of tracks ----------------------------------------------------------------------------


def straight(speed: float, late_s: float, steps: int = 200) -> Track:
    """One goal that moves along x, and a tool that is late by a time."""
    time = np.arange(steps) * PERIOD
    goal, velocity = np.zeros((1, steps, 3)), np.zeros((1, steps, 3))
    goal[0, :, 0], velocity[0, :, 0] = speed * time, speed
    tool = goal.copy()
    tool[0, :, 0] -= speed * late_s
    return Track(goal, velocity, tool)


def test_figures_of_a_tool_that_is_late_are_its_lag() -> None:
    told = followed(straight(0.1, 0.03), PERIOD, 50, 0.2)
    assert told["lag_s"] == pytest.approx(0.03)
    assert [told[f"{name}_mm"] for name in ("rms", "median", "p95")] == pytest.approx([3.0] * 3)
    assert list(told["by_speed"]) == ["0.1 to 0.15"]
    assert told["breaks"] == 0
    assert told["again_within"] == {}


def test_the_root_mean_square_of_noise_is_its_deviation_and_settling_does_not_count() -> None:
    track, random = straight(0.1, 0.0, 4000), np.random.default_rng(0)
    tool = track.tool + random.normal(0, 0.002, track.tool.shape)
    tool[:, :50] += 1.0
    told = followed(track._replace(tool=tool), PERIOD, 50, 0.2)
    assert told["rms_mm"] == pytest.approx(2 * np.sqrt(3), rel=0.03)
    assert told["lag_s"] == pytest.approx(0.0, abs=1e-3)


def test_the_time_to_come_back_is_counted_from_a_jump_to_the_next() -> None:
    goal, tool = np.zeros((1, 400, 3)), np.zeros((1, 400, 3))
    goal[0, 100:200, 1] = goal[0, 300:, 1] = 0.3
    tool[0, 130:200, 1] = 0.296  # within 5 mm 30 steps after the jump
    tool[0, 212:230, 1] = 0.008  # within 10 mm 12 steps after it, and within 5 mm 30 steps after it
    tool[0, 200:212, 1] = 0.1
    track = Track(goal, np.zeros_like(goal), tool)
    told = followed(track, PERIOD, 50, 0.2)
    assert told["breaks"] == 2, "the last one has no end"
    assert told["lag_s"] is None
    assert told["again_within"]["10"] == pytest.approx({"median": 12 * PERIOD, "p99": 30 * PERIOD})
    assert told["again_within"]["5"] == pytest.approx({"median": 30 * PERIOD, "p99": 30 * PERIOD})
    never = followed(track._replace(tool=np.full_like(goal, 1.0)), PERIOD, 50, 0.2)
    assert never["again_within"]["10"] == {"median": None, "p99": None}
    assert followed(track, PERIOD, 150, 0.2)["breaks"] == 1


def test_a_corner_is_a_break_and_a_bend_is_none() -> None:
    time = np.arange(300) * PERIOD
    for fast in (0.2, 1.0):
        turn = fast / 0.1 * time
        circle = 0.1 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)[None]
        round_it = fast * np.stack([-np.sin(turn), np.cos(turn), 0 * turn], -1)[None]
        assert followed(Track(circle, round_it, circle), PERIOD, 0, fast)["breaks"] == 0
        there = np.abs((time * fast + 0.35) % 0.8 - 0.4)
        back = np.where((time * fast + 0.35) % 0.8 < 0.4, -fast, fast)
        line, along = (np.stack([x, 0 * x, 0 * x], -1)[None] for x in (there, back))
        turns = int((np.diff(back) != 0).sum())
        assert followed(Track(line, along, line), PERIOD, 0, fast)["breaks"] == turns - 1


# --- a goal environment ---------------------------------------------------------------------------


def test_rewards_of_a_goal_that_moves_follow_from_goals() -> None:
    settings = {"task": "track", "action": "joint_delta", "tool_scale": None, "max_steps": 30, "settle_steps": 5}
    envs = gymnasium.make_vec("reachlab/ReachGoal-v0", num_envs=4, success_distance=0.3, **settings)
    assert isinstance(envs, ReachGoalVectorEnv)
    observation, _ = envs.reset(seed=0)
    begun, seen = observation["desired_goal"], set()
    for _ in range(29):
        observation, rewards, terminated, truncated, info = envs.step(envs.action_space.sample())
        goals = observation["achieved_goal"], observation["desired_goal"]
        assert np.array_equal(rewards, envs.compute_reward(*goals, info))
        assert np.array_equal(terminated, envs.compute_terminated(*goals, info))
        assert np.array_equal(truncated, envs.compute_truncated(*goals, info))
        seen |= set(rewards.tolist())
    assert seen == {0.0, -1.0}
    assert not np.allclose(observation["desired_goal"], begun)
    envs.close()
