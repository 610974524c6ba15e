"""Imitation of planned ways: what is learnt from one, and a training by it."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.agents.acting import make_act
from reachlab.control import dampers
from reachlab.control.contact_model import arm_of
from reachlab.control.planning.collision import CollisionChecker
from reachlab.control.planning.planner import CLEAR
from reachlab.deploy.onnx_network import OnnxNetwork
from reachlab.deploy.weights import onnx_model
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.learn.imitation import FRESH
from reachlab.learn.learner import make_initial_policy
from reachlab.learn.planned import APART, ASIDE, BACK, BESIDE, FIRST, LESSONS, Teacher
from reachlab.learn.train import train
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.settings.validation import InputError
from reachlab.tasks.actions import AHEAD, command
from reachlab.tasks.body_terms import ROW

pytestmark = pytest.mark.usefixtures("few_scenes")


def furnished(count: int, **settings: Any) -> Env:
    settings = {"robot": "panda", "scene": ("wall",), "action": "heading", "num_envs": count} | settings
    return Env(configure("clutter", **settings), count)


def teacher_of(env: Env) -> Teacher:
    setup = env.setup
    arm = arm_of(setup.robot, setup.lag, setup.period)
    return Teacher(setup.robot, arm, setup.task.scene(setup).bodies)


def test_headings_lead_along_planned_ways_there_and_back() -> None:
    env = furnished(4)
    teacher = teacher_of(env)
    for start, goal, bodies in teacher.fresh("wall", 4, seed=1):
        there, back = teacher.lessons(bodies, start, goal, np.random.default_rng(0))
        for lesson, ends in ((there, (start, goal)), (back, (goal, start))):
            assert lesson.q.shape == lesson.heading.shape == (LESSONS, len(start))
            np.testing.assert_allclose(lesson.q[0], ends[0], atol=1e-6)
            np.testing.assert_allclose(lesson.joints, ends[1], atol=1e-6)
            assert (np.linalg.norm(lesson.q[: LESSONS // 2 : 2] - ends[0], axis=1) < FIRST + 1e-6).all()
            tool = forward_kinematics(env.setup.robot.chain, jnp.asarray(lesson.joints)[None]).position[0]
            np.testing.assert_allclose(lesson.position, tool, atol=1e-4)
            assert (np.linalg.norm(lesson.heading, axis=1) < 1 + 6 * ASIDE * np.sqrt(len(start)) / AHEAD).all()
        assert not list(teacher.lessons(bodies, goal, goal, np.random.default_rng(0)))
    env.close()


def test_an_arm_that_stands_too_near_to_something_is_told_to_go_back_first() -> None:
    env = furnished(4, scene=("shelf",))
    setup, teacher, rng = env.setup, teacher_of(env), np.random.default_rng(0)
    checker = CollisionChecker(arm_of(setup.robot, setup.lag, setup.period), setup.task.scene(setup).bodies)
    asked, taught = np.array((CLEAR * setup.robot.scale, APART)), 0
    for start, goal, bodies in teacher.fresh("shelf", 4, seed=1):
        checker.place(bodies)
        ways = rng.normal(size=(200, len(start)))
        beside = start + rng.uniform(0.1, 0.6, (200, 1)) * ways / np.linalg.norm(ways, axis=1, keepdims=True)
        near = [q for q in beside if 0.002 < checker.distances(q)[0] < asked[0] / 2 and checker.distances(q)[1] > APART]
        for stood in near[:2]:
            for lesson in itertools.islice(teacher.lessons(bodies, stood, goal, rng), 1):
                taught += 1
                checker.keep(*np.minimum(asked, np.array(checker.distances(goal)) - 1e-3))
                assert not checker.free(stood)
                first, *later = lesson.q[: LESSONS // 2]
                np.testing.assert_allclose(first, stood, atol=1e-6)
                assert all(checker.free(q) for q in later if np.linalg.norm(q - stood) > BACK[-1])
    assert taught > 2
    env.close()


def test_joints_beside_a_goal_are_free_and_near_it_and_the_way_to_it_is_not_straight() -> None:
    env = furnished(4, scene=("shelf",))
    setup, teacher, found, taught = env.setup, teacher_of(env), 0, 0
    checker = CollisionChecker(arm_of(setup.robot, setup.lag, setup.period), setup.task.scene(setup).bodies)
    for _, goal, bodies in teacher.fresh("shelf", 4, seed=1):
        rng = np.random.default_rng(0)
        if (q := teacher.beside(bodies, goal, rng)) is None:
            continue
        found += 1
        checker.place(bodies)
        least = np.minimum((CLEAR * setup.robot.scale, APART), checker.distances(goal)) - 1e-6
        checker.keep(*least.tolist())
        assert checker.free(q)
        assert not checker.straight(q, goal.astype(float))
        assert BESIDE[0] - 1e-5 < np.linalg.norm(q - goal) < BESIDE[1] + 1e-5
        taught += len(list(teacher.lessons(bodies, q, goal, rng)))
    assert found > 1
    assert taught > 1
    env.close()


def test_a_heading_near_the_goal_is_followed_where_it_does_not_lead_there() -> None:
    env = furnished(8)
    now = env.situation(env.init(env_keys(0, 8)))
    there, across = np.eye(now.q.shape[1])[-2:]
    for left, heading, wanted, other in (
        (0.2, there, there, across),
        (0.2, across, across, there),
        (0.03, across, there, across),
        (0.15, -0.1 * there, there, across),
    ):
        aimed = now._replace(goal=replace(now.goal, joints=now.q + left * there))
        moved = command(env.setup, aimed, jnp.tile(heading, (8, 1)).astype(jnp.float32)) - now.command
        assert (moved @ wanted > jnp.maximum(2 * jnp.abs(moved @ other), 1e-3)).all()
    env.close()


def test_fresh_scenes_are_in_no_bank() -> None:
    env = furnished(4)
    known = {row.tobytes() for row in env.setup.prepared.joints[:, 0]}
    assert not known & {goal.tobytes() for _, goal, _ in teacher_of(env).fresh("wall", 4, seed=1)}
    env.close()


@pytest.mark.parametrize("late", [0.0, 0.03])
def test_an_arm_between_bodies_keeps_clear_of_those_that_are_not_the_nearest_and_where_it_lags(late: float) -> None:
    env = furnished(8, scene=("shelf",))
    now = env.situation(env.init(env_keys(0, 8)))
    towards = jnp.sign(now.goal.joints - now.q)
    now = now._replace(command=now.command + late * towards)
    moved = dampers.hemmed(env.setup, now, 0.05 * towards)
    stop, n = dampers.CLOSE * env.setup.robot.scale, now.q.shape[1]
    for body in range(now.bodies.kind.shape[1]):
        one = jax.tree.map(lambda x, body=body: x[:, body : body + 1], now.bodies)
        for q, rate, way in (
            (now.command[:, :n], dampers.RATE_AMONG, moved),
            (now.q, 1.0, now.command[:, :n] - now.q + moved),
        ):
            around = dampers.surroundings(env.setup.robot, q, one)
            change = (dampers.approach(env.setup.robot, q, around) * way.T).sum(axis=1)
            assert (change > -rate * (around.distance - stop) - 5e-3).all()
    env.close()


def test_links_of_an_arm_between_bodies_do_not_meet() -> None:
    env = furnished(8)
    now = env.situation(env.init(env_keys(0, 8)))
    gap, gradient = dampers.apart(env.setup.robot, now.q, dampers.OWN)
    step = -gap[:, None] * gradient / jnp.square(gradient).sum(axis=1, keepdims=True)  # all of the way
    asked, moved = ((gradient * way).sum(axis=1) for way in (step, dampers.hemmed(env.setup, now, step)))
    allowed = -dampers.RATE_AMONG * gap
    assert (gap > 0.005).all()
    assert (asked < allowed - 3e-3).all()
    assert (moved > allowed - 1e-3).all()
    env.close()


def test_a_policy_of_ways_takes_bodies_in_any_number_and_order_and_is_the_same_in_onnx(tmp_path: Path) -> None:
    walls, shelves = furnished(4), furnished(4, scene=("shelf",))
    policy = make_initial_policy(configure("clutter", action="heading"), walls, jax.random.key(0))
    policy = replace(policy, parameters=jax.tree.map(lambda x: 3 * x, policy.parameters))
    state = shelves.init(env_keys(0, 4))
    seen = np.asarray(shelves.observe(state, None))
    rows = shelves.schema.rows(seen)
    assert rows.shape[1:] == (shelves.setup.task.scene(shelves.setup).bodies, ROW)
    shuffled = np.concatenate([seen[:, : shelves.schema.vector_size], rows[:, ::-1].reshape(4, -1)], axis=1)
    action = policy.act(seen)
    assert np.ptp(action) > 0.05
    np.testing.assert_allclose(policy.act(shuffled), action, atol=1e-6)
    moved, _, _ = make_act(shelves, "trained")(policy, state, jax.random.key(0))
    np.testing.assert_allclose(moved.last_action, action, atol=1e-5)
    file = tmp_path / "policy.onnx"
    file.write_bytes(onnx_model(policy, walls.action_bounds, clips=True).SerializeToString())
    few = np.asarray(walls.observe(walls.init(env_keys(1, 4)), None))
    np.testing.assert_allclose(OnnxNetwork(file).act(few), np.clip(policy.act(few), -1, 1), atol=1e-5)
    walls.close()
    shelves.close()


def test_a_training_plans_and_comes_nearer_to_what_was_planned(tmp_path: Path) -> None:
    settings = {"robot": "panda", "scene": ("wall",), "action": "heading", "hidden": (64, 64), "seed": 1}
    rest = {"num_envs": 4, "rollout_steps": 5, "total_steps": 40, "anneal_steps": 40, "report_episodes": 4}
    config = configure("clutter", **settings, **rest)
    result = train(config, tmp_path / "run", base=config)
    rows = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert [row["plans"] > 2 * FRESH * (count + 1) for count, row in enumerate(rows)] == [True, True]
    assert rows[1]["heading_error"] < rows[0]["heading_error"]
    np.testing.assert_allclose(np.exp(result.policy.parameters.log_std), config.learner.initial_std, rtol=1e-6)
    assert result.report.episodes == 4


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"observation": "clutter"}, "choose --observation ways"),
        ({"memory": 16}, "and no --memory"),
        ({"scene": ("balls",)}, "among furniture"),
    ],
)
def test_what_cannot_be_imitated_is_refused_in_a_sentence(
    changed: dict[str, Any], sentence: str, tmp_path: Path
) -> None:
    config = configure("clutter", robot="panda", action="heading", num_envs=4, **{"scene": ("wall",)} | changed)
    with pytest.raises(InputError, match=sentence):
        train(config, tmp_path / "run", base=config)
    assert not (tmp_path / "run").exists()


def test_what_is_planned_is_shared_with_no_worker(tmp_path: Path) -> None:
    config = configure("clutter", robot="panda", action="heading", num_envs=4, scene=("wall",))
    with pytest.raises(InputError, match="is planned on all cores here, and shared with no worker: leave --workers"):
        train(config, tmp_path / "run", base=config, collect=lambda *_: pytest.fail("collected"))
    assert not (tmp_path / "run").exists()
