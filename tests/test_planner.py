"""Agents `planner` and `hybrid`: their paths are judged by MuJoCo's own contacts."""

from __future__ import annotations

import sys
from dataclasses import replace

import jax
import numpy as np
import pytest

from reachlab.agents.acting import make_act
from reachlab.agents.hybrid import Hybrid, make_ahead
from reachlab.agents.planner import Following, plans_for
from reachlab.agents.policy import Policy
from reachlab.control.bodies import Bodies
from reachlab.control.planning import planner
from reachlab.control.planning.following import Trajectory
from reachlab.control.planning.planner import ACCELERATION, SPEED
from reachlab.control.planning.plans import Plans
from reachlab.control.planning.timing import timed
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.evaluation.report import evaluate
from reachlab.learn.learner import make_initial_policy
from reachlab.learn.load import load
from reachlab.robots.loading import load_robot
from reachlab.settings.validation import InputError
from reachlab.sims.simulator import make_simulator
from reachlab.tasks.task import Scene
from situations import begin

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("few_scenes")]

EPISODES = 8

Episode = tuple[Bodies, np.ndarray, np.ndarray]
"""Bodies `[K]`, start and goal `[n]`."""


@pytest.fixture(scope="module", params=[("iiwa14", "balls"), ("ur5e", "wall"), ("xarm7", "shelf")], ids=str)
def env(request: pytest.FixtureRequest, few_scenes: None) -> Env:  # noqa: ARG001
    robot, scene = request.param
    more = {"obstacles": (4, 4)} if scene == "balls" else {}
    return Env(configure("clutter", robot=robot, scene=(scene,), randomise=(), **more), EPISODES)


@pytest.fixture(scope="module")
def plans(env: Env) -> Plans:
    return plans_for(env)


@pytest.fixture(scope="module")
def policy(env: Env) -> Policy:
    return load(f"{env.setup.robot.name}/clutter").policy


def begun(env: Env) -> EnvState:
    return env.init(env_keys(0, EPISODES))


def episodes(env: Env) -> list[Episode]:
    state = begun(env)
    start, goal = np.asarray(state.command, float), np.asarray(state.goal.joints)
    bodies = jax.tree.map(np.asarray, state.arm.bodies)
    return [(jax.tree.map(lambda x, i=i: x[i], bodies), start[i], goal[i]) for i in range(EPISODES)]


def touched(env: Env, bodies: Bodies, q: np.ndarray) -> np.ndarray:
    """Whether MuJoCo finds a contact `[B]` of arms at `q [B, n]` among one scene's bodies."""
    sim = make_simulator(
        "mujoco", env.setup.robot, env.config.physics, len(q), scene=Scene(len(bodies.kind), contacts=True)
    )
    scene = jax.tree.map(lambda x: np.repeat(np.asarray(x)[None], len(q), axis=0), bodies)
    state = sim.reset(None, begin(q.astype(np.float32), bodies=scene), None)
    sim.close()
    return np.asarray(state.contact)


def planned(plans: Plans, episode: Episode) -> Trajectory:
    motion = plans.plan(*episode)
    assert motion is not None
    return motion


def test_a_motion_leads_from_start_to_goal_and_mujoco_finds_no_contact_on_it(env: Env, plans: Plans) -> None:
    straight, tools = [], env.setup.robot.chain.tool_at
    for episode in episodes(env):
        bodies, start, goal = episode
        motion = planned(plans, episode)
        np.testing.assert_allclose(motion.q[0], start, atol=1e-6)
        np.testing.assert_allclose(tools(motion.q[-1])[0], tools(goal)[0], atol=1e-4)
        between = (motion.q[:-1] + motion.q[1:]) / 2
        assert not touched(env, bodies, np.concatenate([motion.q, between])).any()
        way = start + np.linspace(0, 1, 100)[:, None] * (goal - start)
        straight.append(touched(env, bodies, way).any())
    assert any(straight), "bodies are in the way of some"


def test_planning_again_gives_the_same_motion(env: Env, plans: Plans, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        planner, "SECONDS", (60.0,) * len(planner.SECONDS)
    )  # nor does it depend on how fast a machine is
    one, other = (planned(plans, episodes(env)[1]) for _ in range(2))
    np.testing.assert_array_equal(one.q, other.q)


def test_a_goal_inside_a_body_has_no_motion(env: Env, plans: Plans) -> None:
    bodies, start, goal = episodes(env)[0]
    tool, _ = env.setup.robot.chain.tool_at(goal)
    there = replace(bodies, position=np.tile(tool.astype(np.float32), (len(bodies.kind), 1)))
    assert touched(env, there, goal[None]).all()
    assert plans.plan(there, start, goal) is None


def test_a_body_about_the_arm_opens_no_way_through_others(env: Env, plans: Plans) -> None:
    bodies, start, goal = episodes(env)[1]
    tool, _ = env.setup.robot.chain.tool_at(start)
    about = replace(bodies, position=np.concatenate([tool[None].astype(np.float32), bodies.position[1:]]))
    assert touched(env, about, start[None]).all()
    assert plans.plan(about, start, goal) is None


def test_joints_are_no_faster_than_they_may_be(env: Env, plans: Plans) -> None:
    robot, period = env.setup.robot, env.setup.period
    for episode in episodes(env)[:3]:
        motion = planned(plans, episode)
        speeds = np.diff(motion.q, axis=0) / period
        assert (np.abs(speeds) <= 1.02 * SPEED * np.array(robot.speed)).all()
        assert np.abs(speeds).max(axis=0).max() > 0.3 * min(robot.speed), "nor much slower"
        changes = np.diff(speeds, axis=0) / period
        assert (np.abs(changes) <= 1.1 * ACCELERATION * np.array(robot.acceleration)).all()


def test_a_path_of_one_point_is_stood_on() -> None:
    found = timed(np.array([[0.1, 0.2], [0.1, 0.2]]), np.ones(2), np.ones(2), 0.02)
    assert found is not None
    np.testing.assert_array_equal(found[0], [[0.1, 0.2]])


def test_the_agent_holds_its_goals(env: Env) -> None:
    report = evaluate(env, "planner", seed=2, episodes=EPISODES)
    assert report.agent == "planner"
    assert report.success_rate == 1.0
    assert report.planning_s is not None
    assert 0 < (report.planning_s["median"] or 0) <= (report.planning_s["max"] or 0)
    share = np.array(report.max_joint_speed) / np.array(load_robot(report.robot).speed)
    assert share.max() < 1.5


def test_poses_in_a_shelf_are_held_by_either() -> None:
    env = Env(configure("clutter_pose", robot="panda", scene=("shelf",), randomise=()), EPISODES)
    goal = begun(env).goal
    assert goal.quaternion.shape == (EPISODES, 4)
    at = np.stack([env.setup.robot.chain.tool_at(q)[1] for q in np.asarray(goal.joints)])
    np.testing.assert_allclose(np.abs((at * np.asarray(goal.quaternion)).sum(axis=1)), 1.0, atol=1e-5)
    unlearnt = make_initial_policy(env.config, env, jax.random.key(0))
    for agent, policy in (("planner", None), ("hybrid", unlearnt)):
        report = evaluate(env, agent, policy, seed=2, episodes=EPISODES)
        assert report.success_rate == 1.0, agent
        assert report.contact == 0.0
        assert ((report.final_angle_rad or {})["median"] or 1.0) < 0.05
    env.close()


def test_an_arm_whose_goal_cannot_be_reached_stays_where_it_is(env: Env) -> None:
    state = begun(env)
    tools = np.stack([env.setup.robot.chain.tool_at(q)[0] for q in np.asarray(state.goal.joints)])
    count = state.arm.bodies.kind.shape[1]
    there = replace(state.arm.bodies, position=np.repeat(tools.astype(np.float32)[:, None], count, axis=1))
    state, act, key = env.rearrange(state, there), make_act(env, "planner"), jax.random.key(0)
    start = np.asarray(state.command)
    state, _, key = act(None, state, key, np.arange(EPISODES) == 0)
    np.testing.assert_array_equal(np.asarray(state.command)[0], start[0])


def test_it_plans_again_when_a_body_has_moved_into_its_way(env: Env) -> None:
    state, key, act = begun(env), jax.random.key(0), Following(env)
    alone = np.arange(EPISODES) == 0
    state, _, key = act(None, state, key, alone)
    first, once = act._motions[0], act.planned()[0]
    assert first is not None
    state, _, key = act(None, state, key, alone)
    assert act._motions[0] is first
    ahead, _ = env.setup.robot.chain.tool_at(first.q[len(first.q) // 2])
    position = np.array(state.arm.bodies.position)
    position[0, -1] = ahead
    state = env.rearrange(state, replace(state.arm.bodies, position=position))
    act(None, state, key, alone)
    assert act._motions[0] is not first
    assert act.planned()[0] > once


def test_the_hybrid_moves_at_once_as_the_policy_does_and_then_by_the_motion(env: Env, policy: Policy) -> None:
    state, key, act = begun(env), jax.random.key(0), Hybrid(env)
    alone = np.arange(EPISODES) == 0
    expected, _, _ = make_act(env, "trained")(policy, state, key)
    state, _, key = act(policy, state, key, alone)
    np.testing.assert_allclose(state.command[0], expected.command[0], atol=1e-6)
    assert act.planned()[0] == 0.0
    act._leads[:] = False
    act(policy, state, key, alone)
    motion = act._motions[0]
    assert motion is not None
    np.testing.assert_allclose(motion.q[0], state.command[0], atol=1e-6)


def test_it_is_foreseen_where_the_policy_leads(env: Env, policy: Policy) -> None:
    foreseen, _ = jax.jit(make_ahead(env))(policy, begun(env))
    state, key, act = begun(env), jax.random.key(0), make_act(env, "trained")
    free, way = np.ones(EPISODES, bool), []
    for _ in range(100):
        state, _, key = act(policy, state, key)
        free &= ~np.asarray(state.arm.contact)
        way.append(np.asarray(state.arm.q))
    assert free.any()
    apart = np.abs(np.stack(way) - np.asarray(foreseen)[:100])[:, free]
    assert np.median(apart) < 0.005
    assert np.abs(way[-1] - way[0])[free].max() > 0.3


def test_the_planner_takes_over_where_the_policy_comes_no_nearer(
    env: Env, policy: Policy, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = evaluate(env, "trained", policy, seed=2, episodes=EPISODES)
    report = evaluate(env, "hybrid", policy, seed=2, episodes=EPISODES)
    assert report.success_rate == 1.0
    monkeypatch.setattr(Hybrid, "_soon", lambda _, __, ___, rows: rows[rows])
    hopeful = evaluate(env, "hybrid", policy, seed=2, episodes=EPISODES)
    assert hopeful.success_rate - alone.success_rate >= (0.0 if env.config.robot == "iiwa14" else 0.25)  # among balls


def test_links_do_not_meet_on_the_way_to_a_pose() -> None:
    env = Env(configure("pose", robot="ur5e", targets="any", randomise=()), 40)
    report = evaluate(env, "planner", seed=3, episodes=40)
    env.close()
    assert (report.success_rate, report.self_contact) == (1.0, 0.0)


def test_without_ompl_there_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl", None)
    with pytest.raises(InputError, match=r"^agent 'planner' needs OMPL: pip install .*\[planner\]'\.$"):
        make_act(Env(configure("clutter"), 1), "planner")


def test_without_joints_at_the_goal_there_is_one_sentence() -> None:
    with pytest.raises(InputError, match="a planner needs a goal whose joints are known"):
        make_act(Env(configure("precise"), 1), "planner")
