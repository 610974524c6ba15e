"""Targets that a person puts somewhere: `reset(options={"target": ...})`."""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np
import pytest

from reachlab.envs.gymnasium_single import ReachEnv
from reachlab.robots.loading import load_robot
from reachlab.robots.shapes.clearance import capsules_at
from reachlab.settings.validation import InputError
from reachlab.tasks import TASKS
from reachlab.tasks.scenes.balls import clearances

HIGH = [0.5, 0.1, 0.35]
"""In the box of every task but the tutorial's [m]."""

REFUSED: dict[str, tuple[Any, str]] = {
    "too short": ([0.5, 0.1], r"target must be 3 finite numbers \[m\], got \[0.5, 0.1\]"),
    "a pose": ([0.5, 0.1, 0.35, 1, 0, 0, 0], "target must be 3 finite numbers"),
    "not a number": ([0.5, np.nan, 0.35], "target must be 3 finite numbers"),
    "words": ("here", "target must be 3 finite numbers"),
    "nothing": (None, "target must be 3 finite numbers"),
    "outside": ([0.5, 0.1, 0.7], r"outside the box of the task's goals, \(0.3, -0.4, 0.1\) to \(0.7, 0.4, 0.6\) m"),
}


@functools.cache
def made(task: str, sim: str) -> ReachEnv:
    return ReachEnv(task=task, sim=sim)


@pytest.fixture(scope="module")
def precise() -> ReachEnv:
    return made("precise", "kinematic")


def target_of(env: ReachEnv) -> np.ndarray:
    return np.asarray(env.state.goal.position)[0]


PLACED = [task for task in TASKS if task not in ("pose", "clutter", "clutter_pose") and not TASKS[task].load()().mounts]
TRIED = [*((task, "kinematic") for task in PLACED), ("tutorial", "mujoco")]


@pytest.mark.parametrize(("task", "sim"), TRIED)
def test_a_target_is_where_it_was_put_until_the_next_reset(task: str, sim: str) -> None:
    env = made(task, sim)
    low, high = env.target_box
    wanted = low + 0.75 * (high - low)
    _, info = env.reset(seed=0, options={"target": wanted})
    assert target_of(env) == pytest.approx(wanted, abs=2e-4)
    assert info["distance"] == pytest.approx(
        np.linalg.norm(np.asarray(env.state.arm.tool_position)[0] - wanted), abs=2e-4
    )
    for _ in range(3):
        env.step(np.ones(env.action_space.shape or (), np.float32))
    assert target_of(env) == pytest.approx(wanted, abs=2e-4), "it stays, in `track` too"
    env.reset()
    assert np.linalg.norm(target_of(env) - wanted) > 0.01


@pytest.mark.slow
def test_a_pose_is_put_with_its_orientation_and_refused_where_the_arm_has_none() -> None:
    env = ReachEnv(task="pose")
    env.reset(seed=3)
    drawn = env.state.goal
    assert drawn.quaternion is not None
    pose = np.concatenate([np.asarray(drawn.position)[0], np.asarray(drawn.quaternion)[0]])
    observation, info = env.reset(seed=8)
    assert env.reset(seed=8, options={"target": pose})[1]["distance"] != info["distance"]
    put = env.state.goal
    assert put.quaternion is not None
    assert target_of(env) == pytest.approx(pose[:3], abs=2e-4)
    assert abs(np.asarray(put.quaternion)[0] @ pose[3:]) == pytest.approx(1, abs=1e-4)
    # Down through its own base, from the corner that is farthest away.
    with pytest.raises(InputError, match="the arm has no joints for target"):
        env.reset(options={"target": [0.7, 0.4, 0.6, *np.array([1, 0, -1, 0]) / np.sqrt(2)]})
    with pytest.raises(InputError, match="7 finite numbers, a position"):
        env.reset(options={"target": pose[:3]})
    with pytest.raises(InputError, match="7 finite numbers, a position"):
        env.reset(options={"target": [*pose[:3], 0, 0, 0, 0]})
    assert np.array_equal(env.reset(seed=8)[0], observation)


@pytest.mark.parametrize(("target", "sentence"), REFUSED.values(), ids=REFUSED)
def test_a_wrong_target_is_refused_and_the_episode_continues(precise: ReachEnv, target: Any, sentence: str) -> None:
    precise.reset(seed=1, options={"target": HIGH})
    precise.step(np.ones(precise.action_space.shape or (), np.float32))
    before = precise.state
    with pytest.raises(InputError, match=sentence) as refused:
        precise.reset(options={"target": target})
    assert "\n" not in str(refused.value)
    assert np.array_equal(precise.state.arm.q, before.arm.q)
    assert target_of(precise) == pytest.approx(HIGH)


def test_an_unknown_option_is_refused(precise: ReachEnv) -> None:
    with pytest.raises(InputError, match=r"option of reset 'targets' is not one of: target\. Did you mean 'target'"):
        precise.reset(options={"targets": HIGH})


@pytest.mark.slow
def test_obstacles_leave_the_way_to_a_target_that_was_put() -> None:
    env = ReachEnv(task="clutter", obstacles=(4, 4))
    for seed in range(3):
        env.reset(seed=seed, options={"target": HIGH})
        assert target_of(env) == pytest.approx(HIGH, abs=2e-4)
        goal, obstacles = env.state.goal, env.state.arm.bodies
        assert goal.joints is not None
        assert obstacles is not None
        assert obstacles.present.any()
        here = jax.tree.map(lambda rows: rows[0], obstacles)
        robot = load_robot("iiwa14", "flange")
        assert (clearances(robot.capsules, capsules_at(robot.chain, robot.capsules, goal.joints), here) > 0).all()
