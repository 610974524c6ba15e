"""Goals that are poses: sampled, solved for and held, checked against MuJoCo's own poses and SciPy's rotations."""

from __future__ import annotations

from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from jax import Array
from scipy.spatial.transform import Rotation

from contacts import contacts
from params import tried
from reachlab.control.situation import Goal, Situation
from reachlab.envs.core import Env
from reachlab.envs.gymnasium_goal import ReachGoalEnv, ReachGoalVectorEnv
from reachlab.envs.gymnasium_vector import ReachVectorEnv
from reachlab.envs.presets import configure
from reachlab.envs.setup import make_setup
from reachlab.evaluation.report import evaluate
from reachlab.jax_setup import jit
from reachlab.robots.kinematics.forward import Pose, forward_kinematics
from reachlab.robots.robot import Robot
from reachlab.sb3 import make_vec_env
from reachlab.tasks.targets import ANGLE_TOLERANCE, POSITION_TOLERANCE, nearest_joints
from reachlab.tasks.task import TaskSetup
from reference import angle_between
from situations import judged
from situations import situation as situation_of

COUNT = 200
"""Poses that are sampled of each kind."""

ROUNDING = 3e-6
"""Of positions [m] and quaternions in float32."""

SAMPLED: dict[str, dict[str, Any]] = {
    "iiwa14": {"robot": "iiwa14"},
    "ur5e": {"robot": "ur5e"},
    "so101": {"robot": "so101", "target_turn": (0.3, 0.3, 0.3)},
    "iiwa14, any": {"robot": "iiwa14", "targets": "any"},
    "so101, any": {"robot": "so101", "targets": "any"},
}


def turn_of(quaternion: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.asarray(quaternion, float)[..., [1, 2, 3, 0]])


def mujocos_poses(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions `[B, 3]` and quaternions `[B, 4]` of the tool, a site or a body, by MuJoCo at joints `[B, n]`."""
    model = robot.spec(pictures=False).compile()
    data, places, turns = mujoco.MjData(model), [], []
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, robot.tool) >= 0
    for joints in q:
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        tool = data.site(robot.tool) if site else data.body(robot.tool)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, tool.xmat)
        places.append(tool.xpos.copy())
        turns.append(quaternion)
    return np.array(places), np.array(turns)


@pytest.fixture(scope="module", params=tried(SAMPLED, ["iiwa14", "so101"]))
def sampled(request: pytest.FixtureRequest) -> tuple[TaskSetup, Goal]:
    setup = make_setup(configure("pose", **SAMPLED[request.param]))
    goal = jit(jax.vmap(lambda key: setup.task.sample_goal(setup, key)))(jax.random.split(jax.random.key(0), COUNT))
    return setup, jax.tree.map(np.asarray, goal)


def test_a_goal_is_the_pose_that_the_arm_has_at_its_joints(sampled: tuple[TaskSetup, Goal]) -> None:
    setup, goal = sampled
    assert goal.joints is not None
    assert goal.quaternion is not None
    places, turns = mujocos_poses(setup.robot, np.asarray(goal.joints))
    assert goal.position == pytest.approx(places, abs=ROUNDING)
    assert angle_between(goal.quaternion, turns).max() < ROUNDING
    lower, upper = (np.array(limit, np.float32) for limit in (setup.robot.chain.lower, setup.robot.chain.upper))
    assert ((goal.joints >= lower) & (goal.joints <= upper)).all()


def test_goals_lie_in_their_box_and_fill_it(sampled: tuple[TaskSetup, Goal]) -> None:
    setup, goal = sampled
    low, high = setup.task.goal_box(setup)
    assert (goal.position >= low - POSITION_TOLERANCE).all()
    assert (goal.position <= high + POSITION_TOLERANCE).all()
    wide = 0.8 if setup.rules.targets == "box" else 0.5
    assert (np.ptp(goal.position, axis=0) > wide * (high - low)).all()


def test_goals_are_turned_by_no_more_than_the_rules_say(sampled: tuple[TaskSetup, Goal]) -> None:
    setup, goal = sampled
    assert goal.quaternion is not None
    turn = turn_of(np.asarray(goal.quaternion)) * turn_of(np.array(setup.robot.held_quaternion)).inv()
    angles = np.abs(turn.as_euler("xyz"))
    most = setup.rules.target_turn
    if setup.rules.targets == "any":
        assert turn.magnitude().max() > 2.5
    elif setup.robot.chain.n >= 6:  # one with fewer joints has the tilt alone
        assert most is not None
        assert (angles <= np.array(most) + ANGLE_TOLERANCE).all()
        assert (angles.max(axis=0) > 0.95 * np.array(most)).all()


def test_no_goal_has_the_arm_touch_itself_or_the_table(sampled: tuple[TaskSetup, Goal]) -> None:
    setup, goal = sampled
    capsules = setup.robot.capsules
    looked_at = {tuple(sorted((capsules.links[a], capsules.links[b]))) for a, b in capsules.pairs}
    assert not any(pairs & looked_at for pairs in contacts(setup.robot, np.asarray(goal.joints)))
    assert goal.position[:, 2].min() > setup.robot.workspace[0][2]


def test_two_keys_give_two_goals_and_one_gives_one() -> None:
    setup = make_setup(configure("pose"))
    sample = jit(lambda key: setup.task.sample_goal(setup, key))
    one, again, other = (sample(jax.random.key(seed)) for seed in (0, 0, 1))
    assert np.array_equal(one.joints, again.joints)
    assert not np.allclose(one.position, other.position, atol=1e-3)


# --- the nearest solution -------------------------------------------------------------------------


@pytest.fixture(scope="module", params=tried(["iiwa14", "ur5e", "gen3"], ["iiwa14"]))
def solver(request: pytest.FixtureRequest) -> tuple[TaskSetup, Any]:
    setup = make_setup(configure("pose", robot=request.param))

    def solve(aims: Array, near: Array, keys: Array) -> Any:
        def one(aim: Array, near: Array, key: Array) -> Any:
            return nearest_joints(setup, forward_kinematics(setup.robot.chain, aim), near, near, key)

        return jax.vmap(one)(aims, near, keys)

    return setup, jit(solve)


def test_a_solution_is_found_from_anywhere_and_the_near_one_is_taken(solver: tuple[TaskSetup, Any]) -> None:
    setup, solve = solver
    chain, speed, random = setup.robot.chain, np.array(setup.robot.speed), np.random.default_rng(3)
    aims = np.clip(random.normal(setup.robot.home, 0.6, (COUNT, chain.n)), chain.lower, chain.upper).astype(np.float32)
    keys = jax.random.split(jax.random.key(1), COUNT)
    near = np.clip(aims + random.uniform(-0.1, 0.1, aims.shape), chain.lower, chain.upper).astype(np.float32)
    far = random.uniform(np.maximum(chain.lower, -3), np.minimum(chain.upper, 3), aims.shape).astype(np.float32)
    wanted = mujocos_poses(setup.robot, aims)
    for start in (near, far):
        q, reached = map(np.asarray, solve(aims, start, keys))
        places, turns = mujocos_poses(setup.robot, q[reached])
        assert reached.mean() >= 0.98
        assert np.linalg.norm(places - wanted[0][reached], axis=1).max() < POSITION_TOLERANCE + ROUNDING
        assert angle_between(turns, wanted[1][reached]).max() < ANGLE_TOLERANCE + ROUNDING
    q, reached = map(np.asarray, solve(aims, near, keys))
    durations = (np.abs(q - near) / speed).max(axis=1)
    known = (np.abs(aims - near) / speed).max(axis=1)
    assert (durations[reached] <= 1.5 * known[reached] + 0.01).mean() > 0.98


@pytest.mark.parametrize("name", ["ur5e", "gen3"])
def test_a_hinge_that_turns_further_than_once_goes_the_short_way(name: str) -> None:
    setup = make_setup(configure("pose", robot=name))
    chain = setup.robot.chain
    wide = np.flatnonzero(np.array(chain.upper) - np.array(chain.lower) > 3 * np.pi)
    assert wide.size
    aim = np.array(setup.robot.home, np.float32)
    near, q = aim.copy(), aim.copy()
    near[wide[-1]], q[wide[-1]] = 3.5, -2.7  # which is 0.083 rad beyond 3.5, a turn away
    pose = forward_kinematics(chain, jnp.array(q))
    found, reached = jit(lambda pose: nearest_joints(setup, pose, jnp.array(near), jnp.array(q), jax.random.key(0)))(
        pose
    )
    assert reached
    if np.array(chain.upper)[wide[-1]] > 3.6:
        assert np.abs(np.asarray(found) - near).max() < 0.3


def test_a_pose_that_an_arm_of_five_joints_can_have_is_placed_as_it_is_asked_for() -> None:
    setup = make_setup(configure("pose", robot="so101"))
    chain, home = setup.robot.chain, jnp.array(setup.robot.home)
    random = np.random.default_rng(5)
    q = np.clip(random.normal(setup.robot.home, 0.5, (COUNT, chain.n)), chain.lower, chain.upper).astype(np.float32)
    asked = forward_kinematics(chain, jnp.array(q))
    before = Goal.at(asked.position[:1], quaternion=asked.quaternion[:1], joints=home[None])
    place = jit(jax.vmap(lambda position, turn: setup.task.place(setup, before, position, turn, home)))
    placed, reached = place(asked.position, asked.quaternion)
    assert np.asarray(reached).mean() > 0.8, "some of them touch"
    had = np.asarray(reached)
    assert angle_between(np.asarray(placed.quaternion)[had, 0], np.asarray(asked.quaternion)[had]).max() < 0.002
    assert np.linalg.norm(np.asarray(placed.position)[had, 0] - asked.position[had], axis=-1).max() < 2e-4
    flat = jnp.array([[0.5, 0.5, 0.5, 0.5]]) * jnp.ones((COUNT, 1))  # a turn that hardly any place allows
    tilted, reached = place(asked.position, flat)
    assert np.asarray(reached).any(), "position and tilt are"
    assert angle_between(np.asarray(tilted.quaternion)[:, 0], np.asarray(flat)).max() > 0.1


# --- held, judged and told ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def env() -> Env:
    return Env(configure("pose", randomise=()), 50)


def turned(angle: float, distance: float = 0.001, speed: float = 0.0) -> Situation:
    joints, goal = jnp.zeros((1, 7)), jnp.array([[0.5, 0.0, 0.3]])
    about_x = Rotation.from_rotvec([angle, 0, 0]).as_quat()[[3, 0, 1, 2]]
    asked = Goal.at(goal, quaternion=jnp.array([[1.0, 0.0, 0.0, 0.0]]), joints=joints)
    tool = Pose(goal + jnp.array([distance, 0.0, 0.0]), jnp.array(about_x[None], jnp.float32))
    return situation_of(joints, joints.at[0, 2].set(speed), tool, asked)


def test_the_held_angle_is_the_largest_of_the_last_steps(env: Env) -> None:
    steps, random = env.setup.rules.hold_steps, np.random.default_rng(0)
    angles = random.uniform(0.001, 0.09, 40)
    *outcomes, moved = judged(env.setup, turned(1.0), [*map(turned, angles), turned(0.001, speed=0.06)])
    for number, outcome in enumerate(outcomes, start=1):
        held = angles[max(number - steps, 0) : number].max() if number >= steps else np.inf
        assert float(outcome.counted.angle[0]) == pytest.approx(held, abs=1e-6)
        assert bool(outcome.success[0]) == (held < env.setup.rules.success_angle)
    assert np.isinf(moved.counted.angle[0])


@pytest.mark.slow
@pytest.mark.parametrize("randomise", [(), ("dynamics",)], ids=["nominal", "perturbed"])
def test_inverse_kinematics_hold_every_pose(randomise: tuple[str, ...]) -> None:
    report = evaluate(Env(configure("pose", randomise=randomise), COUNT), "ik", seed=11, episodes=COUNT)
    assert report.success_rate == 1.0
    assert report.success_within_pairs is not None
    assert report.success_within_pairs["2 mm, 0.02 rad"] == 1.0
    assert report.final_angle_rad is not None
    assert max(x for x in report.final_angle_rad.values() if x is not None) < 0.02
    assert report.self_contact == 0.0


@pytest.mark.slow
def test_a_report_tells_both_errors_of_the_same_episodes(env: Env) -> None:
    report = evaluate(env, "zero", seed=1, episodes=50)
    pairs, error, angle = report.success_within_pairs, report.final_error_mm, report.final_angle_rad
    assert pairs is not None
    assert angle is not None
    assert list(pairs) == ["50 mm, 0.2 rad", "10 mm, 0.05 rad", "2 mm, 0.02 rad"]
    assert set(angle) == set(error)
    assert evaluate(Env(configure("precise", randomise=()), 10), "zero", episodes=10).final_angle_rad is None


# --- Gymnasium's interfaces -----------------------------------------------------------------------


@pytest.mark.slow
def test_every_interface_tells_the_angle_beside_the_distance() -> None:
    settings: dict[str, Any] = {"task": "pose", "max_steps": 12}
    envs = gymnasium.make_vec("reachlab/Reach-v0", num_envs=2, autoreset_mode="SameStep", **settings)
    one, ours = gymnasium.make("reachlab/Reach-v0", **settings), make_vec_env(n_envs=2, seed=4, **settings)
    assert isinstance(envs, ReachVectorEnv)
    _, told = envs.reset(seed=4)
    _, single = one.reset(seed=4)
    ours.reset()
    actions = np.random.default_rng(0).uniform(-1, 1, (12, 2, 7)).astype(np.float32)
    for step, action in enumerate(actions):
        goal, arm = envs._episodes.state.goal, envs._episodes.state.arm
        truth = angle_between(np.asarray(arm.tool_quaternion), np.asarray(goal.quaternion))
        assert told["angle"] == pytest.approx(truth, abs=1e-5)
        assert single["angle"] == pytest.approx(truth[0], abs=1e-5)
        told, single, infos = envs.step(action)[4], one.step(action[0])[4], ours.step(action)[3]
        ended = told.get("final_info", told)
        assert [info["angle"] for info in infos] == pytest.approx(ended["angle"], abs=1e-6)
        assert single["angle"] == pytest.approx(ended["angle"][0], abs=1e-5), step
    for each in (envs, one, ours):
        each.close()
    plain = gymnasium.make("reachlab/Reach-v0", task="precise")
    assert "angle" not in plain.reset(seed=0)[1]
    plain.close()


GOAL_ENV: dict[str, Any] = {
    "task": "pose",
    "action": "joint_delta",
    "observation": "goal+state",
    "tool_scale": None,
    "max_steps": 30,
}


@pytest.mark.parametrize(("reward", "hold_steps"), [("goal", 0), ("goal_distance", 10)])
def test_rewards_and_ends_follow_from_poses(reward: str, hold_steps: int) -> None:
    near = {"success_distance": 0.3, "success_angle": 1.0} if reward == "goal" else {}
    settings = {**GOAL_ENV, "reward": reward, "hold_steps": hold_steps, **near}
    envs = gymnasium.make_vec("reachlab/ReachGoal-v0", num_envs=8, **settings)
    assert isinstance(envs, ReachGoalVectorEnv)
    observation, _ = envs.reset(seed=0)
    assert observation["achieved_goal"].shape == observation["desired_goal"].shape == (8, 7)
    seen = set()
    for _ in range(70):
        observation, rewards, terminated, truncated, info = envs.step(envs.action_space.sample())
        goals, under_way = (observation["achieved_goal"], observation["desired_goal"]), info["elapsed_steps"] > 0
        again = envs.compute_reward(*goals, info)
        exact = 0 if reward == "goal" else 1e-6
        assert rewards[under_way] == pytest.approx(again[under_way], abs=exact)
        assert np.array_equal(terminated, envs.compute_terminated(*goals, info) & under_way)
        assert np.array_equal(truncated, envs.compute_truncated(*goals, info))
        assert np.linalg.norm(goals[0][:, :3] - goals[1][:, :3], axis=1) == pytest.approx(info["distance"], abs=1e-6)
        assert angle_between(goals[0][:, 3:], goals[1][:, 3:]) == pytest.approx(info["angle"], abs=1e-5)
        seen |= set(rewards[under_way].tolist())
    assert len(seen) > 1, "a reward that never changes"
    envs.close()


def test_a_pose_in_hindsight_is_reached_whatever_its_quaternions_sign() -> None:
    env = gymnasium.make("reachlab/ReachGoal-v0", **GOAL_ENV).unwrapped
    assert isinstance(env, ReachGoalEnv)
    observation, info = env.reset(seed=0)
    achieved = observation["achieved_goal"]
    opposite = np.concatenate([achieved[:3], -achieved[3:]])
    assert env.compute_reward(achieved, observation["desired_goal"], info) == -1
    for goal in (achieved, opposite):
        assert env.compute_reward(achieved, goal, info) == 0
    env.close()
