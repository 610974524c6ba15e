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
from scipy.spatial.transform import Rotation

from reachlab.control.situation import Goal, Situation
from reachlab.envs.consistency import check
from reachlab.envs.presets import configure
from reachlab.envs.setup import make_setup, settled
from reachlab.robots.kinematics.forward import Pose, forward_kinematics
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS, bounded, command, joint_scale
from reachlab.tasks.judging import Outcome, judge
from reachlab.tasks.observations import OBSERVATIONS, observe
from reachlab.tasks.rewards import REWARDS
from reachlab.tasks.task import TaskSetup
from reachlab.tasks.tutorial import Tutorial
from situations import RULES, errors_of
from situations import situation as situation_of

PERIOD, LAG = 0.02, (0.1,) * 7

INSIDE = (0.5, 0.0, 0.3)
TARGET = (0.5, 0.0, -0.0083)
NEAR = (0.5, 0.0, 0.05)


DOWN = (0.0, 0.5**0.5, -(0.5**0.5), 0.0)
"""Orientation in which the tool points down, wxyz."""


@pytest.fixture(scope="module")
def setup() -> TaskSetup:
    return make(configure())


def make(config: RunConfig) -> TaskSetup:
    return replace(make_setup(config), period=PERIOD, lag=LAG)


def changed(setup: TaskSetup, **rules: Any) -> TaskSetup:
    return replace(setup, rules=replace(setup.rules, **rules))


def situation(tool: Any, goal: Any, actions: int = 3) -> Situation:
    still = jnp.zeros((1, 7))
    at = Pose(jnp.array([tool]), jnp.array([DOWN]))
    return situation_of(still, still, at, Goal.at(jnp.array([goal])), last_action=jnp.zeros((1, actions)))


def outcome_of(setup: TaskSetup, tool: tuple[float, ...], clock: int, before: float = 0.5) -> Outcome:
    now = situation(tool, TARGET)
    return judge(setup, errors_of(jnp.array([before])), (), now, jnp.array([clock]))


def flags(outcome: Outcome) -> tuple[bool, bool, bool]:
    return bool(outcome.outside[0]), bool(outcome.success[0]), bool(outcome.timeout[0])


def sparse_reward(outcome: Outcome) -> float:
    return float(sum(np.asarray(term)[0] for term in REWARDS["sparse"](RULES, outcome).values()))


# --- end and reward of a step ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tool", "clock", "expected", "reward"),
    [
        pytest.param(INSIDE, 1, (False, False, False), 0.0, id="continues"),
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
    setup: TaskSetup, tool: tuple[float, ...], clock: int, expected: tuple[bool, ...], reward: float
) -> None:
    outcome = outcome_of(setup, tool, clock)
    assert flags(outcome) == expected
    assert sparse_reward(outcome) == pytest.approx(reward)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [0, 1])
def test_every_face_of_the_workspace_ends_the_episode(setup: TaskSetup, axis: int, side: int) -> None:
    step = (-0.001, 0.001)[side]
    face = list(INSIDE)
    face[axis] = ((0.2, -0.3, 0.0), (0.7, 0.3, 0.55))[side][axis]
    inside, outside = face.copy(), face.copy()
    inside[axis] -= step
    outside[axis] += step
    assert not outcome_of(setup, tuple(inside), 1).outside[0]
    assert outcome_of(setup, tuple(outside), 1).outside[0]


@pytest.mark.parametrize(("distance", "reached"), [(0.0999, True), (0.1001, False)])
def test_a_tenth_of_a_metre_is_near_enough(setup: TaskSetup, distance: float, reached: bool) -> None:
    tool = (0.5, 0.0, TARGET[2] + distance)
    outcome = outcome_of(setup, tool, 1)
    assert bool(outcome.success[0]) is reached
    assert float(outcome.errors.distance[0]) == pytest.approx(distance, abs=1e-6)


def test_success_distance_and_max_steps_are_settings(setup: TaskSetup) -> None:
    strict = changed(setup, success_distance=0.01, max_steps=7)
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
    rest = dict.fromkeys(("speed", "effort", "terminated"), jnp.zeros(1))
    outcome = Outcome(
        errors=errors_of(jnp.array([after])),
        counted=errors_of(jnp.array([after])),
        gap_before=jnp.array([before]),
        gap=jnp.array([after]),
        near=ends["success"],
        progress=(),
        gained=1.0 * ends["success"],
        **rest,
        **ends,
    )
    config = replace(RULES, approach_weight=weight)
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
def test_where_the_episode_continues_success_pays_once(
    at_goal: str, before: float, tool: tuple[float, ...], clock: int, expected: tuple[bool, ...], reward: float
) -> None:
    setup = make(configure(at_goal=at_goal))
    outcome = outcome_of(setup, tool, clock, before)
    assert flags(outcome) == expected
    assert sparse_reward(outcome) == pytest.approx(reward)


def test_holding_for_the_policy_and_asking_it_to_hold_do_not_go_together() -> None:
    with pytest.raises(InputError, match=r"at_goal 'hold' holds the arm .* hold_steps 10 .* set at_goal to 'continue'"):
        check(configure("precise", at_goal="hold"))


def test_coming_closer_by_a_metre_is_worth_five_by_default(setup: TaskSetup) -> None:
    assert setup.rules.approach_weight == 5.0
    assert setup.rules.reward == "dense"


LENGTHS = ("tool_scale", "success_distance", "approach_weight", "target_height")


def test_lengths_of_the_tutorials_task_are_the_tutorials_on_its_arm(setup: TaskSetup) -> None:
    assert [getattr(Tutorial(), name) for name in LENGTHS] == [None] * len(LENGTHS)
    assert [getattr(setup.rules, name) for name in LENGTHS] == [0.005, 0.1, 5.0, -0.0083]


@pytest.mark.parametrize("scale", [0.4, 2.0])
def test_lengths_are_in_proportion_to_the_workspace_of_another_arm(
    setup: TaskSetup, scale: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    low, high = np.array(setup.robot.workspace)
    floor = np.array([-0.3, 0.5, 0.25])
    robot = replace(setup.robot, workspace=(tuple(floor), tuple(floor + scale * (high - low))))
    monkeypatch.setattr("reachlab.envs.setup.load_robot", lambda *_, **__: robot)
    rules = make(configure()).rules
    np.testing.assert_allclose(
        [getattr(rules, name) for name in LENGTHS], [0.005 * scale, 0.1 * scale, 5 / scale, 0.25 - 0.0083 * scale]
    )
    own: dict[str, Any] = {
        "tool_scale": 0.01,
        "success_distance": 0.02,
        "approach_weight": 3.0,
        "target_height": 0.3,
    }
    rules = make(configure(**own)).rules
    assert {name: getattr(rules, name) for name in LENGTHS} == own


def test_settled_settings_state_every_length_and_are_settled() -> None:
    config = configure()
    stated = settled(config, make_setup(config))
    assert vars(stated.rules) == vars(RULES)
    assert settled(stated, make_setup(stated)) == stated


# --- targets and starts ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def targets(setup: TaskSetup) -> np.ndarray:
    keys = jax.random.split(jax.random.key(0), 10_000)
    return np.asarray(jax.jit(jax.vmap(lambda key: setup.task.sample_goal(setup, key).position))(keys), np.float64)


def test_targets_lie_in_the_workspace_at_the_settled_height(targets: np.ndarray) -> None:
    assert (targets[:, :2] >= (0.2, -0.3)).all()
    assert (targets[:, :2] <= (0.7, 0.3)).all()
    assert np.unique(targets[:, 2]) == pytest.approx(-0.0083)


def test_targets_are_uniform(targets: np.ndarray) -> None:
    unit = (targets[:, :2] - (0.2, -0.3)) / (0.5, 0.6)
    # Five standard errors of each moment of 10,000 uniform samples.
    assert unit.mean(0) == pytest.approx(0.5, abs=5 / np.sqrt(12 * 10_000))
    assert unit.var(0) == pytest.approx(1 / 12, abs=5 * np.sqrt(1 / 180 / 10_000))
    assert np.asarray(np.corrcoef(unit.T))[0, 1] == pytest.approx(0, abs=0.05)
    # Kolmogorov's distance; 0.0195 is exceeded once in a thousand times.
    ranks = np.arange(1, 10_001) / 10_000
    assert np.abs(np.sort(unit, axis=0) - ranks[:, None]).max() < 0.0195


def test_targets_lie_at_the_height_that_is_asked_for(setup: TaskSetup) -> None:
    high = changed(setup, target_height=0.25)
    assert float(high.task.sample_goal(high, jax.random.key(3)).position[2]) == 0.25
    low, top = OBSERVATIONS["target"].schema(high).bounds
    assert low[2] <= 0.25 <= top[2]


def test_an_episode_starts_at_the_tutorials_joints(setup: TaskSetup) -> None:
    start = setup.task.sample_start(setup, jax.random.key(0))
    joints = (0.006418, 0.413184, -0.011401, -1.589317, 0.005379, 1.137684, -0.006539)
    assert np.asarray(start) == pytest.approx(joints, abs=1e-6)
    position = forward_kinematics(setup.robot.chain, start[None]).position[0]
    assert np.asarray(position) == pytest.approx((0.5321, -0.0011, 0.4963), abs=1e-4)


@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.05, 1.0, 3.0, np.pi])
def test_a_goals_angle_is_that_of_the_turn_to_it_whatever_the_quaternions_signs(angle: float) -> None:
    axis, down = np.array([2.0, -1.0, 0.5]) / np.sqrt(5.25), Rotation.from_quat(DOWN, scalar_first=True)
    turned = (Rotation.from_rotvec(angle * axis) * down).as_quat(scalar_first=True)
    goal = Goal.at(jnp.zeros((2, 3)), quaternion=jnp.array([DOWN, DOWN]))
    at, still = Pose(jnp.zeros((2, 3)), jnp.array([turned, -turned])), jnp.zeros((2, 7))
    pose = make(configure("pose"))
    found = pose.task.errors(pose, situation_of(still, still, at, goal)).angle
    assert np.asarray(found) == pytest.approx(angle, abs=2e-6 if angle < 2 else 1e-3)


def test_a_goal_without_orientation_has_no_angle(setup: TaskSetup) -> None:
    assert setup.task.errors(setup, situation(INSIDE, TARGET)).angle.shape == (1, 0)


# --- observations ---------------------------------------------------------------------------------


def test_observations_hold_what_their_names_say(setup: TaskSetup) -> None:
    now = situation(tool=(4.0, 5.0, 6.0), goal=(1.0, 2.0, 3.0))
    assert observe(changed(setup, observation="target"), now).tolist() == [[1, 2, 3]]
    assert observe(changed(setup, observation="target+tool"), now).tolist() == [[1, 2, 3, 4, 5, 6]]


@pytest.mark.parametrize("name", OBSERVATIONS)
def test_a_schema_describes_the_observation_and_takes_it_apart_again(name: str) -> None:
    setup = make(configure(name if name in TASKS else "tutorial"))
    schema = OBSERVATIONS[name].schema(setup)
    values: dict[str, Any] = {field.name: np.full((2, *field.shape), i) for i, field in enumerate(schema.fields)}
    picture, vector = schema.split(schema.join(values))
    assert (picture is None) == (not schema.pictures)
    assert (vector is None) == (not schema.vectors)
    if vector is not None:
        assert vector.shape == (2, schema.vector_size)
        assert np.array_equal(vector, np.concatenate([values[field.name] for field in schema.vectors], axis=1))
    if picture is not None:
        assert np.array_equal(picture, values[schema.pictures[0].name])
    assert schema == OBSERVATIONS[name].schema(setup)
    assert hash(schema) == hash(OBSERVATIONS[name].schema(setup))


def test_the_observed_box_of_the_target_is_the_workspace_from_just_below_the_table(setup: TaskSetup) -> None:
    low, high = OBSERVATIONS["target"].schema(setup).bounds
    assert low == pytest.approx((0.2, -0.3, -0.05))
    assert high == pytest.approx((0.7, 0.3, 0.55))


# --- actions --------------------------------------------------------------------------------------


def test_the_tool_delta_box_is_the_tutorials(setup: TaskSetup) -> None:
    low, high = ACTIONS["tool_delta"].bounds(setup)
    assert low == pytest.approx((-0.4, -0.4, -0.6))
    assert high == pytest.approx((0.4, 0.4, 0.3))


@pytest.mark.parametrize("name", ACTIONS)
def test_actions_are_clipped_to_their_box_unless_told_otherwise(setup: TaskSetup, name: str) -> None:
    clipping = changed(setup, action=name)
    free = changed(setup, action=name, clip_actions=False)
    high = jnp.array([ACTIONS[name].bounds(setup)[1]])
    assert np.asarray(bounded(clipping, 2 * high)) == pytest.approx(np.asarray(high))
    assert np.asarray(bounded(free, 2 * high)) == pytest.approx(2 * np.asarray(high))


def at_home(setup: TaskSetup, target: tuple[float, ...] = TARGET) -> Situation:
    home = jnp.array([setup.robot.home])
    tool = forward_kinematics(setup.robot.chain, home)
    return situation(tool.position[0], target, actions=7)._replace(
        q=home, command=home, tool_quaternion=tool.quaternion
    )


def test_a_joint_displacement_adds_to_the_last_command(setup: TaskSetup) -> None:
    joints = changed(setup, action="joint_delta", joint_scale=0.03)
    now = at_home(setup)
    action = jnp.array([[1.0, -1.0, 0.5, 0.0, -0.5, 0.25, 0.0]])
    moved = np.asarray(command(joints, now, action) - now.command)
    assert moved == pytest.approx(0.03 * np.asarray(action), abs=1e-6)


def test_joint_displacements_stop_at_the_limits(setup: TaskSetup) -> None:
    joints = changed(setup, action="joint_delta")
    upper = jnp.array([setup.robot.chain.upper], jnp.float32)
    near = at_home(setup)._replace(command=upper - 0.001)
    assert command(joints, near, jnp.ones((1, 7))).tolist() == upper.tolist()


@pytest.mark.parametrize("name", [name for name, one in ACTIONS.items() if not (one.points or "bodies" in one.needs)])
def test_the_action_towards_the_target_is_inside_the_box(setup: TaskSetup, name: str) -> None:
    design, now = ACTIONS[name], at_home(setup, (0.3, 0.25, -0.0083))
    action = np.asarray(design.towards(setup, now, now))
    low, high = design.bounds(setup)
    assert (action >= low - 1e-6).all()
    assert (action <= high + 1e-6).all()
    moved = forward_kinematics(setup.robot.chain, design.command(setup, now, jnp.asarray(action))).position
    assert float(now.goal.distance(moved)[0]) < float(now.goal.distance(now.tool_position)[0])


def test_a_correction_is_added_to_inverse_kinematics_and_fades_at_the_target(setup: TaskSetup) -> None:
    far, nothing = at_home(setup), jnp.zeros((1, 7))
    classical = ACTIONS["joint_delta"].towards(setup, far, far)
    correction = 0.3 * jnp.array([[1.0, -1.0, 0.5, 0.0, -0.5, 0.25, 0.0]])

    def displacement(now: Situation, action: Array) -> np.ndarray:
        moved = ACTIONS["joint_residual"].command(setup, now, action) - now.command
        return np.asarray(moved) / joint_scale(setup)

    expected = np.clip(np.asarray(classical + 2 * correction), -1, 1)
    assert displacement(far, correction) == pytest.approx(expected, abs=1e-4)
    tool = tuple(np.asarray(far.tool_position)[0].tolist())
    reached = at_home(setup, tool)
    assert displacement(reached, correction) == pytest.approx(displacement(reached, nothing), abs=1e-4)
    near = at_home(setup, (tool[0] - 0.01, *tool[1:]))  # half of the distance at which corrections begin to fade
    added = displacement(near, correction) - displacement(near, nothing)
    assert added == pytest.approx(np.asarray(2 * correction) / 4, abs=1e-3)


def test_inverse_kinematics_need_no_correction_but_for_what_they_wrongly_believe(setup: TaskSetup) -> None:
    now, towards = at_home(setup), ACTIONS["joint_residual"].towards
    assert np.asarray(towards(setup, now, now)) == pytest.approx(np.zeros((1, 7)))
    believed = now._replace(command=now.command + 0.01, q=now.q + 0.01)
    wrong = ACTIONS["joint_residual"].command(setup, now, towards(setup, now, believed)) - now.command
    meant = ACTIONS["joint_delta"].towards(setup, believed, believed) * joint_scale(setup)
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
def test_a_name_that_does_not_exist_is_refused_with_the_nearest(setting: str, value: str, nearest: str) -> None:
    wrong: dict[str, Any] = {setting: value}
    with pytest.raises(
        InputError, match=f"^{setting} '.*' is not one of: .* Did you mean '{nearest.replace('+', '.')}'"
    ):
        make_setup(configure(**wrong))


@pytest.mark.parametrize("task", ["tutorial", "precise", "pose"])
def test_an_arm_reaches_with_the_point_between_its_fingers(task: str) -> None:
    setups = [make_setup(configure(task, robot="panda", gripper=gripper)) for gripper in (None, "parallel", "own")]
    home = jnp.array([setups[0].robot.home])
    bare, parallel, own = (forward_kinematics(setup.robot.chain, home).position[0] for setup in setups)
    assert np.asarray(bare - parallel) == pytest.approx([0.0, 0.0, 0.105], abs=1e-4)  # it points down
    assert np.asarray(own) == pytest.approx(np.asarray(parallel), abs=1e-9)
    assert setups[1].robot.actuators == setups[0].robot.actuators  # fingers stay closed
    with pytest.raises(InputError, match="gripper"):
        make_setup(configure(task, gripper="claw"))


def test_the_wrist_of_the_tutorial_is_no_place_for_a_gripper() -> None:
    setup = make_setup(configure("tutorial", gripper="own"))
    flange = make_setup(configure("precise"))
    home = jnp.array([setup.robot.home])
    with_gripper, bare = (forward_kinematics(one.robot.chain, home).position[0] for one in (setup, flange))
    assert np.asarray(bare - with_gripper)[2] == pytest.approx(0.105, abs=1e-3)
