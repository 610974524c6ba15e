"""The rules of the tutorial's task, one step at a time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import Array

from reachlab.envs.settle import make_setup
from reachlab.robots.kinematics import forward_kinematics
from reachlab.robots.loading import load_robot
from reachlab.settings.config import TaskConfig
from reachlab.settings.validation import InputError
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.reach import bounded, command, draw_start, draw_target, judge
from reachlab.tasks.rewards import REWARDS
from reachlab.tasks.task import Outcome, Situation, TaskSetup

PERIOD, LAG = 0.02, (0.1,) * 7

INSIDE = (0.5, 0.0, 0.3)
TARGET = (0.5, 0.0, -0.0083)
NEAR = (0.5, 0.0, 0.05)


@pytest.fixture(scope="module")
def reach() -> TaskSetup:
    return make_setup(TaskConfig(), load_robot("iiwa14", "link_7"), PERIOD, LAG)


def outcome_of(reach: TaskSetup, tool: tuple[float, ...], clock: int, before: float = 0.5) -> Outcome:
    still = jnp.zeros((1, 7))
    now = Situation(still, still, jnp.array([tool]), jnp.array([TARGET]), still, jnp.zeros((1, 3)))
    return judge(reach, jnp.array([before]), None, now, jnp.array([clock]))


def flags(outcome: Outcome) -> tuple[bool, bool, bool]:
    return bool(outcome.outside[0]), bool(outcome.success[0]), bool(outcome.timeout[0])


def sparse_reward(outcome: Outcome) -> float:
    return float(sum(np.asarray(term)[0] for term in REWARDS["sparse"](TaskConfig(), outcome).values()))


# --- end and reward of a step ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tool", "clock", "expected", "reward"),
    [
        pytest.param(INSIDE, 1, (False, False, False), 0.0, id="goes on"),
        pytest.param(INSIDE, 999, (False, False, False), 0.0, id="last step before the time-out"),
        pytest.param(INSIDE, 1000, (False, False, True), -0.1, id="time-out"),
        pytest.param(NEAR, 1, (False, True, False), 1.0, id="success"),
        pytest.param(NEAR, 1000, (False, True, False), 1.0, id="success beats time-out"),
        pytest.param((0.5, 0.0, -0.001), 1, (True, False, False), -0.1, id="outside beats success"),
        pytest.param((0.5, 0.0, -0.001), 1000, (True, False, False), -0.1, id="outside beats all"),
        pytest.param((0.71, 0.0, 0.3), 1000, (True, False, False), -0.1, id="outside beats time-out"),
    ],
)
def test_the_end_of_an_episode_is_judged_in_the_tutorials_order(
    reach: TaskSetup, tool: tuple[float, ...], clock: int, expected: tuple[bool, ...], reward: float
) -> None:
    outcome = outcome_of(reach, tool, clock)
    assert flags(outcome) == expected
    assert sparse_reward(outcome) == pytest.approx(reward)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [0, 1])
def test_every_face_of_the_workspace_ends_the_episode(reach: TaskSetup, axis: int, side: int) -> None:
    step = (-0.001, 0.001)[side]
    face = list(INSIDE)
    face[axis] = ((0.2, -0.3, 0.0), (0.7, 0.3, 0.55))[side][axis]
    inside, outside = face.copy(), face.copy()
    inside[axis] -= step
    outside[axis] += step
    assert not outcome_of(reach, tuple(inside), 1).outside[0]
    assert outcome_of(reach, tuple(outside), 1).outside[0]


@pytest.mark.parametrize(("distance", "reached"), [(0.0999, True), (0.1001, False)])
def test_a_tenth_of_a_metre_is_near_enough(reach: TaskSetup, distance: float, reached: bool) -> None:
    tool = (0.5, 0.0, TARGET[2] + distance)
    outcome = outcome_of(reach, tool, 1)
    assert bool(outcome.success[0]) is reached
    assert float(outcome.distance[0]) == pytest.approx(distance, abs=1e-6)


def test_success_distance_and_max_steps_are_settings(reach: TaskSetup) -> None:
    strict = replace(reach, config=replace(reach.config, success_distance=0.01, max_steps=7))
    assert flags(outcome_of(strict, NEAR, 6)) == (False, False, False)
    assert flags(outcome_of(strict, NEAR, 7)) == (False, False, True)


@settings(max_examples=25, deadline=None)
@given(
    before=st.floats(0, 2, width=32),
    after=st.floats(0, 2, width=32),
    which=st.sampled_from([None, "outside", "success", "timeout"]),
    weight=st.sampled_from([0.0, 1.0, 5.0]),
)
def test_the_dense_reward_is_the_sparse_one_and_the_metres_gained(
    before: float, after: float, which: str | None, weight: float
) -> None:
    ends = {name: jnp.array([name == which]) for name in ("outside", "success", "timeout")}
    rest = dict.fromkeys(("held", "speed", "effort"), jnp.zeros(1))
    outcome = Outcome(jnp.array([before]), jnp.array([after]), **rest, **ends, progress=1.0 * ends["success"])
    config = TaskConfig(approach_weight=weight)
    sparse, dense = REWARDS["sparse"](config, outcome), REWARDS["dense"](config, outcome)
    assert {name: float(dense[name][0]) for name in sparse} == {name: float(sparse[name][0]) for name in sparse}
    gained = sum(float(term[0]) for term in dense.values()) - sum(float(term[0]) for term in sparse.values())
    assert gained == pytest.approx(weight * (before - after), abs=1e-5)


@pytest.mark.parametrize(
    ("before", "tool", "clock", "expected", "reward"),
    [
        pytest.param(0.2, NEAR, 1, (False, True, False), 1.0, id="reached"),
        pytest.param(0.05, NEAR, 2, (False, True, False), 0.0, id="still reached"),
        pytest.param(0.05, INSIDE, 3, (False, False, False), -1.0, id="lost"),
        pytest.param(0.05, NEAR, 1000, (False, True, True), 0.0, id="reached at the end"),
        pytest.param(0.5, INSIDE, 1000, (False, False, True), -0.1, id="out of time"),
        pytest.param(0.05, (0.5, 0.0, -0.001), 5, (True, False, False), -1.1, id="lost outside"),
    ],
)
@pytest.mark.parametrize("at_goal", ["continue", "hold"])
def test_where_the_episode_goes_on_success_pays_once(
    at_goal: str, before: float, tool: tuple[float, ...], clock: int, expected: tuple[bool, ...], reward: float
) -> None:
    reach = make_setup(TaskConfig(at_goal=at_goal), load_robot("iiwa14", "link_7"), PERIOD, LAG)
    outcome = outcome_of(reach, tool, clock, before)
    assert flags(outcome) == expected
    assert sparse_reward(outcome) == pytest.approx(reward)


def test_holding_for_the_policy_and_asking_it_to_hold_do_not_go_together() -> None:
    with pytest.raises(InputError, match=r"at_goal 'hold' holds the arm .* hold_steps 10 .* set at_goal to 'continue'"):
        make_setup(TaskConfig(at_goal="hold", hold_steps=10), load_robot("iiwa14", "link_7"), PERIOD, LAG)


def test_coming_closer_by_a_metre_is_worth_five_by_default() -> None:
    assert TaskConfig().approach_weight == 5.0
    assert TaskConfig().reward == "dense"


# --- targets and starts ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def targets(reach: TaskSetup) -> np.ndarray:
    keys = jax.random.split(jax.random.key(0), 10_000)
    return np.asarray(jax.jit(jax.vmap(lambda key: draw_target(reach, key)))(keys), np.float64)


def test_targets_lie_in_the_workspace_at_the_settled_height(targets: np.ndarray) -> None:
    assert (targets[:, :2] >= (0.2, -0.3)).all()
    assert (targets[:, :2] <= (0.7, 0.3)).all()
    assert np.unique(targets[:, 2]) == pytest.approx(-0.0083)


def test_targets_are_uniform(targets: np.ndarray) -> None:
    unit = (targets[:, :2] - (0.2, -0.3)) / (0.5, 0.6)
    # Five standard errors of each moment of 10,000 uniform draws.
    assert unit.mean(0) == pytest.approx(0.5, abs=5 / np.sqrt(12 * 10_000))
    assert unit.var(0) == pytest.approx(1 / 12, abs=5 * np.sqrt(1 / 180 / 10_000))
    assert np.asarray(np.corrcoef(unit.T))[0, 1] == pytest.approx(0, abs=0.05)
    # Kolmogorov's distance; 0.0195 is exceeded once in a thousand times.
    ranks = np.arange(1, 10_001) / 10_000
    assert np.abs(np.sort(unit, axis=0) - ranks[:, None]).max() < 0.0195


def test_targets_lie_at_the_height_that_is_asked_for(reach: TaskSetup) -> None:
    high = replace(reach, config=replace(reach.config, target_height=0.25))
    assert float(draw_target(high, jax.random.key(3))[2]) == 0.25
    low, top = OBSERVATIONS["target"].bounds(high)
    assert low[2] <= 0.25 <= top[2]


def test_an_episode_starts_at_the_tutorials_joints(reach: TaskSetup) -> None:
    start = draw_start(reach, jax.random.key(0))
    joints = (0.006418, 0.413184, -0.011401, -1.589317, 0.005379, 1.137684, -0.006539)
    assert np.asarray(start) == pytest.approx(joints, abs=1e-6)
    position = forward_kinematics(reach.robot.chain, start[None]).position[0]
    assert np.asarray(position) == pytest.approx((0.5321, -0.0011, 0.4963), abs=1e-4)


# --- observations ---------------------------------------------------------------------------------


def test_observations_hold_what_their_names_say(reach: TaskSetup) -> None:
    joints = jnp.zeros((1, 7))
    target, tool = jnp.array([[1.0, 2.0, 3.0]]), jnp.array([[4.0, 5.0, 6.0]])
    now = Situation(joints, joints, tool, target, joints, jnp.zeros((1, 3)))
    assert OBSERVATIONS["target"].observe(reach, now).tolist() == [[1, 2, 3]]
    assert OBSERVATIONS["target+tool"].observe(reach, now).tolist() == [[1, 2, 3, 4, 5, 6]]


def test_the_observed_box_of_the_target_is_the_workspace_from_just_below_the_table(reach: TaskSetup) -> None:
    low, high = OBSERVATIONS["target"].bounds(reach)
    assert low == pytest.approx((0.2, -0.3, -0.05))
    assert high == pytest.approx((0.7, 0.3, 0.55))


# --- actions --------------------------------------------------------------------------------------


def test_the_tool_delta_box_is_the_tutorials(reach: TaskSetup) -> None:
    low, high = ACTIONS["tool_delta"].bounds(reach)
    assert low == pytest.approx((-0.4, -0.4, -0.6))
    assert high == pytest.approx((0.4, 0.4, 0.3))


@pytest.mark.parametrize("name", ACTIONS)
def test_actions_are_clipped_to_their_box_unless_told_otherwise(reach: TaskSetup, name: str) -> None:
    clipping = replace(reach, config=replace(reach.config, action=name))
    free = replace(reach, config=replace(reach.config, action=name, clip_actions=False))
    high = jnp.array([ACTIONS[name].bounds(reach)[1]])
    assert np.asarray(bounded(clipping, 2 * high)) == pytest.approx(np.asarray(high))
    assert np.asarray(bounded(free, 2 * high)) == pytest.approx(2 * np.asarray(high))


def at_home(reach: TaskSetup, target: tuple[float, ...] = TARGET) -> Situation:
    home = jnp.array([reach.robot.home])
    tool = forward_kinematics(reach.robot.chain, home).position
    return Situation(home, jnp.zeros((1, 7)), tool, jnp.array([target]), home, jnp.zeros((1, 7)))


def test_a_joint_displacement_adds_to_the_last_command(reach: TaskSetup) -> None:
    joints = replace(reach, config=replace(reach.config, action="joint_delta", joint_scale=0.03))
    now = at_home(reach)
    action = jnp.array([[1.0, -1.0, 0.5, 0.0, -0.5, 0.25, 0.0]])
    moved = np.asarray(command(joints, now, action) - now.target_q)
    assert moved == pytest.approx(0.03 * np.asarray(action), abs=1e-6)


def test_joint_displacements_stop_at_the_limits(reach: TaskSetup) -> None:
    joints = replace(reach, config=replace(reach.config, action="joint_delta"))
    upper = jnp.array([reach.robot.chain.upper], jnp.float32)
    near = at_home(reach)._replace(target_q=upper - 0.001)
    assert command(joints, near, jnp.ones((1, 7))).tolist() == upper.tolist()


@pytest.mark.parametrize("name", ACTIONS)
def test_the_action_towards_the_target_is_inside_the_box(reach: TaskSetup, name: str) -> None:
    design, now = ACTIONS[name], at_home(reach, (0.3, 0.25, -0.0083))
    action = np.asarray(design.towards(reach, now, now))
    low, high = design.bounds(reach)
    assert (action >= low - 1e-6).all()
    assert (action <= high + 1e-6).all()
    moved = forward_kinematics(reach.robot.chain, design.command(reach, now, jnp.asarray(action))).position
    assert float(jnp.linalg.norm(moved - now.target)) < float(jnp.linalg.norm(now.tool_position - now.target))


def test_a_correction_is_added_to_inverse_kinematics_and_fades_at_the_target(reach: TaskSetup) -> None:
    far, nothing = at_home(reach), jnp.zeros((1, 7))
    classical = ACTIONS["joint_delta"].towards(reach, far, far)
    correction = 0.3 * jnp.array([[1.0, -1.0, 0.5, 0.0, -0.5, 0.25, 0.0]])

    def displacement(now: Situation, action: Array) -> np.ndarray:
        moved = ACTIONS["joint_residual"].command(reach, now, action) - now.target_q
        return np.asarray(moved) / reach.config.joint_scale

    expected = np.clip(np.asarray(classical + 2 * correction), -1, 1)
    assert displacement(far, correction) == pytest.approx(expected, abs=1e-4)
    tool = tuple(np.asarray(far.tool_position)[0].tolist())
    reached = at_home(reach, tool)
    assert displacement(reached, correction) == pytest.approx(displacement(reached, nothing), abs=1e-4)
    near = at_home(reach, (tool[0] - 0.01, *tool[1:]))  # half of the distance at which corrections begin to fade
    added = displacement(near, correction) - displacement(near, nothing)
    assert added == pytest.approx(np.asarray(2 * correction) / 4, abs=1e-3)


def test_inverse_kinematics_need_no_correction_but_for_what_they_wrongly_believe(reach: TaskSetup) -> None:
    now, towards = at_home(reach), ACTIONS["joint_residual"].towards
    assert np.asarray(towards(reach, now, now)) == pytest.approx(np.zeros((1, 7)))
    believed = now._replace(target_q=now.target_q + 0.01, q=now.q + 0.01)
    wrong = ACTIONS["joint_residual"].command(reach, now, towards(reach, now, believed)) - now.target_q
    meant = ACTIONS["joint_delta"].towards(reach, believed, believed) * reach.config.joint_scale
    assert np.asarray(wrong) == pytest.approx(np.asarray(meant), abs=1e-5)


# --- names ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "value", "nearest"),
    [
        ("observation", "target+tol", "target+tool"),
        ("action", "tool_dleta", "tool_delta"),
        ("reward", "spars", "sparse"),
    ],
)
def test_a_name_that_does_not_exist_is_refused_with_the_nearest(
    reach: TaskSetup, setting: str, value: str, nearest: str
) -> None:
    wrong: dict[str, Any] = {setting: value}
    with pytest.raises(
        InputError, match=f"^{setting} '.*' is not one of: .* Did you mean '{nearest.replace('+', '.')}'"
    ):
        make_setup(TaskConfig(**wrong), reach.robot, PERIOD, LAG)
