from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from reachlab.jax_setup import jit
from reachlab.robots.kinematics.chain import chain_from_model
from reachlab.robots.kinematics.forward import Pose, forward_kinematics, jacobian
from reachlab.robots.kinematics.inverse import ik_displace, ik_point_step, inverse_kinematics
from reachlab.robots.loading import load_robot
from reference import Arm, angle_between, quaternion, random_quaternions, rotation_matrix

TOOL = "link_7"

START = [0.006418, 0.413184, -0.011401, -1.589317, 0.005379, 1.137684, -0.006539]
"""The tutorial's start joints [rad]."""

START_TOOL = [0.5321, -0.0011, 0.4963]
"""The tutorial's start tool point [m], to four digits."""

POSITION_ROUNDING = 2e-6
"""Ten products of float32 numbers up to 1.3 m, each rounded to 6e-8 of its size [m]."""

ANGLE_ROUNDING = 5e-6
"""The same for the entries of a rotation, seen as an angle [rad]."""

SOLVE_ROUNDING = 4 * np.finfo(np.float32).eps
"""A Cholesky solve in float32 strays by a few units in the last place times the condition number (Higham,
"Accuracy and stability of numerical algorithms", theorem 10.4), relative to the solution."""

BRANCH_WIDTH = 1e-4
"""Joints that one step brings this close to a limit [rad] may be held in float32 and free in float64."""

ALL_BATCHES = (1, 7, 1000, 6000, 16384, 65536)

OTHER_ARMS = {
    "slides along every axis": """
        <body pos="0.1 0 0.2"><joint name="a" type="slide" axis="1 0 0" range="-0.5 0.5"/><geom size="0.01"/>
          <body quat="0.9 0.1 0.3 -0.2"><joint name="b" type="slide" axis="0 1 1" range="-0.5 0.5"/><geom size="0.01"/>
            <body pos="0 0.1 0"><joint name="c" axis="0 0 1"/><geom size="0.01"/>
              <body name="end" pos="0.2 0 0.1"><joint name="d" type="slide" axis="0 0 -1"/><geom size="0.01"/>
                <site name="tool" pos="0.1 0.02 0.03" quat="0.5 0.1 -0.7 0.2"/></body></body></body></body>""",
    "joints off the body origin": """
        <body pos="0 0 0.3"><joint name="a" pos="0.1 -0.2 0.05" axis="0 1 0"/><geom size="0.01"/>
          <body pos="0.3 0 0"><joint name="b" pos="-0.05 0.1 0.2" axis="1 2 -3"/><geom size="0.01"/>
            <body name="end" pos="0 0.2 0.1"><joint name="c" pos="0 0 0.1" axis="1 0 0"/><geom size="0.01"/>
              <site name="tool" pos="0 0 0.1"/></body></body></body>""",
    "axes that point down": """
        <body pos="0 0 0.3"><joint name="a" axis="0 0 -1"/><geom size="0.01"/>
          <body pos="0.3 0 0" quat="1 1 0 0"><joint name="b" axis="0 0 -1" pos="0.1 0 0"/><geom size="0.01"/>
            <body name="end" pos="0 0.2 0.1"><joint name="c" axis="1e-9 0 -1"/><geom size="0.01"/>
              <site name="tool" pos="0.1 0 0.1"/></body></body></body>""",
    "several joints in one body": """
        <body pos="0 0 0.3"><geom size="0.01"/>
          <joint name="a" axis="1 0 0" pos="0 0 0.1"/><joint name="b" axis="0 1 0" pos="0.1 0 0"/>
          <joint name="c" type="slide" axis="0 1 1"/><joint name="d" axis="0 0 1" pos="0 0.1 0"/>
          <body name="end" pos="0.2 0 0"><joint name="e" axis="0 1 0"/><joint name="f" type="slide" axis="1 0 0"/>
            <geom size="0.01"/><site name="tool" pos="0.1 0 0"/></body></body>""",
    "reference angles not zero": """
        <body pos="0 0 0.3"><joint name="a" axis="1 1 0" pos="0.1 0 0" ref="0.7"/><geom size="0.01"/>
          <body pos="0.3 0 0"><joint name="b" type="slide" axis="0 0 1" ref="-0.2"/><geom size="0.01"/>
            <body name="end" pos="0.2 0 0"><joint name="c" axis="0 0 -1" ref="-1.1"/><geom size="0.01"/>
              <site name="tool" pos="0.1 0 0"/></body></body></body>""",
    "a tilted base and a fixed link between": """
        <body pos="0.4 -0.2 0.1" quat="0.3 -0.4 0.5 0.6"><geom size="0.01"/>
          <body pos="0.1 0 0" quat="1 0 1 0"><joint name="a"/><geom size="0.01"/>
            <body pos="0 0.3 0" quat="0.2 0.8 0.1 0.3"><geom size="0.01"/>
              <body name="end" pos="0.2 0 0" quat="0 0 1 0"><joint name="b"/><geom size="0.01"/>
                <site name="tool" pos="0.1 0 0"/></body></body></body></body>""",
}


def arm_of(body):
    return mujoco.MjModel.from_xml_string(f'<mujoco><compiler angle="radian"/><worldbody>{body}</worldbody></mujoco>')


def mujoco_pose(model, q, tool):
    """Tool poses by MuJoCo's own kinematics; `q [B, nq]` in MuJoCo's order, which is base to tool here."""
    data = mujoco.MjData(model)
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tool)
    positions, rotations = [], []
    for row in q:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        positions.append((data.site_xpos[site] if site >= 0 else data.body(tool).xpos).copy())
        rotations.append((data.site_xmat[site] if site >= 0 else data.body(tool).xmat).reshape(3, 3).copy())
    return np.array(positions), quaternion(np.array(rotations))


def pose(position, orientation):
    """Pose in float32, as the compiled functions take it."""
    return Pose(jnp.asarray(position, jnp.float32), jnp.asarray(orientation, jnp.float32))


def near_targets(arm, q, rng, distance=0.003, angle: Any = 0.02):
    """Poses `distance` [m] in a random direction and about `angle` [rad] from where the tool is."""
    position, orientation = arm.forward(q)
    way = rng.normal(size=position.shape)
    way *= distance / np.linalg.norm(way, axis=1, keepdims=True)
    turn = np.concatenate([np.ones((len(q), 1)), rng.normal(size=way.shape) * angle / 2 / 3**0.5], 1)
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    turned = quaternion(rotation_matrix(turn) @ rotation_matrix(orientation))
    return pose(position + way, turned)


@pytest.fixture(scope="module")
def robot():
    return load_robot("iiwa14", TOOL)


@pytest.fixture(scope="module")
def model(robot):
    return mujoco.MjModel.from_xml_path(str(robot.model.file))


@pytest.fixture(scope="module")
def arm(model):
    return Arm(model, TOOL)


@pytest.fixture(scope="module")
def compiled(robot):
    """Forward kinematics, Jacobian and inverse-kinematics step in one program a shape, as NumPy arrays."""
    program = jit(
        lambda q, target: (
            forward_kinematics(robot.chain, q),
            jacobian(robot.chain, q),
            ik_displace(
                robot.chain, q, target.position - forward_kinematics(robot.chain, q).position, target.quaternion
            ),
        )
    )
    return lambda q, target: jax.tree.map(np.asarray, program(jnp.asarray(q), target))


@pytest.fixture(scope="module")
def solve(robot):
    return jit(functools.partial(inverse_kinematics, robot.chain))


# --- the compiled kernels against float64 ------------------------------------------------------------


@pytest.mark.parametrize("batch", ALL_BATCHES)
@pytest.mark.compiled
def test_compiled_kernels_equal_float64_at_every_batch_size(arm, compiled, batch):
    rng = np.random.default_rng(batch)
    q = arm.sample(rng, batch)
    # Every other arm is to turn further than one step may.
    target = near_targets(arm, q, rng, angle=np.where(np.arange(batch) % 2, 0.5, 0.02)[:, None])
    there, columns, stepped = compiled(q, target)

    position, orientation = arm.forward(q)
    assert np.abs(there.position - position).max() <= POSITION_ROUNDING
    assert angle_between(there.quaternion, orientation).max() <= ANGLE_ROUNDING
    assert np.abs(columns - arm.jacobian(q)).max() <= POSITION_ROUNDING

    solved = arm.ik_step(q, target.position, target.quaternion)
    gap = np.minimum(np.abs(solved.unclipped - arm.lower), np.abs(solved.unclipped - arm.upper)).min(1)
    decided = gap > BRANCH_WIDTH
    assert decided.mean() > 0.99
    # Beside the solve: q itself is rounded at up to π, and so are e and J.
    allowed = SOLVE_ROUNDING * (solved.condition * solved.length + 2 * np.pi)
    assert (np.abs(stepped - solved.q).max(1) <= allowed)[decided].all()


def test_one_vector_and_any_leading_shape_give_what_a_batch_gives(arm, compiled):
    rng = np.random.default_rng(1)
    q = arm.sample(rng, 15, within=0.9)
    target = near_targets(arm, q, rng)
    grid = compiled(q.reshape(5, 3, -1), jax.tree.map(lambda x: x.reshape(5, 3, -1), target))
    flat = compiled(np.resize(q, (1000, 7)), jax.tree.map(lambda x: jnp.resize(x, (1000, x.shape[1])), target))
    single = compiled(q[4], jax.tree.map(lambda x: x[4], target))
    for of_grid, of_flat, of_single in zip(*map(jax.tree.leaves, (grid, flat, single)), strict=True):
        assert of_grid.shape == (5, 3, *of_single.shape)
        np.testing.assert_allclose(of_grid[1, 1], of_single, atol=1e-5)
        np.testing.assert_allclose(of_grid.reshape(15, *of_single.shape), of_flat[:15], atol=1e-5)


# --- forward kinematics and Jacobian -----------------------------------------------------------------


@pytest.mark.parametrize("tool", ["link_7", "flange"])
def test_forward_kinematics_is_mujocos_own(model, tool):
    chain = chain_from_model(model, tool)
    q = Arm(model, tool).sample(np.random.default_rng(2), 2000)
    there = jit(functools.partial(forward_kinematics, chain))(q)
    position, orientation = mujoco_pose(model, q, tool)
    assert np.linalg.norm(there.position - position, axis=1).max() <= POSITION_ROUNDING
    assert angle_between(there.quaternion, orientation).max() <= ANGLE_ROUNDING


def test_tool_starts_where_the_tutorial_says(robot):
    there = forward_kinematics(robot.chain, jnp.asarray(START))
    np.testing.assert_allclose(there.position, START_TOOL, atol=0.6e-4)
    np.testing.assert_allclose(robot.home, START)


def test_link_7_is_where_pybullets_urdf_puts_it(robot, arm):
    import pybullet
    import pybullet_data as data

    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(f"{data.getDataPath()}/kuka_iiwa/model.urdf", physicsClientId=client)
        q = arm.sample(np.random.default_rng(3), 200)
        positions, quaternions = [], []
        for row in q:
            for joint, angle in enumerate(row):
                pybullet.resetJointState(body, joint, float(angle), physicsClientId=client)
            link = pybullet.getLinkState(body, 6, computeForwardKinematics=True, physicsClientId=client)
            positions.append(link[4])
            quaternions.append(np.roll(link[5], 1))
    finally:
        pybullet.disconnect(physicsClientId=client)
    there = jit(functools.partial(forward_kinematics, robot.chain))(q)
    assert np.linalg.norm(there.position - np.array(positions), axis=1).max() <= POSITION_ROUNDING
    assert angle_between(there.quaternion, np.array(quaternions)).max() <= ANGLE_ROUNDING


def test_jacobian_is_the_derivative_of_the_pose(robot, arm):
    q = arm.sample(np.random.default_rng(4), 200)
    numeric = arm.numeric_jacobian(q)
    given_ = jit(functools.partial(jacobian, robot.chain))(q)
    assert np.abs(given_ - numeric).max() <= 1e-4 * np.abs(numeric).max()


@pytest.mark.parametrize("tool", ["tool", "end"])
@pytest.mark.parametrize("body", OTHER_ARMS.values(), ids=list(OTHER_ARMS))
def test_any_chain_of_hinges_and_slides_moves_as_in_mujoco(body, tool):
    model = arm_of(body)
    chain = chain_from_model(model, tool)
    arm = Arm(model, tool)
    q = arm.sample(np.random.default_rng(5), 50)
    there = jit(functools.partial(forward_kinematics, chain))(q)
    position, orientation = mujoco_pose(model, q, tool)
    assert chain.n == model.njnt
    assert np.linalg.norm(there.position - position, axis=1).max() <= POSITION_ROUNDING
    assert angle_between(there.quaternion, orientation).max() <= ANGLE_ROUNDING


@pytest.mark.parametrize("body", OTHER_ARMS.values(), ids=list(OTHER_ARMS))
def test_jacobian_of_any_chain_is_the_derivative_of_its_pose(body):
    model = arm_of(body)
    arm = Arm(model, "tool")
    q = arm.sample(np.random.default_rng(6), 20)
    given_ = jit(functools.partial(jacobian, chain_from_model(model, "tool")))(q)
    numeric = arm.numeric_jacobian(q)
    assert np.abs(given_ - numeric).max() <= 1e-4 * np.abs(numeric).max()


def test_joints_without_limits_turn_once_and_slide_a_metre_either_way():
    chain = chain_from_model(arm_of(OTHER_ARMS["slides along every axis"]), "tool")
    np.testing.assert_allclose(chain.lower, [-0.5, -0.5, -2 * np.pi, -1.0], rtol=1e-7)
    np.testing.assert_allclose(chain.upper, [0.5, 0.5, 2 * np.pi, 1.0], rtol=1e-7)
    assert -2 * np.pi <= chain.lower[2] < chain.upper[2] <= 2 * np.pi


@pytest.mark.parametrize("limit", ["0.1", "1.3", "2.9670597283903604"])
def test_limits_are_float32_numbers_not_beyond_the_models(limit):
    model = arm_of(f'<body name="end"><joint range="-{limit} {limit}"/><geom size="0.1"/></body>')
    chain = chain_from_model(model, "end")
    assert float(np.float32(chain.upper[0])) == chain.upper[0] == -chain.lower[0]
    assert 0 <= float(limit) - chain.upper[0] < 3e-7


# --- one inverse-kinematics step ---------------------------------------------------------------------

fractions = st.lists(st.sampled_from([0.0, 0.5, 1.0]) | st.floats(0, 1, width=32), min_size=7, max_size=7)
points = st.lists(st.floats(-5, 5, width=32), min_size=3, max_size=3)
rotations = st.lists(st.floats(-1, 1, width=32), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)


@settings(max_examples=25, deadline=None)
@given(fractions, points, rotations)
@example([0.5] * 7, [0.0, 0.0, 1.306], [1.0, 0.0, 0.0, 0.0])  # straight up, and already there
@example([0.5] * 7, [0.0, 0.0, 1.306], [0.0, 1.0, 0.0, 0.0])  # half a turn away
@example([0.5] * 7, [0.0, 0.0, 9.0], [0.0, 0.0, 0.0, 1.0])  # straight up and pulled further
@example([1.0] * 7, [5.0, 5.0, 5.0], [0.5, 0.5, 0.5, 0.5])  # every joint at its limit
def test_ik_step_keeps_limits_and_stays_finite_wherever_the_target_is(arm, compiled, fraction, point, rotation):
    lower, upper = arm.lower.astype(np.float32), arm.upper.astype(np.float32)
    q = np.clip(lower + (upper - lower) * np.array(fraction, np.float32), lower, upper)[None]
    target = pose([point], np.array([rotation]) / np.linalg.norm(rotation))
    stepped = compiled(q, target)[2]
    assert np.isfinite(stepped).all()
    assert (stepped >= lower).all()
    assert (stepped <= upper).all()


def test_a_joint_at_its_limit_leaves_its_share_to_the_others(arm, robot):
    chain, step = robot.chain, jit(functools.partial(ik_point_step, robot.chain))
    lower, upper = np.array(chain.lower), np.array(chain.upper)
    random = np.random.default_rng(0)
    q = random.uniform(lower + 0.2, upper - 0.2, (500, chain.n)).astype(np.float32)
    way = random.normal(0, 0.01, (500, 3)).astype(np.float32)
    jacobians = arm.jacobian(q)[:, :3]
    free = np.asarray(step(q, q, way))
    stopped = np.abs(free).argmax(axis=1)
    command = q.copy()
    rows = np.arange(len(q))
    command[rows, stopped] = np.where(free > 0, upper, lower)[rows, stopped]  # it cannot go where it would
    held = np.asarray(step(q, command, way))
    assert (held[rows, stopped] * np.sign(free[rows, stopped]) <= 1e-6).all()
    assert ((command + held >= lower - 1e-5) & (command + held <= upper + 1e-5)).all()
    clipped = np.where(np.arange(chain.n) == stopped[:, None], 0, free)
    left, lost = (np.linalg.norm(way - np.einsum("bij,bj->bi", jacobians, moved), axis=1) for moved in (held, clipped))
    assert np.median(left / lost) < 0.3


def test_ik_step_stays_finite_half_a_turn_away(arm, compiled):
    rng = np.random.default_rng(7)
    q = arm.sample(rng, 1000)
    position, orientation = arm.forward(q)
    axes = rng.normal(size=(1000, 3))
    axes[:300] = np.eye(3)[rng.integers(3, size=300)]
    half = np.concatenate([np.zeros((1000, 1)), axes / np.linalg.norm(axes, axis=1, keepdims=True)], 1)
    turned = quaternion(rotation_matrix(half) @ rotation_matrix(orientation))
    stepped = compiled(q, pose(position, turned))[2]
    assert np.isfinite(stepped).all()
    assert ((stepped >= arm.lower.astype(np.float32)) & (stepped <= arm.upper.astype(np.float32))).all()


def test_ik_step_at_the_target_does_not_move(arm, compiled):
    q = arm.sample(np.random.default_rng(8), 1000, within=0.9)
    position, orientation = arm.forward(q)
    stepped = compiled(q, pose(position, orientation))[2]
    # A position error of rounding, 1e-7 m, moves the joints by at most 1e-7 / (2 sqrt(DAMPING)).
    assert np.abs(stepped - q).max() <= 2e-4


def test_repeated_ik_steps_turn_the_tutorials_arm_to_the_held_orientation(robot, arm, compiled):
    """The start pose is a quarter turn away from it: the tool holds its place meanwhile."""
    q = np.array([robot.home], np.float32)
    start = arm.forward(q)[0]
    target = pose(start, [robot.held_quaternion])
    for _ in range(60):
        q = compiled(q, target)[2]
        assert np.linalg.norm(arm.forward(q)[0] - start) < 0.02
    position, orientation = arm.forward(q)
    assert np.linalg.norm(position - start) < 1e-5
    assert angle_between(orientation, robot.held_quaternion).max() < 1e-3


def test_tool_still_reaches_its_point_when_a_joint_limit_binds(arm, compiled):
    """Where clipping alone loses a good part of a 3 mm displacement, the free joints make it up."""
    rng = np.random.default_rng(9)
    q = arm.sample(rng, 1000, within=0.8)
    arms, joint, side = np.arange(1000), rng.integers(7, size=1000), rng.integers(2, size=1000)
    q[arms, joint] = np.where(side, arm.upper[joint] - 1e-3, arm.lower[joint] + 1e-3)
    target = near_targets(arm, q, rng)
    stepped = compiled(q, target)[2]
    solved = arm.ik_step(q, target.position, target.quaternion)

    def missed(q):
        return np.linalg.norm(arm.forward(q)[0] - target.position, axis=1)

    # Where free joints can: not beside a singular arm, and not so far that the linear model itself misses by more.
    able = (solved.condition < 3e3) & (np.abs(solved.q - q).max(1) < 0.05)
    bound = able & (missed(solved.clipped_only) > 0.001)
    assert bound.sum() > 100
    assert np.median(missed(stepped)[bound]) < 0.05 * 0.003
    assert np.quantile(missed(stepped)[bound] / missed(solved.clipped_only)[bound], 0.95) < 0.2


# --- inverse kinematics ------------------------------------------------------------------------------


def test_inverse_kinematics_reaches_the_poses_of_random_joint_vectors(robot, arm, solve):
    position, orientation = arm.forward(arm.sample(np.random.default_rng(10), 2000))
    target = pose(position, orientation)
    solution = jax.tree.map(np.asarray, solve(target, jnp.asarray(robot.home, jnp.float32), jax.random.key(0)))
    assert np.isfinite(solution.q).all()
    assert (solution.q >= arm.lower.astype(np.float32)).all()
    assert (solution.q <= arm.upper.astype(np.float32)).all()
    at, turned = arm.forward(solution.q)
    reached = (np.linalg.norm(at - position, axis=1) < 1e-4) & (angle_between(turned, orientation) < 1e-3)
    assert reached.mean() >= 0.995
    assert reached[solution.converged].all()
    assert solution.converged.mean() >= 0.995


@pytest.fixture(scope="module")
def mixed(robot, arm):
    """Sixteen poses of which the odd ones are out of reach, and a function that solves them."""
    rng = np.random.default_rng(11)
    position, _ = arm.forward(arm.sample(rng, 16, within=0.7))
    position[1::2] *= 3.0 / np.linalg.norm(position[1::2], axis=1, keepdims=True)
    target = pose(position, random_quaternions(rng, 16))
    start = jnp.asarray(robot.home, jnp.float32)
    program = jit(functools.partial(inverse_kinematics, robot.chain, restarts=5))
    return target, lambda seed: jax.tree.map(np.asarray, program(target, start, jax.random.key(seed)))


def test_a_pose_out_of_reach_is_returned_unconverged_and_finite(arm, mixed):
    target, solve_mixed = mixed
    solution = solve_mixed(0)
    assert not solution.converged[1::2].any()
    assert all(np.isfinite(leaf).all() for leaf in solution)
    assert ((solution.q >= arm.lower.astype(np.float32)) & (solution.q <= arm.upper.astype(np.float32))).all()
    left = np.linalg.norm(arm.forward(solution.q)[0] - target.position, axis=1)
    np.testing.assert_allclose(solution.position_error, left, atol=1e-5)
    assert (solution.position_error[1::2] > 1.5).all()


def test_equal_keys_give_equal_solutions(mixed):
    _, solve_mixed = mixed
    np.testing.assert_array_equal(solve_mixed(1).q, solve_mixed(1).q)
    assert not np.array_equal(solve_mixed(1).q, solve_mixed(2).q)


# --- models that are no arm --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("joint", "tool", "message"),
    [
        ('<joint name="wrist" type="ball"/>', "end", "'wrist' is a ball joint"),
        ('<freejoint name="float"/>', "end", "'float' is a free joint"),
        ('<joint name="a"/>', "gripper", "'gripper' is neither a site nor a body"),
    ],
    ids=["ball", "free", "unknown tool"],
)
def test_a_model_that_is_no_arm_is_refused(joint, tool, message):
    model = arm_of(f'<body name="end">{joint}<geom size="0.1"/></body>')
    with pytest.raises(ValueError, match=message):
        chain_from_model(model, tool)


def test_slides_begin_within_a_tenth_of_their_way_and_hinges_as_said(robot):
    assert robot.chain.noise(0.3) == 0.3
    slides = (False, True, True)
    chain = replace(robot.chain, slides=slides, lower=(-2.0, -0.25, -5.0), upper=(2.0, 0.0, 5.0))
    assert chain.noise(0.3) == pytest.approx([0.3, 0.025, 0.3])
