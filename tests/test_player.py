"""Episodes in real time, with a target that a person moves."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reachlab.agents import AGENTS
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM
from reachlab.envs.setup import make_setup
from reachlab.evaluation.episodes import make_runner, run_episodes
from reachlab.learn.learner import make_initial_policy
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.watch.moment import TRAIL_STEP
from reachlab.watch.player import LATE, LEFT, Player

FAR, NEAR = np.array([0.6, 0.2, -0.0083]), np.array([0.4, -0.2, -0.0083])


@functools.cache
def made(task: str, **settings: Any) -> Player:
    return Player(Env(configure(task, **settings), 1), seed=0)


def player_of(task: str, **settings: Any) -> Player:
    """A player as it begins; its programs are those of any other with these settings."""
    player = made(task, **settings)
    player.follow(False)
    player.steps = player.episodes = player.successes = 0
    player.begin(0)
    return player


def player_in(sim: str) -> Player:
    return player_of("tutorial", sim=sim)


def player_under_dynamics(task: str) -> Player:
    """Of a task under full dynamics; a goal that moves goes round in circles."""
    return player_of(task, randomise=(), **({"goal_paths": ("circle",)} if task == "track" else {}))


@pytest.fixture(params=["kinematic", "mujoco"])
def player(request: pytest.FixtureRequest) -> Player:
    return player_in(request.param)


def play(player: Player, steps: int = 1000) -> None:
    for _ in range(steps):
        if not player.over:
            player.step("ik", None)


def test_an_episode_is_played_to_its_success(player: Player) -> None:
    play(player)
    assert (player.over, player.moment.reached) == (True, True)
    assert (player.episodes, player.successes) == (1, 1)
    assert player.moment.distance == pytest.approx(np.linalg.norm(player.moment.tool - player.moment.target), abs=1e-6)


def test_a_new_episode_has_a_new_target_and_begins_at_home(player: Player) -> None:
    before = player.moment
    play(player)
    player.proceed()
    assert not np.allclose(before.target, player.moment.target)
    np.testing.assert_allclose(player.moment.q, before.q)
    assert (player.over, player.moment.reached) == (False, False)


def test_the_arm_follows_a_target_that_is_moved(player: Player) -> None:
    player.follow(True)
    for target in (FAR, NEAR):
        player.move_target(target)
        play(player, 500)
        np.testing.assert_allclose(player.moment.target, target, atol=1e-6)
        assert np.linalg.norm(player.moment.tool - target) < 0.1


def test_the_arm_rests_where_it_came_within_the_success_distance_until_the_target_moves_on() -> None:
    player = player_in("kinematic")
    player.follow(True)
    play(player, 400)
    assert player.moment.reached
    before = player.moment
    play(player, 100)
    np.testing.assert_array_equal(player.moment.q, before.q)
    player.move_target(before.target + 0.02 * (before.tool - before.target) / before.distance)
    assert player.moment.reached, "it is near enough still"
    play(player, 1)
    np.testing.assert_array_equal(player.moment.q, before.q)
    player.move_target(FAR if before.target[1] < 0 else NEAR)
    assert not player.moment.reached, "reached means now"
    play(player, 1)
    assert not np.array_equal(player.moment.q, before.q)


class Falling:
    """Stands for a policy that goes down whatever it sees."""

    schema = OBSERVATIONS["target+tool"].schema(make_setup(configure()))

    def decide(self, observation: jax.Array, memory: None) -> tuple[jax.Array, None]:
        return jnp.broadcast_to(jnp.array([0.0, 0.0, -0.6]), (*observation.shape[:-1], 3)), memory


jax.tree_util.register_pytree_node(Falling, lambda _: ((), None), lambda *_: Falling())


def test_an_arm_that_leaves_its_workspace_begins_again_at_home_with_the_same_target() -> None:
    player = player_in("kinematic")
    home = player.moment.q
    player.follow(True)
    player.move_target(NEAR)
    for _ in range(300):
        if not player.over:
            player.step("trained", Falling())  # type: ignore[arg-type] (a policy in all that is asked of it)
    assert (player.over, player.failed, player.moment.reached) == (True, LEFT, False)
    player.move_target(FAR)
    assert player.over, "it does not continue from outside"
    player.proceed()
    assert (player.over, player.failed) == (False, "")
    np.testing.assert_allclose(player.moment.q, home)
    np.testing.assert_allclose(player.moment.target, FAR, atol=1e-6)
    play(player)
    assert player.moment.reached


def test_an_arm_that_never_arrives_begins_again_once_the_time_of_an_episode_is_over() -> None:
    player = player_in("kinematic")
    player.move_target(FAR)
    for _ in range(2):
        np.testing.assert_allclose(player.moment.target, FAR, atol=1e-6)
        for _ in range(1000):
            player.step("zero", None)
        assert (player.over, player.failed) == (True, LATE)
        player.proceed()
    assert not np.allclose(player.moment.target, FAR, atol=1e-3), "one that nobody holds is tried from home once"


def test_the_episodes_are_those_of_the_evaluation() -> None:
    player = player_in("kinematic")
    evaluated = run_episodes(make_runner(Env(configure(), 3), "ik"), None, 0, REPORT_STREAM, 3)
    for number in range(3):
        np.testing.assert_allclose(player.moment.target, evaluated.goal[number], atol=1e-6)
        play(player)
        assert player.clock == evaluated.steps[number]
        player.proceed()


def test_no_episode_ends_while_the_target_is_held() -> None:
    player = player_in("kinematic")
    player.follow(True)
    play(player, 1200)
    assert player.steps == 1200
    assert (player.over, player.moment.reached, player.episodes) == (False, True, 0)


def test_a_target_that_is_let_go_has_all_the_time_of_an_episode() -> None:
    player = player_in("kinematic")
    for _ in range(900):
        player.step("zero", None)
    player.move_target(FAR)
    for _ in range(999):
        player.step("zero", None)
    assert not player.over
    player.step("zero", None)
    assert player.over


def test_an_episode_whose_target_was_moved_does_not_count() -> None:
    player = player_in("kinematic")
    player.move_target(FAR)
    play(player)
    assert player.over
    assert (player.episodes, player.successes) == (0, 0)
    player.proceed()
    play(player)
    assert (player.episodes, player.successes) == (1, 1)


def test_an_end_is_taken_back_when_the_target_is_held_or_moved() -> None:
    player = player_in("kinematic")
    play(player)
    player.follow(True)
    assert not player.over
    player.follow(False)
    play(player)
    player.move_target(FAR)
    assert not player.over


def test_under_full_dynamics_the_arm_holds_millimetres_where_the_target_is_moved() -> None:
    player = player_under_dynamics("precise")
    play(player)
    assert player.over
    player.move_target(np.array([0.5, 0.2, 0.4]))
    assert (player.over, player.moment.reached) == (False, False)
    play(player)
    assert player.moment.reached
    assert player.moment.distance < 0.01


@pytest.mark.parametrize("agent", sorted(AGENTS.keys() - {"trained", "planner", "hybrid", "ik", "zero"}))
def test_every_agent_plays(agent: str) -> None:
    player = player_in("kinematic")
    player.step(agent, None)
    assert player.steps == 1


def test_the_box_of_targets_is_flat_in_the_tutorial() -> None:
    setup = make_setup(configure())
    low, high = setup.task.goal_box(setup)
    np.testing.assert_allclose([low[:2], high[:2]], np.array(setup.robot.workspace)[:, :2], atol=0.02)
    assert low[2] == high[2] == np.float32(setup.rules.target_height)


def test_a_policy_that_knows_home_alone_goes_back_there_on_its_way_before_it_follows() -> None:
    player = player_in("kinematic")
    policy = make_initial_policy(configure(), player._env, jax.random.key(0))
    home, places = player.moment.q, []
    player.follow(True)
    for _ in range(30):
        player.step("trained", policy)
        places.append(player.moment.q)
    player.move_target(FAR)
    for place in [*places[-2::-1], home]:
        player.step("trained", policy)
        np.testing.assert_allclose(player.moment.q, place, atol=1e-5)
    player.step("trained", policy)
    assert player.clock == 1, "with all the time of an episode"
    np.testing.assert_allclose(player.moment.q, places[0], atol=0.05)


# --- a target that is turned ----------------------------------------------------------------------


def turned(quaternion: np.ndarray, *degrees: float) -> np.ndarray:
    """An orientation, wxyz, turned by roll, pitch and yaw."""
    turn = Rotation.from_euler("xyz", degrees, degrees=True)
    return (turn * Rotation.from_quat(quaternion, scalar_first=True)).as_quat(scalar_first=True)


def angle(one: np.ndarray, other: np.ndarray) -> float:
    """Between orientations, wxyz [rad]."""
    a, b = (Rotation.from_quat(quaternion, scalar_first=True) for quaternion in (one, other))
    return float((a.inv() * b).magnitude())


@pytest.fixture
def poses() -> Player:
    return player_under_dynamics("pose")


def test_a_target_that_is_moved_and_turned_by_hand_is_reached(poses: Player) -> None:
    for place, by in (([0.5, 0.1, 0.45], (20, 0, 60)), ([0.45, -0.2, 0.5], (0, -15, -90))):
        poses.begin(0)
        assert poses.moment.target_orientation is not None
        wanted = turned(poses.moment.target_orientation, *by)
        assert poses.move_target(np.array(place), wanted)
        assert not poses.moment.reached
        play(poses)
        assert poses.moment.reached
        assert np.linalg.norm(poses.moment.tool - place) < 0.002
        assert angle(np.asarray(poses.state.arm.tool_quaternion)[0], wanted) < 0.02
        assert poses.moment.angle == pytest.approx(
            angle(np.asarray(poses.state.arm.tool_quaternion)[0], poses.moment.target_orientation), abs=1e-3
        )


def test_a_target_at_which_the_arm_would_touch_the_table_stays_where_it_is(poses: Player) -> None:
    assert poses.moment.target_orientation is not None
    held, before = turned(poses.moment.target_orientation, 0, 0, 0), poses.moment.target
    assert not poses.move_target(np.array([0.45, 0.0, -0.02]), np.array(poses._env.setup.robot.held_quaternion))
    np.testing.assert_array_equal(poses.moment.target, before)
    assert poses.move_target(np.array([0.45, 0.0, 0.4]), held)


def test_the_arm_stays_near_its_joints_when_the_target_is_turned_a_little(poses: Player) -> None:
    play(poses)
    for _ in range(20):
        before = poses.moment.q
        assert poses.moment.target_orientation is not None
        assert poses.move_target(poses.moment.target, turned(poses.moment.target_orientation, 0, 0, 2))
        joints = poses.state.goal.joints
        assert joints is not None
        assert np.abs(np.asarray(joints[0]) - before).max() < 0.3
        play(poses, 20)


def test_a_target_that_is_put_where_the_arm_cannot_be_stays_as_it_was(poses: Player) -> None:
    before, goal = poses.moment, poses.state.goal
    assert not poses.move_target(np.array([2.0, 0.0, 0.5]), before.target_orientation)
    assert poses.state.goal is goal
    assert poses.moment is before


@pytest.mark.parametrize("task", ["precise", "pose", "track"])
def test_a_target_that_is_moved_keeps_its_structure_so_that_nothing_is_compiled_anew(task: str) -> None:
    player = player_under_dynamics(task)
    before = player.state
    assert player.move_target(player.moment.target, np.asarray(player.state.arm.tool_quaternion)[0])
    assert jax.tree.structure(player.state) == jax.tree.structure(before)
    for one, other in zip(jax.tree.leaves(player.state), jax.tree.leaves(before), strict=True):
        assert (one.shape, one.dtype) == (other.shape, other.dtype)


# --- a target that moves --------------------------------------------------------------------------


@pytest.fixture
def tracker() -> Player:
    return player_under_dynamics("track")


def test_a_target_that_moves_leaves_a_trail_and_is_followed(tracker: Player) -> None:
    assert tracker.on_path
    tracker.follow(True)
    places = [tracker.moment.target]
    for _ in range(300):
        tracker.step("ik", None)
        places.append(tracker.moment.target)
    trail = tracker.moment.trail
    assert len(trail) > 10
    assert np.linalg.norm(np.diff(trail, axis=0), axis=1).min() >= TRAIL_STEP
    away = np.linalg.norm(trail[:, None] - np.array(places)[None], axis=-1)
    assert away.min(axis=1).max() < 1e-6, "it has been at every point of it"
    assert tracker.moment.reached, "the arm does not rest beside a target that moves on"
    assert tracker.moment.error is not None
    assert tracker.moment.error < 0.005
    assert not tracker.over


def test_a_target_that_is_taken_off_its_path_stays_until_the_next_episode(tracker: Player) -> None:
    play(tracker, 50)
    place = np.array([0.5, 0.1, 0.45])
    assert tracker.move_target(place)
    assert not tracker.on_path
    play(tracker)
    assert tracker.over
    np.testing.assert_allclose(tracker.moment.target, place, atol=1e-6)
    assert np.linalg.norm(tracker.moment.tool - place) < 0.002
    tracker.proceed()
    assert tracker.on_path
    assert len(tracker.moment.trail) == 1
    play(tracker)
    assert len(tracker.moment.trail) > 1


def test_a_target_that_stays_leaves_no_trail() -> None:
    player = player_in("kinematic")
    player.move_target(FAR)
    assert len(player.moment.trail) == 0
