"""Evaluations that anyone can repeat."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binomtest, rankdata

from reachlab.agents import AGENTS, AgentEntry
from reachlab.agents.policy import Policy, make_policy
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import (
    AGENT_STREAM,
    LEARNER_STREAM,
    NOISE_STREAM,
    PARTS,
    REPORT_STREAM,
    TRAINING_STREAM,
    VALIDATION_STREAM,
    VIEW_STREAM,
    env_keys,
    episode_keys,
    step_keys,
    stream_key,
)
from reachlab.evaluation.episodes import BATCH, Episodes, Runner, make_runner, run_episodes
from reachlab.evaluation.intervals import wilson_interval
from reachlab.evaluation.report import Report, evaluate, examine, summarise
from reachlab.settings.validation import InputError

REPORT_FIELDS = """
task robot sim agent seed episodes checkpoint randomised success_rate success_interval success_within
success_within_pairs final_error_mm final_angle_rad tracking return_mean steps_mean time_to_reach_s max_joint_speed jerk
contact self_contact straight planning_s largest_force_n object wall_s versions ends control_period
"""
"""Every field of a report."""


STEPS = 300
"""Longest episode: enough for inverse kinematics, which takes more than 100."""


@pytest.fixture(scope="module")
def env() -> Env:
    return Env(configure(max_steps=STEPS), BATCH)


@pytest.fixture(scope="module")
def init(env: Env) -> Callable[[jax.Array], EnvState]:
    return env.compile_whole(env.init)


@pytest.fixture(scope="module")
def ik(env: Env) -> Runner:
    return make_runner(env, "ik")


@pytest.fixture(scope="module")
def whole(ik: Runner) -> Episodes:
    told: list[int] = []
    episodes = run_episodes(ik, None, 1, REPORT_STREAM, 1500, watch=told.append)
    assert told == [1000, 1500], "the watch is told of all episodes"
    return episodes


@pytest.fixture(scope="module")
def start(init: Callable[[jax.Array], EnvState]) -> np.ndarray:
    """Distances at the start of the first episodes of `whole`."""
    return np.asarray(init(episode_keys(1, REPORT_STREAM, 0, BATCH)).distance)


# --- intervals ------------------------------------------------------------------------------------


@pytest.mark.parametrize("trials", [1, 10, 12_345])
def test_wilson_intervals_are_scipys_and_exact_at_their_ends(trials: int) -> None:
    for successes in {0, 1, trials // 3, trials - 1, trials}:
        known = binomtest(successes, trials).proportion_ci(method="wilson")
        assert wilson_interval(successes, trials) == pytest.approx((known.low, known.high), abs=1e-12)
    assert wilson_interval(0, trials)[0] == 0
    assert wilson_interval(trials, trials)[1] == 1


# --- which episodes -------------------------------------------------------------------------------


def key_rows(keys: jax.Array) -> set[tuple[int, ...]]:
    return set(map(tuple, np.asarray(jax.random.key_data(keys)).tolist()))


def test_an_episodes_key_depends_on_its_number_alone() -> None:
    whole = jax.random.key_data(episode_keys(3, REPORT_STREAM, 0, 50))
    part = jax.random.key_data(episode_keys(3, REPORT_STREAM, 20, 10))
    assert np.array_equal(whole[20:30], part)


def test_held_out_targets_were_never_trained_or_validated_on(init: Callable[[jax.Array], EnvState]) -> None:
    streams = TRAINING_STREAM, VALIDATION_STREAM, REPORT_STREAM
    targets = [np.asarray(init(episode_keys(0, stream, 0, BATCH)).goal.position)[:, :2] for stream in streams]
    assert len(np.unique(np.concatenate(targets), axis=0)) == 3 * BATCH


def test_no_seed_repeats_the_keys_of_another_seed_or_stream() -> None:
    streams = (TRAINING_STREAM, VALIDATION_STREAM, REPORT_STREAM)
    parts = [key_rows(episode_keys(seed, stream, 0, 200)) for seed in range(10) for stream in streams]
    parts.append(key_rows(env_keys(0, 200)))
    assert len(set.union(*parts)) == 200 * len(parts)


def test_every_key_of_a_run_is_used_for_one_thing() -> None:
    """Parts, view, noise and agent of an episode and of those that follow it, and the learner's keys, all differ."""
    episode, used = episode_keys(0, TRAINING_STREAM, 0, 50), []
    for _ in range(3):
        for_next, *others = (keys for keys in jax.vmap(lambda key: jax.random.split(key, PARTS), out_axes=1)(episode))
        steps = [step_keys(for_next, jnp.full(50, step), NOISE_STREAM) for step in range(20)]
        streams = [jax.vmap(jax.random.fold_in, (0, None))(for_next, s) for s in (VIEW_STREAM, AGENT_STREAM)]
        used += [for_next, *others, *steps, *streams]
        episode = for_next
    used += [jax.random.split(stream_key(0, stream), 50) for stream in (LEARNER_STREAM, REPORT_STREAM)]
    assert len(set.union(*map(key_rows, used))) == 50 * len(used)


def test_measurement_noise_says_nothing_of_starts_and_targets() -> None:
    env = Env(configure("precise", sim="kinematic", randomise=("dynamics",)), BATCH)
    state = env.compile_whole(env.init)(episode_keys(0, REPORT_STREAM, 0, BATCH))
    after = env.compile_whole(env.reset)(state, np.ones(BATCH, bool))
    measured, clock = env.compile_whole(lambda state: env.situation(state).q - state.arm.q), np.asarray(state.clock)
    noise = [np.asarray(measured(replace(state, clock=clock + np.int32(step)))) for step in range(5)]
    sampled = np.concatenate([np.asarray(x) for s in (state, after) for x in (s.arm.q, s.goal.position)], axis=1)
    columns = np.concatenate([*noise, sampled], axis=1)
    correlation, own = np.corrcoef(rankdata(columns, axis=0), rowvar=False), sum(rows.shape[1] for rows in noise)
    assert np.abs(correlation[:own, own:]).max() < 0.15


def test_chunks_are_the_same_episodes_as_the_whole(ik: Runner, whole: Episodes) -> None:
    parts = [run_episodes(ik, None, 1, REPORT_STREAM, count, first=first) for first, count in ((0, 1000), (1000, 500))]
    for name in ("success", "distance", "steps", "returns", "max_speed", "squared_jerk"):
        joined = np.concatenate([vars(part)[name] for part in parts])
        assert np.array_equal(joined, vars(whole)[name]), name
    middle = run_episodes(ik, None, 1, REPORT_STREAM, 100, first=950)
    assert middle.done.shape == (100,), "exactly as many as are asked for"
    assert middle.steps.tolist() == whole.steps[950:1050].tolist()
    assert middle.distance == pytest.approx(whole.distance[950:1050], abs=1e-5)


def test_every_episode_is_counted_to_its_first_end_and_no_further(start: np.ndarray, whole: Episodes) -> None:
    assert whole.done.all()
    # From the start's height to 0.1 m above the target at 3 mm a step, or from afar at 2 mm sideways.
    assert whole.steps.min() > 100
    assert whole.steps.max() < STEPS
    sparse = whole.returns[:BATCH] - 5 * (start - whole.distance[:BATCH])
    assert sparse == pytest.approx(1, abs=1e-3)


# --- agents ---------------------------------------------------------------------------------------


def test_inverse_kinematics_reaches_every_target(whole: Episodes) -> None:
    assert whole.success.all()
    assert whole.distance.max() < 0.1


@pytest.fixture(scope="module")
def idle(env: Env) -> Report:
    return evaluate(env, "zero", seed=1, episodes=30)


def test_doing_nothing_never_reaches(idle: Report) -> None:
    assert idle.success_rate == 0
    assert idle.success_interval == pytest.approx((0, 0.1135), abs=1e-4)
    assert idle.steps_mean == STEPS
    assert idle.time_to_reach_s is None
    assert idle.return_mean == pytest.approx(-0.1, abs=0.01)


def test_random_actions_rarely_reach(env: Env) -> None:
    report = evaluate(env, "random", seed=1, episodes=200)
    assert report.success_rate < 0.3
    assert (report.final_error_mm["median"] or 0) > 100


def test_all_agents_meet_the_same_targets(start: np.ndarray, idle: Report) -> None:
    # The idle tool stays where it starts, but for the millimetre that turning costs.
    assert idle.final_error_mm["max"] == pytest.approx(1000 * start[:30].max(), abs=5)
    assert idle.final_error_mm["median"] == pytest.approx(1000 * np.median(start[:30]), abs=5)


def test_an_agent_that_there_is_not_and_a_trained_one_without_a_run_are_refused(env: Env) -> None:
    with pytest.raises(InputError, match="agent 'trained' needs a run: name its directory"):
        evaluate(env, "trained", seed=1, episodes=10)
    with pytest.raises(InputError, match=r"agent 'tained' is not one of: .*Did you mean 'trained'"):
        evaluate(env, "tained", seed=1, episodes=10)


# --- reports --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("randomise", "said"), [({}, True), ({"randomise": ()}, False)])
def test_what_a_preset_varies_in_training_is_said_where_it_varies_in_an_evaluation(
    randomise: dict[str, Any], said: bool, caplog: pytest.LogCaptureFixture
) -> None:
    varied = Env(configure("precise", sim="kinematic", max_steps=50, **randomise), 1)
    with pytest.raises(InputError):  # before anything is compiled
        evaluate(varied, "zero", episodes=0)
    assert ("configure('precise', randomise=())" in caplog.text) == said


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"seed": 2**32}, "seed must be a whole number from 0 to 4294967295, got 4294967296"),
        ({"seed": -1}, "seed must be a whole number from 0"),
        ({"seed": 1.5}, "seed must be a whole number from 0"),
        ({"episodes": "5"}, "episodes must be a whole number from 1 to 2147483647, got '5'"),
        ({"episodes": 0}, "episodes must be a whole number from 1"),
    ],
)
def test_a_seed_and_a_number_of_episodes_are_whole_numbers(env: Env, given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        evaluate(env, "zero", **given)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"robot": "panda"}, "the policy is of another arm than 'panda', with other limits of its tool"),
        ({"observation": "target"}, r"the policy observes goal\[3\] tool\[3\], and the environment gives goal\[3\]:"),
    ],
)
def test_a_policy_that_does_not_fit_the_environment_is_refused(
    env: Env, settings: dict[str, Any], sentence: str
) -> None:
    policy = make_policy(jax.random.key(0), env.schema, env.action_bounds, (8,), 0.1)
    with pytest.raises(InputError, match=sentence):
        evaluate(Env(configure(**settings), 1), "trained", policy, episodes=1)


def test_a_report_has_all_its_fields(idle: Report) -> None:
    plain = json.loads(json.dumps(idle.to_json(), allow_nan=False))
    assert sorted(plain) == sorted(REPORT_FIELDS.split())
    assert sorted(plain["final_error_mm"]) == ["max", "median", "p95", "p99"]
    assert len(plain["max_joint_speed"]) == 7
    told = ("task", "robot", "sim", "agent", "seed", "episodes", "randomised", "success_within")
    assert [plain[name] for name in told] == ["tutorial", "iiwa14", "kinematic", "zero", 1, 30, [], None]
    assert {"python", "reachlab", "jax", "mujoco", "numpy"} <= set(plain["versions"])


def test_a_report_sums_up_its_episodes(env: Env) -> None:
    still = np.zeros((4, 7), np.float32)
    speeds = still.copy()
    speeds[1, 2] = 3.0
    speeds[2, 2] = 2.0
    values = {
        "goal": np.zeros((4, 3), np.float32),
        "done": np.ones(4, bool),
        "success": np.array([True, False, True, True]),
        "terminated": np.array([True, False, True, True]),
        "distance": np.array([0.02, 0.4, 0.04, 0.06], np.float32),
        "angle": np.zeros(4, np.float32),
        "contact": np.zeros(4, bool),
        "steps": np.array([120, 1000, 240, 360]),
        "arrival": np.array([100, 1001, 240, 320]),
        "returns": np.array([1.0, -0.1, 1.0, 1.0], np.float32),
        "max_speed": speeds,
        "squared_jerk": np.array([120.0, 2000.0, 720.0, 360.0], np.float32),
        "motion": (still, still, still),
    }
    report = summarise(env, "ik", Episodes(**values), seed=9, wall_s=1.5)
    assert (report.episodes, report.seed, report.agent, report.wall_s) == (4, 9, "ik", 1.5)
    assert report.success_rate == 0.75
    assert report.success_interval == wilson_interval(3, 4)
    assert report.final_error_mm["median"] == pytest.approx(40)
    assert report.final_error_mm["max"] == pytest.approx(400)
    assert report.final_error_mm["p95"] == pytest.approx(400)
    assert report.steps_mean == 430
    assert report.time_to_reach_s == pytest.approx(220 / 240)
    assert report.max_joint_speed == [0, 0, 3, 0, 0, 0, 0]
    assert report.return_mean == pytest.approx(0.725)
    assert (report.straight, report.planning_s) == (None, None)
    looked: dict[str, Any] = {
        "straight": np.array([True, False, False, False]),
        "planned": np.array([0.3, 9.0, 0.6, 0.0]),
    }
    planned = summarise(env, "planner", Episodes(**values, **looked), seed=9, wall_s=1.5)
    assert planned.straight == 0.25
    assert planned.planning_s == {"median": 0.6, "p95": 9.0, "p99": 9.0, "max": 9.0}, "of those that were planned"
    assert planned.time_to_reach_s == pytest.approx(220 / 240 + 0.3)
    assert report.jerk == pytest.approx((1 + 2 + 3 + 1) / 4)
    assert report.ends == {"success": 0.75, "outside": 0.0, "contact": 0.0, "time": 0.25}
    values |= {"success": np.zeros(4, bool), "contact": np.array([False, False, False, True])}
    ends = summarise(env, "ik", Episodes(**values), seed=9, wall_s=1.5).ends
    assert ends == {"success": 0.0, "outside": 0.5, "contact": 0.25, "time": 0.25}


def turn(env: Env, policy: Policy | None, state: EnvState, key: jax.Array, picture: jax.Array | None) -> jax.Array:
    """One joint at full speed."""
    del env, policy, key, picture
    return jnp.zeros_like(state.last_action).at[:, 0].set(1.0)


def test_speed_and_jerk_are_those_of_a_known_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """One joint sets off at full speed from rest: its displacement jumps once and stays."""
    monkeypatch.setitem(AGENTS, "turn", AgentEntry("one joint at full speed", f"{__name__}:turn"))
    steps, move, period = 10, 0.02, 1 / 240
    report = evaluate(Env(configure(action="joint_delta", max_steps=steps), BATCH), "turn", seed=0, episodes=50)
    assert report.steps_mean == steps
    assert report.max_joint_speed[0] == pytest.approx(move / period, rel=1e-3)
    assert report.max_joint_speed[1:] == pytest.approx([0] * 6, abs=1e-3)
    # Third differences of q: +move on the first step, -move on the second, then none.
    assert report.jerk == pytest.approx(2 * (move / period**3) ** 2 / 7 / steps, rel=1e-3)


def test_a_function_of_observations_is_evaluated_as_an_agent_is(env: Env, whole: Episodes) -> None:
    (low, high), told = env.action_bounds, list[int]()

    def straight(observation: np.ndarray) -> np.ndarray:
        assert observation.shape == (BATCH, 6)
        wanted = (observation[:, :3] - observation[:, 3:]) / env.setup.rules.tool_scale
        return wanted / np.maximum(np.where(wanted > 0, wanted / high, wanted / low).max(-1, keepdims=True), 1)

    mine, _ = examine(env, straight, seed=1, episodes=BATCH, watch=told.append)
    assert (mine.agent, mine.success_rate) == ("straight", 1.0)
    assert mine.steps_mean == pytest.approx(whole.steps[:BATCH].mean(), abs=0.1)
    assert told == sorted(told)
    assert any(0 < ended < BATCH for ended in told), "a watch is told on the way"
    assert told[-1] == BATCH
    with pytest.raises(InputError, match="action of environment 0 is nan at index 0"):
        evaluate(env, lambda _: np.full((BATCH, 3), np.nan), seed=3, episodes=BATCH)
