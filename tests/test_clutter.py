"""Holding a point among obstacles: scenes, distances, dampers and contact, checked against MuJoCo and NumPy alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasiums_checker
from scipy.spatial.transform import Rotation
from stable_baselines3.common.env_checker import check_env as stable_baselines3s_checker

from reachlab.control.bodies import FAR, Bodies, Nearest, nearest
from reachlab.control.dampers import RATE, STOP, damped, surroundings
from reachlab.control.planning.collision import BODY, CAPSULE
from reachlab.control.situation import Goal, Situation
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.envs.setup import make_setup
from reachlab.evaluation.report import evaluate
from reachlab.jax_setup import jit
from reachlab.robots.kinematics.forward import Pose
from reachlab.robots.shapes.clearance import capsules_at
from reachlab.settings.validation import InputError
from reachlab.sims.mujoco_model import physics_model
from reachlab.tasks.observations import observe
from reachlab.tasks.scenes.balls import CLEAR, LONG, RADIUS, SIDE, THIN
from reachlab.tasks.task import Scene, TaskSetup
from reachlab.watch.player import TOUCHED, Player
from situations import begin, swept
from situations import situation as situation_of
from test_contacts import capsule_ends, scene

pytestmark = pytest.mark.slow

COUNT = 64
MOST = 4

BISECTED = 1e-3
"""By how much a distance found by bisection may be too large [m]."""


@pytest.fixture(scope="module")
def env() -> Iterator[Env]:
    env = Env(configure("clutter", randomise=(), obstacles=(0, MOST)), COUNT)
    yield env
    env.close()


@pytest.fixture(scope="module")
def begun(env: Env) -> EnvState:
    return env.init(env_keys(3, COUNT))


@pytest.fixture(scope="module")
def setup() -> TaskSetup:
    return make_setup(configure("clutter"))


def row(obstacles: Bodies, index: int) -> Bodies:
    return jax.tree.map(lambda x: np.asarray(x)[index], obstacles)


# --- scenes ---------------------------------------------------------------------------------------


def engine_distance(model: mujoco.MjModel, env: Env, q: np.ndarray, obstacles: Bodies) -> float:
    """Least distance between the arm at `q [n]` and obstacles `[K]`, as MuJoCo's own collision code has it [m]."""
    data = mujoco.MjData(model)
    kinds = mujoco.mjtGeom
    for number in range(MOST):
        geom = model.geom(f"{BODY}{number}")
        half, radius = obstacles.half[number], obstacles.radius[number]
        kind = kinds.mjGEOM_BOX if half[0] else kinds.mjGEOM_CAPSULE if half[2] else kinds.mjGEOM_SPHERE
        geom.type, geom.pos, geom.quat = kind, obstacles.position[number], obstacles.quaternion[number]
        geom.size = half if half[0] else (radius, half[2], 0)
        geom.sameframe = 0
    data.qpos[: len(q)] = q
    mujoco.mj_kinematics(model, data)
    moving = [f"{CAPSULE}{number}" for number, link in enumerate(env.setup.robot.capsules.links) if link]
    there = [f"{BODY}{number}" for number in range(MOST) if obstacles.present[number]]
    pairs = [(model.geom(one).id, model.geom(other).id) for one in moving for other in there]
    return min((mujoco.mj_geomDistance(model, data, *pair, 1.0, None) for pair in pairs), default=np.inf)


def test_start_and_goal_are_free_of_obstacles(env: Env, begun: EnvState) -> None:
    clear, ends = CLEAR * env.setup.robot.scale, np.stack([begun.arm.q, begun.goal.joints], axis=1)
    model = physics_model(env.setup.robot, env.config.physics, Scene(MOST, contacts=True))
    seen = [engine_distance(model, env, q, row(begun.arm.bodies, index)) for index in range(COUNT) for q in ends[index]]
    assert min(seen) > clear - BISECTED
    assert np.median(seen) < 5 * clear, "obstacles are in the way"


def test_the_arm_touches_nothing_at_start_and_goal(env: Env, begun: EnvState) -> None:
    assert not np.asarray(begun.arm.contact).any()
    at_goal = env.simulator.reset(None, begin(np.asarray(begun.goal.joints), bodies=begun.arm.bodies), None)
    assert not np.asarray(at_goal.contact).any()
    np.testing.assert_allclose(at_goal.tool_position, begun.goal.position, atol=2e-4)


def test_numbers_of_obstacles_are_those_of_the_rules(begun: EnvState) -> None:
    counts = np.asarray(begun.arm.bodies.present).sum(axis=1)
    assert set(counts) == set(range(MOST + 1))
    assert np.bincount(counts).max() < 0.5 * COUNT
    fixed = Env(configure("clutter", obstacles=(2, 2)), COUNT)
    found = fixed.init(env_keys(0, COUNT)).arm.bodies
    counts = np.asarray(found.present).sum(axis=1)
    assert counts.max() == 2
    assert (counts == 2).mean() > 0.75
    fixed.close()


def test_kinds_and_sizes_are_in_range(env: Env, begun: EnvState) -> None:
    there, scale = np.asarray(begun.arm.bodies.present), env.setup.robot.scale
    half, radius = np.asarray(begun.arm.bodies.half)[there], np.asarray(begun.arm.bodies.radius)[there]
    box, capsule = half[:, 0] > 0, (half[:, 0] == 0) & (half[:, 2] > 0)
    ball = ~box & ~capsule
    for values, (low, high) in (
        (half[box], SIDE),
        (half[capsule, 2], LONG),
        (radius[capsule], THIN),
        (radius[ball], RADIUS),
    ):
        assert len(values) > COUNT // 8
        assert (values >= low * scale - 1e-6).all()
        assert (values <= high * scale + 1e-6).all()
    assert not radius[box].any()
    assert not half[ball].any()
    assert np.linalg.norm(begun.arm.bodies.quaternion, axis=-1) == pytest.approx(1, abs=1e-5)
    assert (np.asarray(begun.arm.bodies.position)[~there] == np.array(FAR)).all()


# --- distances ------------------------------------------------------------------------------------

LINEAR = 1e-4
"""By how much a displacement of `STEP` may be off its linearisation, and off limits that contradict each other [m]."""

SAMPLES = 4000
"""Points of a capsule's axis at which NumPy looks for the nearest: half a millimetre apart at most."""


def sampled(start: np.ndarray, end: np.ndarray, obstacles: Bodies, floor: float) -> float:
    """Least distance of points between `start [3]` and `end [3]` from obstacles `[K]` and the table [m]."""
    points = start + np.linspace(0, 1, SAMPLES)[:, None] * (end - start)
    least = [float((points[:, 2] - floor).min())]
    for position, quaternion, half, radius in zip(
        obstacles.position, obstacles.quaternion, obstacles.half, obstacles.radius, strict=True
    ):
        local = Rotation.from_quat(quaternion, scalar_first=True).inv().apply(points - position)
        outside = np.maximum(np.abs(local) - half, 0.0)
        least.append(float(np.linalg.norm(outside, axis=1).min() - radius))
    return min(least)


def around(setup: TaskSetup, q: np.ndarray, obstacles: Bodies) -> Nearest:
    robot = setup.robot
    find = jit(lambda q, obs: nearest(robot.capsules, capsules_at(robot.chain, robot.capsules, q), obs))
    return find(jnp.asarray(q, jnp.float32), obstacles)


def floor(setup: TaskSetup) -> float:
    return float(setup.robot.workspace[0][2])


def joints(setup: TaskSetup, count: int, spread: float = 0.8) -> np.ndarray:
    home = np.array(setup.robot.home)
    return home + np.random.default_rng(1).uniform(-spread, spread, (count, len(home)))


def test_distances_are_those_of_densely_sampled_axes(setup: TaskSetup) -> None:
    robot, q, obstacles = setup.robot, joints(setup, 20), scene(20, seed=5)
    found = np.asarray(around(setup, q, obstacles).distance)
    moving = np.flatnonzero(robot.capsules.links)
    start, end = capsule_ends(robot, q)[:, :, moving]
    for index in range(len(q)):
        here = row(obstacles, index)
        for number, capsule in enumerate(moving):
            radius = robot.capsules.radii[capsule]
            wanted = sampled(start[index, number], end[index, number], here, floor(setup)) - radius
            assert found[number, index] == pytest.approx(wanted, abs=BISECTED)


def test_normals_point_away(setup: TaskSetup) -> None:
    q, obstacles, step = joints(setup, 20), scene(20, seed=6), 0.01
    found = around(setup, q, obstacles)
    normal, point = (np.moveaxis(np.array(side), 0, -1) for side in (found.normal, found.point))
    length = np.linalg.norm(normal, axis=-1)
    assert ((length == 0) | (np.abs(length - 1) < 1e-3)).all()
    assert (length > 0).mean() > 0.8
    for capsule, index in np.argwhere(length > 0):
        place, here = point[capsule, index], row(obstacles, index)
        near, away = (sampled(p, p, here, -np.inf) for p in (place, place + step * normal[capsule, index]))
        if near < place[2] - floor(setup):  # an obstacle is nearest; above the table there may be one yet
            assert away > near - 1e-6
            single = [sampled(place, place, one, -np.inf) for one in each(here)]
            chosen = int(np.argmin(single))
            moved = place + step * normal[capsule, index]
            assert sampled(moved, moved, each(here)[chosen], -np.inf) == pytest.approx(single[chosen] + step, abs=2e-4)
        else:
            np.testing.assert_array_equal(normal[capsule, index], [0, 0, 1])


def each(obstacles: Bodies) -> list[Bodies]:
    """Bodies `[K]` one by one `[1]`."""
    return [jax.tree.map(lambda x, k=k: x[k : k + 1], obstacles) for k in range(len(obstacles.radius))]


# --- dampers --------------------------------------------------------------------------------------


def situation(q: np.ndarray, obstacles: Bodies) -> Situation:
    joints, count = jnp.asarray(q, jnp.float32), len(q)
    still, goal = jnp.zeros_like(joints), Goal.at(jnp.zeros((count, 3)), joints=jnp.zeros_like(joints))
    tool = Pose(jnp.zeros((count, 3)), jnp.zeros((count, 4)))
    return situation_of(joints, still, tool, goal, last_action=still, bodies=obstacles)


STEP = 0.02
"""Joint displacement before it is damped [rad]."""


@pytest.fixture(scope="module")
def kept_clear(setup: TaskSetup) -> tuple[np.ndarray, ...]:
    """Random displacements and what the dampers make of them `[B, n]`, and per capsule `[C, B]`: the distance before,
    after either, and how much nearer it may come [m]."""
    count = 400
    q, obstacles = joints(setup, count), scene(count, seed=7)
    step = np.random.default_rng(2).uniform(-STEP, STEP, q.shape).astype(np.float32)
    now = situation(q, obstacles)
    kept = np.asarray(jit(lambda now, step: damped(setup, now, step))(now, jnp.asarray(step)))
    find = jit(lambda q: surroundings(setup.robot, q, now.bodies).distance)
    before, wild, after = (np.asarray(find(jnp.asarray(x, jnp.float32))) for x in (q, q + step, q + kept))
    stop = STOP * setup.robot.scale
    return step, kept, before, wild, after, RATE * (before - stop)


def test_a_harmless_displacement_stays_as_it_is(kept_clear: tuple[np.ndarray, ...]) -> None:
    step, kept, before, wild, _, allowed = kept_clear
    harmless = (before - wild < allowed - 1e-3).all(axis=0)
    assert 0.02 < harmless.mean() < 0.9
    np.testing.assert_allclose(kept[harmless], step[harmless], atol=1e-7)


def test_a_damped_displacement_comes_no_nearer_than_it_may(kept_clear: tuple[np.ndarray, ...]) -> None:
    _, _, before, wild, after, allowed = kept_clear
    counted = allowed > 0  # nearer than the distance at which it stops it should move away, as far as it can
    counted &= (before > 0).all(axis=0) & (allowed > 0).all(axis=0)
    assert counted.sum() > 100
    too_near, undamped = (before - after - allowed)[counted], (before - wild - allowed)[counted]
    assert (undamped > LINEAR).mean() > 0.01, "without dampers it would"
    assert too_near.max() < LINEAR


# --- observation ----------------------------------------------------------------------------------


def test_the_observation_does_not_depend_on_the_order_of_obstacles(setup: TaskSetup) -> None:
    count, order = 20, [2, 0, 1]
    q, obstacles = joints(setup, count), scene(count, seed=8)
    look = jit(lambda now: observe(setup, now))
    one = np.asarray(look(situation(q, obstacles)))
    turned = jax.tree.map(lambda x: x[:, order], obstacles)
    np.testing.assert_allclose(np.asarray(look(situation(q, turned))), one, atol=1e-6)
    elsewhere = scene(count, seed=9)
    assert np.abs(np.asarray(look(situation(q, elsewhere))) - one).max() > 0.1


# --- episodes -------------------------------------------------------------------------------------


def test_inverse_kinematics_succeed_among_obstacles() -> None:
    env = Env(configure("clutter", randomise=()), 100)
    report = evaluate(env, "ik", seed=11, episodes=100)
    env.close()
    assert report.success_rate >= 0.95


def test_without_obstacles_contact_is_told_all_the_same() -> None:
    env = Env(configure("clutter", obstacles=(0, 0), randomise=()), 4)
    state = env.init(env_keys(0, 4))
    assert not np.asarray(state.arm.bodies.present).any()
    assert np.isfinite(np.asarray(env.observe_now(state))).all()
    assert evaluate(env, "ik", seed=1, episodes=4).success_rate == 1
    env.close()


def ball_at(env: Env, state: EnvState, place: np.ndarray) -> EnvState:
    """State in which a ball of 5 cm is the only obstacle, at `[B, 3]` m."""
    shape = np.asarray(state.arm.bodies.radius).shape
    position = np.tile(np.array(FAR, np.float32), (*shape, 1))
    position[:, 0] = place
    ball = swept(position, state.arm.bodies.quaternion, np.zeros((*shape, 3)), np.full(shape, 0.05))
    return env.rearrange(state, ball)


def driven(env: Env, state: EnvState, ahead: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """When each episode ended `[B]`, and whether in success, with joints driven by `ahead [n]` a step, undamped."""
    ended, success = np.full(env.num_envs, -1), np.zeros(env.num_envs, bool)
    action = np.zeros((env.num_envs, len(env.action_bounds[0])), np.float32)
    for number in range(100):
        state, transition = env.step(state, action, instead=state.command + jnp.asarray(ahead, jnp.float32))
        over = np.asarray(transition.terminated) & (ended < 0)
        ended[over], success[over] = number, np.asarray(transition.terms["success"])[over]
    return ended, success


@pytest.mark.parametrize("into", ["table", "obstacle"])
def test_contact_ends_an_episode_in_failure(into: str) -> None:
    rules = {"obstacles": (1, 1), "randomise": (), "start_noise": 0.0, "hold_steps": 10}
    env = Env(configure("clutter", **rules), 2)
    state = env.init(env_keys(0, 2))
    tool, n = np.asarray(state.arm.tool_position), env.setup.robot.chain.n
    # The iiwa leans forward and down by its second joint, and turns left by its first.
    ahead = np.zeros(n)
    ahead[1 if into == "table" else 0] = 0.02
    left = tool + np.array([0.0, 0.25, 0.0])
    state = ball_at(env, state, np.array(FAR) * np.ones((2, 1)) if into == "table" else left)
    ended, success = driven(env, state, ahead)
    assert (ended > 2).all()
    assert not success.any()
    free = Env(configure("clutter", **rules, end_on_contact=False), 2)
    state = ball_at(free, free.init(env_keys(0, 2)), np.array(FAR) * np.ones((2, 1)) if into == "table" else left)
    assert (driven(free, state, ahead)[0] < 0).all()
    env.close()
    free.close()


def test_any_state_is_continued_from_exactly(env: Env, begun: EnvState) -> None:
    action = np.random.default_rng(0).uniform(-1, 1, (3, COUNT, len(env.action_bounds[0]))).astype(np.float32)
    state, _ = env.step(begun, action[0])
    first, _ = env.step(state, action[1])
    env.init(env_keys(99, COUNT))  # other obstacles in the engine
    again, _ = env.step(state, action[1])
    for one, other in zip(jax.tree.leaves(first.arm), jax.tree.leaves(again.arm), strict=True):
        np.testing.assert_array_equal(one, other)


def test_obstacles_are_put_elsewhere_while_the_arm_stays(env: Env, begun: EnvState) -> None:
    tool = np.asarray(begun.arm.tool_position)
    state = ball_at(env, begun, tool)
    np.testing.assert_array_equal(state.arm.q, begun.arm.q)
    action = np.zeros((COUNT, len(env.action_bounds[0])), np.float32)
    moved, transition = env.step(state, action)
    assert np.asarray(moved.arm.contact).all()
    assert np.asarray(transition.terminated).all()
    back, _ = env.step(begun, action)
    assert not np.asarray(back.arm.contact).any()


# --- gymnasium ------------------------------------------------------------------------------------


def test_the_environment_passes_the_checkers_and_episodes_end() -> None:
    env = gymnasium.make("reachlab/Reach-v0", task="clutter", max_steps=20, disable_env_checker=True)
    gymnasiums_checker(env.unwrapped, skip_render_check=True)
    stable_baselines3s_checker(env.unwrapped)
    env.reset(seed=0)
    env.action_space.seed(0)
    steps, terminated, truncated = 0, False, False
    while not (terminated or truncated):
        *_, terminated, truncated, _ = env.step(env.action_space.sample())
        steps += 1
    assert steps == 20 if truncated else steps < 20
    env.close()


# --- watching -------------------------------------------------------------------------------------


def test_obstacles_are_drawn_and_the_touched_one_is_red(env: Env, begun: EnvState) -> None:
    index = int(np.asarray(begun.arm.bodies.present).sum(axis=1).argmax())
    far = replace(begun.arm.bodies, position=jnp.full_like(begun.arm.bodies.position, FAR[2]))
    try:
        seen = env.render(begun, index)
    except InputError as error:
        pytest.skip(str(error))
    empty = env.render(env.rearrange(begun, far), index)
    drawn = (np.abs(seen.astype(int) - empty) > 20).any(axis=-1).mean()
    assert drawn > 0.005
    assert not any(block.touched for block in env.shown.blocks(begun, index))
    state, _ = env.step(
        ball_at(env, begun, np.asarray(begun.arm.tool_position)), np.zeros((COUNT, len(env.action_bounds[0])), "f4")
    )
    assert [block.touched for block in env.shown.blocks(state, index)] == [True, False, False, False]

    def reds(picture: np.ndarray) -> int:
        return int(((picture[..., 0] > 120) & (picture[..., 1] < 80) & (picture[..., 2] < 90)).sum())

    assert reds(env.render(state, index)) > reds(seen) + 200


def test_an_obstacle_is_moved_by_hand_while_an_agent_plays() -> None:
    env = Env(configure("clutter", obstacles=(2, 2), randomise=()), 1)
    player = Player(env, 1)
    player.step("ik", None)
    tool = player.moment.tool
    player.move_body(0, tool)
    np.testing.assert_allclose(env.shown.blocks(player.state)[0].position, tool, atol=1e-6)
    player.step("ik", None)
    assert player.failed == TOUCHED
    assert player.over
    assert player.episodes == 0
    player.follow(True)
    player.proceed()
    np.testing.assert_allclose(env.shown.blocks(player.state)[0].position, tool, atol=1e-6)
    player.move_body(0, np.array([5.0, 5.0, 5.0]))
    np.testing.assert_allclose(env.shown.blocks(player.state)[0].position, env.setup.robot.workspace[1])
    env.close()


def test_the_target_that_is_moved_by_hand_has_joints_again() -> None:
    env = Env(configure("clutter", obstacles=(0, 0), randomise=()), 1)
    player = Player(env, 1)
    place = np.mean(env.setup.task.goal_box(env.setup), axis=0)
    assert player.move_target(place)
    for _ in range(120):
        player.step("ik", None)
    assert player.moment.distance < 0.005
    np.testing.assert_allclose(player.moment.tool, place, atol=0.005)
    env.close()
