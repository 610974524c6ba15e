"""Policies that say where in a picture goal and object are, on which the task's controller acts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from reachlab.agents.encoder import CELL, Keypoints, middles
from reachlab.agents.policy import make_policy
from reachlab.deploy.onnx_network import OnnxNetwork
from reachlab.deploy.weights import onnx_model
from reachlab.envs.consistency import check
from reachlab.envs.core import Env
from reachlab.envs.presets import configure, distillation
from reachlab.envs.random_streams import env_keys
from reachlab.envs.setup import make_setup
from reachlab.evaluation.report import evaluate
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.loading import load_robot
from reachlab.settings.validation import InputError
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.camera import in_picture, on_table
from reachlab.tasks.schema import SIZE

SETTINGS = {"observation": "image", "action": "picture_points", "randomise": ()}


@pytest.mark.parametrize("name", ROBOTS)
def test_every_place_of_a_goal_is_in_the_picture(name: str) -> None:
    setup = make_setup(configure("push", robot=name))
    low, high = setup.task.goal_box(setup)
    points = np.random.default_rng(0).uniform(low, high, (100, 3)).astype(np.float32)
    points[:, 2] = setup.robot.table_top
    points[:4, :2] = [[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])]
    seen = in_picture(setup.robot, jnp.asarray(points))
    assert np.abs(seen).max() < 0.99
    assert np.asarray(on_table(setup.robot, seen)) == pytest.approx(points, abs=1e-4)


def test_every_place_of_a_picture_is_one_of_the_table() -> None:
    robot = load_robot("panda")
    places = jnp.array([[0.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [0.0, 0.4]])
    points = np.asarray(on_table(robot, places))
    low, high = np.array(robot.workspace)
    assert (points[:, :2] >= low[:2] - 1e-6).all()
    assert (points[:, :2] <= high[:2] + 1e-6).all()
    assert points[:, 2] == pytest.approx(robot.table_top)


def spots(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pictures with a dark and a bright spot on noise, and where these are `[count, 4]`."""
    random = np.random.default_rng(0)
    pictures = random.integers(90, 110, (count, SIZE, SIZE)).astype(np.uint8)
    places = random.integers(6, SIZE - 6, (count, 2, 2))
    for picture, spot in zip(pictures, places, strict=True):
        for (row, column), grey in zip(spot, (0, 255), strict=True):
            picture[row - 2 : row + 3, column - 2 : column + 3] = grey
    away = (2 * places + 1) / SIZE - 1
    return pictures, np.stack([away[..., 1], -away[..., 0]], axis=-1).reshape(count, 4)


def test_keypoints_are_learnt_to_a_fraction_of_a_cell() -> None:
    pictures, places = spots(32)
    encoder, optimiser = Keypoints.make(jax.random.key(0), 2), optax.adam(5e-3)

    @jax.jit
    def learn(encoder: Keypoints, state: optax.OptState) -> tuple[Keypoints, optax.OptState]:
        gradient = jax.grad(lambda one: one.loss(jnp.asarray(pictures), jnp.asarray(places)))(encoder)
        change, state = optimiser.update(gradient, state)
        return jax.tree.map(jnp.add, encoder, change), state

    def off(encoder: Keypoints) -> float:
        return float(np.abs(np.asarray(encoder(jnp.asarray(pictures))) - places).mean() * SIZE / 2)

    before, state = off(encoder), optimiser.init(encoder)  # pyright: ignore[reportArgumentType]
    for _ in range(120):
        encoder, state = learn(encoder, state)
    assert before > 10
    assert off(encoder) < 1.0


def test_the_middles_of_cells_go_right_and_down() -> None:
    every = np.asarray(middles(SIZE))
    assert every[0] == pytest.approx([CELL / SIZE - 1, 1 - CELL / SIZE])
    assert every[1] - every[0] == pytest.approx([2 * CELL / SIZE, 0])
    assert every[-1] == pytest.approx(-every[0])


def test_the_network_is_the_same_in_onnx(tmp_path: Path) -> None:
    env = Env(configure("push", robot="panda", **SETTINGS), 1)
    policy = make_policy(jax.random.key(1), env.schema, env.action_bounds, (), 0.3, points=2)
    loud = jax.tree.map(lambda x: 5 * x, policy.parameters)  # an untrained one sees each point everywhere
    policy = replace(policy, parameters=loud)
    file = tmp_path / "policy.onnx"
    file.write_bytes(onnx_model(policy, env.action_bounds, clips=True).SerializeToString())
    pictures, _ = spots(5)
    expected = np.asarray(policy.act(jnp.asarray(pictures)))
    assert np.ptp(expected) > 0.05
    assert OnnxNetwork(file).act(pictures) == pytest.approx(expected, abs=1e-5)


def test_the_script_pushes_by_the_points_alone() -> None:
    env = Env(configure("push", robot="panda", **SETTINGS), 20)
    state = env.init(env_keys(0, 20))
    now = env.situation(state)
    points = ACTIONS["picture_points"].towards(env.setup, now, now)
    command = ACTIONS["picture_points"].command(env.setup, now, points)
    # It goes by the action, and by nothing that the picture is there to show.
    blind = now._replace(
        goal=replace(now.goal, position=now.goal.position + 1.0),
        bodies=replace(now.bodies, position=now.bodies.position - 1.0),
    )
    assert np.array_equal(command, ACTIONS["picture_points"].command(env.setup, blind, points))
    assert evaluate(env, "ik", seed=6000, episodes=20).success_rate == 1.0


@pytest.mark.parametrize(("task", "observation"), [("push", "push"), ("lift", "image"), ("tutorial", "image")])
def test_it_needs_a_picture_and_a_task_on_the_table(task: str, observation: str) -> None:
    with pytest.raises(InputError, match="action 'picture_points' needs"):
        check(configure(task, observation=observation, action="picture_points"))


def test_a_student_of_push_points_and_others_act() -> None:
    assert distillation("run", configure("push", robot="panda")).rules.action == "picture_points"
    assert distillation("run", configure("push", robot="panda")).learner.hidden == ()
    assert distillation("run", configure("lift", robot="panda")).rules.action == "joint_delta"
    assert distillation("run", configure("tutorial")).rules.action == "tool_delta"
    assert distillation("run", configure("push", robot="panda"), action="joint_delta").learner.hidden
