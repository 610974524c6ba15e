"""The precise task: what counts as held, where episodes start, and arms that differ."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from benchmarks import bound as bench_bound
from benchmarks import precise as bench_precise
from benchmarks import trained as bench_trained
from reachlab.agents import AGENTS, AgentEntry
from reachlab.agents.baselines import ik
from reachlab.agents.policy import Policy
from reachlab.bench.table import to_markdown
from reachlab.control.situation import Goal, Situation
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.evaluation.report import Report, evaluate
from reachlab.jax_setup import jit
from reachlab.learn.train import train
from reachlab.robots.kinematics.forward import Pose, forward_kinematics
from reachlab.robots.kinematics.inverse import ik_point_step
from reachlab.runs.directory import RunDirectory
from reachlab.settings.json_form import override
from situations import judged
from situations import situation as situation_of

NUM_ENVS = 40
HOLD = 10


@pytest.fixture(scope="module")
def env() -> Env:
    return Env(configure("precise", randomise=()), NUM_ENVS)


def situation(distance: float, speed: float = 0.0) -> Situation:
    joints, target = jnp.zeros((1, 7)), jnp.array([[0.5, 0.0, 0.3]])
    tool = target + jnp.array([distance, 0.0, 0.0])
    upright = jnp.array([[1.0, 0.0, 0.0, 0.0]])
    return situation_of(joints, joints.at[0, 4].set(speed), Pose(tool, upright), Goal.at(target))


def held_after(env: Env, steps: list[Situation]) -> tuple[float, bool]:
    outcome = judged(env.setup, situation(0.5), steps)[-1]
    return float(outcome.counted.distance[0]), bool(outcome.success[0])


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
    state = env.init(env_keys(0, 400)[:NUM_ENVS])
    spread = np.asarray(state.arm.q) - np.array(env.setup.robot.home)
    assert np.abs(spread).max() <= 0.3 + 1e-6
    assert (np.ptp(spread, axis=0) > 0.4).all()
    low, high = env.setup.task.goal_box(env.setup)
    target = np.asarray(state.goal.position)
    assert ((target >= low - 1e-6) & (target <= high + 1e-6)).all()
    assert (np.ptp(target, axis=0) > 0.7 * (high - low)).all()
    assert np.abs(np.corrcoef(spread.T, target.T)[:7, 7:]).max() < 0.6


def test_every_target_of_the_box_can_be_reached(env):
    chain = env.setup.robot.chain
    axes = [np.linspace(low, high, 7) for low, high in zip(*env.setup.task.goal_box(env.setup), strict=True)]
    targets = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 1, 3).astype(np.float32)
    lower, upper = jnp.array(chain.lower), jnp.array(chain.upper)
    starts = np.random.default_rng(0).uniform(lower, upper, (len(targets), 12, chain.n)).astype(np.float32)
    wanted = jnp.asarray(targets)

    def solve(q: Array) -> Array:
        def closer(_: int, q: Array) -> Array:
            way = wanted - forward_kinematics(chain, q).position
            return q + ik_point_step(chain, q, q, way)

        q = jax.lax.fori_loop(0, 60, closer, q)
        return jnp.linalg.norm(targets - forward_kinematics(chain, q).position, axis=-1)

    assert np.asarray(jit(solve)(starts)).min(axis=1).max() < 1e-4


def test_an_episode_lasts_two_seconds_whatever_happens(env):
    state = env.init(env_keys(0, NUM_ENVS))
    still = np.zeros((NUM_ENVS, 7), np.float32)
    for step in range(1, 101):
        state, transition = env.step(state, still)
        assert bool(np.asarray(transition.truncated).all()) == (step == 100)
        assert not np.asarray(transition.terminated).any()


def test_a_clipped_action_is_the_clipped_one_in_command_observation_and_reward(env):
    state, box = env.init(env_keys(0, NUM_ENVS)), np.ones((NUM_ENVS, 7), np.float32)
    after, expected = env.step(state, box)
    for beyond in (2.0, 1e30):
        clipped, transition = env.step(state, beyond * box)
        assert np.array_equal(clipped.command, after.command)
        assert np.array_equal(transition.observation, expected.observation)
        assert np.array_equal(transition.reward, expected.reward)
    low, high = env.schema.bounds
    assert ((np.asarray(expected.observation) >= low) & (np.asarray(expected.observation) <= high)).all()


@pytest.fixture(scope="module")
def reports(env: Env) -> dict[str, Report]:
    return {agent: evaluate(env, agent, seed=3, episodes=NUM_ENVS) for agent in ("ik", "ik_open")}


def test_a_closed_loop_beats_gravity_and_a_solution_solved_once_does_not(reports):
    closed, once = (reports[agent].success_within or {} for agent in ("ik", "ik_open"))
    assert closed["1"] == 1.0
    assert once["5"] <= 0.1
    assert once["50"] >= 0.95


@pytest.fixture(scope="module")
def plain() -> Env:
    return Env(configure("precise", action="joint_delta", randomise=()), NUM_ENVS)


def test_solving_once_is_the_same_whatever_the_policy_would_command(plain, reports):
    report = evaluate(plain, "ik_open", seed=3, episodes=NUM_ENVS)
    assert report.final_error_mm["median"] == pytest.approx(reports["ik_open"].final_error_mm["median"], rel=1e-3)


def test_no_joint_goes_faster_than_it_may(env, reports):
    assert (np.array(reports["ik"].max_joint_speed) <= np.array(env.setup.robot.speed)).all()


def wander(env: Env, policy: Policy | None, state: EnvState, key: Array, picture: Array | None) -> Array:
    """As inverse kinematics, but away from the target for a while, once it was there."""
    away = (state.clock >= 40) & (state.clock < 50)
    return jnp.where(away[:, None], 1.0, ik(env, policy, state, key, picture))


def test_an_arm_that_comes_and_goes_has_reached_only_when_it_stays(plain):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(AGENTS, "wander", AgentEntry("comes and goes", f"{__name__}:wander"))
        report = evaluate(plain, "wander", seed=3, episodes=NUM_ENVS)
    assert report.success_rate > 0.8
    assert report.time_to_reach_s is not None
    assert 50 * 0.02 < report.time_to_reach_s < 90 * 0.02


# --- arms that differ -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def varied() -> Env:
    return Env(configure("precise", randomise=("dynamics",)), NUM_ENVS)


def settled(env: Env, state: EnvState) -> EnvState:
    for _ in range(60):
        state, _ = env.step(state, np.zeros((NUM_ENVS, 7), np.float32))
    return state


def test_every_episode_has_an_arm_of_its_own_which_a_saved_state_keeps(env, varied):
    begun = varied.init(env_keys(0, NUM_ENVS))
    sag = np.asarray(settled(varied, begun).arm.q - begun.command)
    usual = settled(env, env.init(env_keys(0, NUM_ENVS)))
    ratio = sag[:, 1] / np.asarray(usual.arm.q - usual.command)[:, 1]
    assert np.ptp(ratio) > 0.2
    saved = jax.tree.map(np.array, begun.arm)
    other = varied.reset(begun, np.ones(NUM_ENVS, bool))
    assert not np.allclose(np.asarray(settled(varied, other).arm.q - other.command), sag)
    again = settled(varied, replace(begun, arm=saved))
    assert np.array_equal(np.asarray(again.arm.q - begun.command), sag)


def test_measurements_are_noisy_and_the_score_is_not(varied):
    state = varied.init(env_keys(0, NUM_ENVS))
    now = varied.situation(state)
    noise = np.asarray(now.q - state.arm.q)
    assert noise.std() == pytest.approx(5e-4, rel=0.2)
    assert np.asarray(now.qd - state.arm.qd).std() == pytest.approx(0.01, rel=0.2)
    measured = forward_kinematics(varied.setup.robot.chain, now.q).position
    assert np.allclose(now.tool_position, measured, atol=1e-6)
    state, transition = varied.step(state, np.zeros((NUM_ENVS, 7), np.float32))
    true = np.linalg.norm(np.asarray(state.arm.tool_position) - np.asarray(state.goal.position), axis=1)
    assert np.allclose(transition.errors.distance, true, atol=1e-6)


def test_training_on_arms_that_vary_is_reported_on_nominal_ones(tmp_path):
    settings = {"num_envs": 8, "rollout_steps": 20, "total_steps": 160, "hidden": (8,), "report_episodes": 8}
    result = train(configure("precise", minibatches=2, **settings), tmp_path / "run")
    assert result.report.randomised == []
    assert result.report.success_within is not None
    assert RunDirectory(tmp_path / "run").read_config().randomise == ("dynamics",)


@pytest.mark.slow
def test_the_suite_compares_all_agents_on_nominal_and_perturbed_arms(monkeypatch):
    tiny = configure(
        "precise", num_envs=8, rollout_steps=20, total_steps=160, hidden=(8,), minibatches=2, report_episodes=8
    )
    monkeypatch.setattr(bench_precise, "configure", lambda _, **settings: override(tiny, **settings))
    monkeypatch.setattr(bench_trained, "SEEDS", range(2))
    monkeypatch.setattr(bench_trained, "HELD_OUT", 20)
    monkeypatch.setattr(bench_bound, "EPISODES", 5)
    monkeypatch.setattr(bench_trained, "BATCH", 20)
    rows = list(bench_precise.precise())
    values = {row["name"]: row["value"] for row in rows}
    assert values["held within 2 mm/ik"] > 0.8 > values["held within 2 mm/ik_open"]
    assert "held within 2 mm/trained, perturbed" in values
    assert 0.3 < values["time to reach 10 mm for good/no controller below"] < values["time to reach 10 mm for good/ik"]
    assert {name.partition("/")[2] for name in values} - {"no controller below"} == {
        agent + kind for agent in ("trained", "trained without ik", "ik", "ik_open") for kind in ("", ", perturbed")
    }
    table = to_markdown(rows)
    heading, _, *lines = table.splitlines()
    assert heading.split(" | ")[1:4] == ["trained", "trained without ik", "ik"]
    assert any(line.startswith("| held within 2 mm | ") for line in lines)
    assert "jax" in lines[-1]
    assert "lowest seed" in lines[-1]
