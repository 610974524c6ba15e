"""The precise task: what counts as held, where episodes start, and arms that differ."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.config import configure
from reachlab.env import Env, EnvState, lane_keys
from reachlab.evaluation import Report, evaluate
from reachlab.kinematics import forward_kinematics
from reachlab.task import Situation, judge, nothing_held, remember

LANES = 40
HOLD = 10


@pytest.fixture(scope="module")
def env() -> Env:
    return Env(configure("precise"), LANES)


def situation(distance: float, speed: float = 0.0) -> Situation:
    joints, target = jnp.zeros((1, 7)), jnp.array([[0.5, 0.0, 0.3]])
    tool = target + jnp.array([distance, 0.0, 0.0])
    return Situation(joints, joints.at[0, 4].set(speed), tool, target, joints, joints)


def held_after(env: Env, steps: list[Situation]) -> tuple[float, bool]:
    recent = nothing_held(env.reach, 1)
    for now in steps:
        recent = remember(env.reach, recent, now)
    outcome = judge(env.reach, jnp.array([0.5]), recent, steps[-1], jnp.array([len(steps)]))
    return float(outcome.held[0]), bool(outcome.success[0])


def test_the_held_error_is_the_largest_of_the_last_steps(env):
    steps = [situation(0.5), situation(0.007)] + [situation(0.002)] * (HOLD - 1)
    assert held_after(env, steps) == (pytest.approx(0.007, abs=1e-6), True)
    assert held_after(env, [*steps, situation(0.002)]) == (pytest.approx(0.002, abs=1e-6), True)
    assert held_after(env, [*steps, situation(0.02)]) == (pytest.approx(0.02, abs=1e-6), False)


def test_nothing_is_held_before_ten_steps_or_while_a_joint_moves(env):
    assert held_after(env, [situation(0.001)] * (HOLD - 1)) == (np.inf, False)
    moving = [situation(0.001)] * 5 + [situation(0.001, speed=0.06)] + [situation(0.001)] * 9
    assert held_after(env, moving) == (np.inf, False)
    assert held_after(env, [*moving, situation(0.001)])[1]


def test_starts_lie_about_home_and_targets_in_the_box_independently(env):
    state = env.init(lane_keys(0, 400)[:LANES])
    spread = np.asarray(state.arm.q) - np.array(env.reach.robot.home)
    assert np.abs(spread).max() <= 0.3 + 1e-6
    assert (np.ptp(spread, axis=0) > 0.4).all()
    low, high = np.array(env.config.rules.target_low), np.array(env.config.rules.target_high)
    target = np.asarray(state.target)
    assert ((target >= low - 1e-6) & (target <= high + 1e-6)).all()
    assert (np.ptp(target, axis=0) > 0.7 * (high - low)).all()
    assert np.abs(np.corrcoef(spread.T, target.T)[:7, 7:]).max() < 0.6


def test_an_episode_lasts_two_seconds_whatever_happens(env):
    state = env.init(lane_keys(0, LANES))
    still = np.zeros((LANES, 7), np.float32)
    for step in range(1, 101):
        state, transition = env.step(state, still)
        assert bool(np.asarray(transition.truncated).all()) == (step == 100)
        assert not np.asarray(transition.terminated).any()


@pytest.fixture(scope="module")
def reports(env: Env) -> dict[str, Report]:
    return {agent: evaluate(env, agent, seed=3, episodes=LANES) for agent in ("ik", "ik_open")}


def test_a_closed_loop_beats_gravity_and_a_solution_solved_once_does_not(reports):
    closed, once = (reports[agent].success_within or {} for agent in ("ik", "ik_open"))
    assert closed["2"] >= 0.95
    assert once["5"] <= 0.1
    assert once["50"] >= 0.95


def test_no_joint_goes_faster_than_it_may(env, reports):
    assert (np.array(reports["ik"].max_joint_speed) <= np.array(env.reach.robot.speed)).all()


# --- arms that differ -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def perturbed() -> Env:
    return Env(configure("precise", randomise=True), LANES)


def settled(env: Env, state: EnvState) -> EnvState:
    for _ in range(60):
        state, _ = env.step(state, np.zeros((LANES, 7), np.float32))
    return state


def test_every_episode_has_an_arm_of_its_own_which_a_saved_state_keeps(env, perturbed):
    begun = perturbed.init(lane_keys(0, LANES))
    sag = np.asarray(settled(perturbed, begun).arm.q - begun.target_q)
    usual = settled(env, env.init(lane_keys(0, LANES)))
    ratio = sag[:, 1] / np.asarray(usual.arm.q - usual.target_q)[:, 1]
    assert np.ptp(ratio) > 0.2
    saved = jax.tree.map(np.array, begun.arm)
    other = perturbed.reset(begun, np.ones(LANES, bool))
    assert not np.allclose(np.asarray(settled(perturbed, other).arm.q - other.target_q), sag)
    again = settled(perturbed, replace(begun, arm=saved))
    assert np.array_equal(np.asarray(again.arm.q - begun.target_q), sag)


def test_measurements_are_noisy_and_the_score_is_not(perturbed):
    state = perturbed.init(lane_keys(0, LANES))
    now = perturbed.situation(state)
    noise = np.asarray(now.q - state.arm.q)
    assert noise.std() == pytest.approx(5e-4, rel=0.2)
    assert np.asarray(now.qd - state.arm.qd).std() == pytest.approx(0.01, rel=0.2)
    measured = forward_kinematics(perturbed.reach.robot.chain, now.q).position
    assert np.allclose(now.tool_position, measured, atol=1e-6)
    state, transition = perturbed.step(state, np.zeros((LANES, 7), np.float32))
    true = np.linalg.norm(np.asarray(state.arm.tool_position) - np.asarray(state.target), axis=1)
    assert np.allclose(transition.terms["distance"], true, atol=1e-6)
