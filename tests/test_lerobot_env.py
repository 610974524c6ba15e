"""LeRobot's form of an environment; LeRobot itself is in `tests/lerobot`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import reachlab
from reachlab.cli.eval_subjects import is_model
from reachlab.deploy.lerobot_env import LeRobotVectorEnv
from reachlab.deploy.lerobot_units import motors_of
from reachlab.deploy.surroundings import step_arguments
from reachlab.envs.presets import configure
from reachlab.envs.setup import make_setup
from reachlab.lerobot import LeRobotPolicy, make_env
from reachlab.robots.catalogue import ROBOTS
from reachlab.settings.validation import InputError


@pytest.fixture
def env() -> Iterator[LeRobotVectorEnv]:
    made = make_env(3, robot="so101", max_steps=4)
    yield made
    made.close()


@pytest.mark.parametrize("task", ["tutorial", "lift"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_what_is_read_of_motors_commands_the_same_joints(robot: str, task: str) -> None:
    arm = make_setup(configure(task, robot=robot)).robot
    motors, low, high = motors_of(robot, arm), np.array(arm.commands.lower), np.array(arm.commands.upper)
    actuated = np.random.default_rng(0).uniform(low, high, (50, len(low)))
    assert np.allclose(motors.command(motors.read(actuated)), actuated, atol=1e-6)


def test_motors_of_an_so101_are_in_degrees_and_its_jaw_in_percent() -> None:
    arm = make_setup(configure("lift", robot="so101")).robot
    motors = motors_of("so101", arm)
    shown = motors.read(np.array([[0.1, 0.2, 0.3, 0.4, np.pi / 2, arm.commands.upper[-1]]]))[0]
    assert np.allclose(shown[:5], [5.7296, 11.4592, 17.1887, 22.9183, 90.0], atol=1e-3)
    assert 90 < shown[5] <= 100.0


def test_equal_seeds_give_the_goals_of_gymnasiums_environment(env: LeRobotVectorEnv) -> None:
    seen, _ = env.reset(seed=[5, 6, 7], options={"lerobot_new_rollout": True})
    single = gymnasium.make("reachlab:reachlab/Reach-v0", robot="so101")
    for row, seed in zip(seen["environment_state"], (5, 6, 7), strict=True):
        single.reset(seed=seed)
        state = single.unwrapped.state  # pyright: ignore[reportAttributeAccessIssue]
        assert np.array_equal(row[:3], np.asarray(state.goal.position)[0])


def test_a_motor_goes_where_it_is_sent_within_its_limits(env: LeRobotVectorEnv) -> None:
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    sent = seen["agent_pos"] + np.array([2.0, 0, 0, 0, 0, 0], np.float32)
    after = env.step(sent)[0]["agent_pos"]
    assert np.allclose(after, sent, atol=1e-3)
    sent[:, 0] = 1000.0
    for _ in range(2):
        after = env.step(sent)[0]["agent_pos"]
    assert (after[:, 0] <= 110.001).all()


def test_an_episode_ends_by_its_clock_and_a_reset_begins_others(env: LeRobotVectorEnv) -> None:
    seen, info = env.reset(seed=0)
    assert not info["is_success"].any()
    first = seen["environment_state"]
    for step in range(4):
        seen, reward, terminated, truncated, info = env.step(seen["agent_pos"])
        assert reward.shape == (3,)
        assert truncated.all() == (step == 3)
        assert not terminated.any()
        assert not info["is_success"].any()
    assert np.array_equal(seen["environment_state"], first)
    assert (env.reset()[0]["environment_state"] != first).any(axis=1).all()


def test_an_arm_that_is_sent_to_its_goal_succeeds_and_one_that_stays_does_not() -> None:
    env = make_env(2, task="precise", gravity_compensation=True)
    seen, _ = env.reset(seed=1)
    robot = make_setup(configure("precise")).robot
    home = jnp.array(robot.home)
    target = reachlab.forward_kinematics(robot.chain, home)._replace(position=jnp.array(seen["environment_state"][0]))
    solution = reachlab.inverse_kinematics(robot.chain, target, home, jax.random.key(0))
    assert solution.converged
    sent = np.stack([np.asarray(solution.q), seen["agent_pos"][1]])
    info = [env.step(sent)[-1] for _ in range(env.call("_max_episode_steps")[0])][-1]
    assert info["is_success"].tolist() == [True, False]
    env.close()
    for call in (env.reset, lambda: env.step(sent)):
        with pytest.raises(InputError, match="the environment is closed"):
            call()


def test_lerobots_rollouts_are_answered(env: LeRobotVectorEnv) -> None:
    env.reset(seed=0)
    assert env.call("_max_episode_steps") == (4, 4, 4)
    assert env.call("task_description")[0].startswith("touch a point")
    assert len(env.call("render")[:2]) == 2
    assert env.render()[0].shape == (480, 640, 3)
    with pytest.raises(AttributeError, match="'other' is none of"):
        env.call("other")


def test_cameras_and_their_size_are_chosen() -> None:
    env = make_env(2, cameras=["front", "observation"], size=84)
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    grey = seen["pixels"]["observation"]
    assert grey.shape == (2, 84, 84, 3)
    assert (grey[..., 0] == grey[..., 2]).all()
    assert (seen["pixels"]["front"][..., 0] != seen["pixels"]["front"][..., 2]).any()
    env.close()


def test_views_vary_of_cameras_though_the_policy_gets_no_picture() -> None:
    pictures = []
    for randomise in ((), ("view",)):
        env = make_env(1, cameras=["front"], size=48, randomise=randomise)
        pictures.append(env.reset(seed=0)[0]["pixels"]["front"])
        env.close()
    assert (pictures[0] != pictures[1]).mean() > 0.1


def test_a_configuration_of_lerobot_names_the_task() -> None:
    make_env(cfg=SimpleNamespace(), randomise=None).close()  # one that names none
    env = make_env(cfg=SimpleNamespace(task="pose"))
    assert env.call("task") == ("pose",)
    assert env.single_observation_space["environment_state"].shape == (7,)  # pyright: ignore[reportIndexIssue]
    env.close()


def test_wrong_input_is_refused_in_a_sentence(env: LeRobotVectorEnv, tmp_path: Path) -> None:
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"task": "precis"}, "task 'precis' is not one of"),
        ({"task": str(tmp_path)}, "cannot be read as what `reachlab export` wrote"),
        ({"cameras": ["back"]}, "camera 'back' is not one of"),
        ({"robott": "panda"}, "'robott' does not exist"),
        ({"n_envs": 0}, "num_envs"),
        ({"cameras": ["front"], "size": 0}, "size must be a whole number from 16 to 512, got 0"),
        ({"task": None}, "task must be the name of a task or a folder of an export, got None"),
    )
    for settings, sentence in wrong:
        with pytest.raises(InputError, match=sentence):
            make_env(**settings)
    with pytest.raises(InputError, match=r"action must have shape \(6,\)"):
        env.step(np.zeros((3, 5), np.float32))


def test_what_is_asked_is_told_to_a_controller_by_name() -> None:
    facts = {"goal": {"orientation": True, "moves": True}, "objects": [6]}
    bodies = [[0.1, 0.2, 0.3, 1, 0, 0, 0, 0, 0, 0, 0.05, 0, 0, 0], [0, 0, -10.0, 1, *[0] * 10], [0.4, *[0] * 13]]
    asked = step_arguments(facts, np.concatenate([np.arange(10.0), *bodies]))
    assert asked["goal"] == [*range(7)]
    assert asked["velocity"] == [7, 8, 9]
    assert [body["radius"] for body in asked["obstacles"]] == [0.05]
    assert [body["position"][0] for body in asked["objects"]] == [0.4]
    with pytest.raises(InputError, match="asks for other goals"):
        step_arguments(facts, np.zeros(11))


def test_a_policy_of_lerobot_is_known_by_its_files_and_needs_lerobot(tmp_path: Path) -> None:
    assert not is_model(tmp_path)
    (tmp_path / "policy_preprocessor.json").touch()
    assert is_model(tmp_path)
    with pytest.raises(InputError, match="run the command where LeRobot is installed"):
        LeRobotPolicy(tmp_path)
