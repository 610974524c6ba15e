"""Agent `planner`: its paths are judged by MuJoCo's own contacts."""

from __future__ import annotations

import sys
from dataclasses import replace

import jax
import numpy as np
import pytest

from reachlab.agents.acting import make_act
from reachlab.agents.planner import Clearances, make_clearances, motion_along, plan
from reachlab.control.bodies import Bodies
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.evaluation.report import evaluate
from reachlab.robots.loading import load_robot
from reachlab.settings.validation import InputError
from reachlab.sims.simulator import make_simulator
from reachlab.tasks.task import Scene
from situations import begin

pytestmark = pytest.mark.slow

EPISODES = 8
"""Episodes with four obstacles each."""

POINTS = 200
"""Points of a path at which MuJoCo looks."""

Episode = tuple[Bodies, np.ndarray, np.ndarray]
"""Bodies `[1, K]`, start and goal `[n]`."""


@pytest.fixture(scope="module", params=["iiwa14", "ur5e"])
def env(request: pytest.FixtureRequest) -> Env:
    return Env(configure("clutter", robot=request.param, obstacles=(4, 4)), EPISODES)


@pytest.fixture(scope="module")
def clearances(env: Env) -> Clearances:
    return make_clearances(env.setup)


def begun(env: Env) -> EnvState:
    return env.init(env_keys(0, EPISODES))


def episodes(env: Env) -> list[Episode]:
    state = begun(env)
    start, goal = np.asarray(state.command), np.asarray(state.goal.joints)
    return [(jax.tree.map(lambda x, i=i: x[i : i + 1], state.arm.bodies), start[i], goal[i]) for i in range(EPISODES)]


def points_of(path: np.ndarray) -> np.ndarray:
    """Joints `[POINTS, n]` along a path."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    return np.stack([np.interp(np.linspace(0, along[-1], POINTS), along, joint) for joint in path.T], axis=1)


def touched(env: Env, obstacles: Bodies, q: np.ndarray) -> np.ndarray:
    """Whether MuJoCo finds a contact `[B]` of arms at `q [B, n]` among one scene's obstacles."""
    sim = make_simulator(
        "mujoco", env.setup.robot, env.config.physics, len(q), scene=Scene(obstacles.kind.shape[1], contacts=True)
    )
    scene = jax.tree.map(lambda x: np.repeat(np.asarray(x), len(q), axis=0), obstacles)
    state = sim.reset(None, begin(q.astype(np.float32), bodies=scene), None)
    sim.close()
    return np.asarray(state.contact)


def test_a_path_leads_from_start_to_goal_and_mujoco_finds_no_contact_on_it(env: Env, clearances: Clearances) -> None:
    straight = []
    for obstacles, start, goal in episodes(env):
        path = plan(env.setup, clearances, obstacles, start, goal)
        assert path is not None
        np.testing.assert_allclose(path[[0, -1]], [start, goal], atol=1e-6)
        assert not touched(env, obstacles, points_of(path)).any()
        straight.append(touched(env, obstacles, points_of(np.stack([start, goal]))).any())
    assert any(straight), "the obstacles are in the way of some"


def test_planning_again_gives_the_same_path(env: Env, clearances: Clearances) -> None:
    one, other = (plan(env.setup, clearances, *episodes(env)[0]) for _ in range(2))
    assert one is not None
    assert other is not None
    np.testing.assert_array_equal(one, other)


def test_a_goal_inside_an_obstacle_has_no_path(env: Env, clearances: Clearances) -> None:
    obstacles, start, goal = episodes(env)[0]
    tool, _ = env.setup.robot.chain.tool_at(goal)
    there = replace(obstacles, position=np.tile(tool.astype(np.float32), (1, 4, 1)))
    assert touched(env, there, goal[None]).all()
    assert plan(env.setup, clearances, there, start, goal) is None


def test_joints_follow_a_path_no_faster_than_they_may(env: Env) -> None:
    start = np.array(env.setup.robot.home)
    path = np.stack([start, start + 0.5, start + np.arange(len(start)) / 10])
    motion, most = motion_along(env.setup, path), np.array(env.setup.robot.speed) * env.setup.period
    np.testing.assert_allclose(start + motion.steps.sum(axis=0), path[-1], atol=1e-9)
    assert (np.abs(motion.steps) <= most + 1e-9).all()
    least = (np.abs(np.diff(path, axis=0)) / np.array(env.setup.robot.speed)).max(axis=1).sum()
    assert len(motion.steps) == pytest.approx(least / env.setup.period, abs=1)
    np.testing.assert_array_equal(motion.expected[0], start)


def test_the_agent_holds_its_goals(env: Env) -> None:
    report = evaluate(env, "planner", seed=2, episodes=EPISODES)
    assert report.agent == "planner"
    assert report.success_rate >= 1 - 1 / EPISODES
    share = np.array(report.max_joint_speed) / np.array(load_robot(report.robot).speed)
    assert share.max() < 1.5


def test_an_arm_whose_goal_cannot_be_reached_stays_where_it_is(env: Env) -> None:
    state = begun(env)
    tools = np.stack([env.setup.robot.chain.tool_at(q)[0] for q in np.asarray(state.goal.joints)])
    there = replace(state.arm.bodies, position=np.repeat(tools.astype(np.float32)[:, None], 4, axis=1))
    state, act, key = env.rearrange(state, there), make_act(env, "planner"), jax.random.key(0)
    start = np.asarray(state.command)
    for _ in range(3):
        state, _, key = act(None, state, key)
    np.testing.assert_array_equal(np.asarray(state.command), start)


def test_without_ompl_there_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl", None)
    with pytest.raises(InputError, match=r"^agent 'planner' needs OMPL: pip install .*\[planner\]'\.$"):
        make_act(Env(configure("clutter"), 1), "planner")


def test_without_obstacles_there_is_one_sentence() -> None:
    with pytest.raises(InputError, match="agent 'planner' needs bodies beside the arm"):
        make_act(Env(configure("precise"), 1), "planner")
