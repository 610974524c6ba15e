"""Pictures of a robot at work."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.render.marks import Axes, Marks
from reachlab.render.offscreen import Camera
from reachlab.render.scene import HEIGHT, WIDTH, scene_spec
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot
from reachlab.settings.validation import InputError
from situations import errors_of

TARGET = np.array([0.45, 0.1, -0.0083])


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("iiwa14")


@pytest.fixture(scope="module")
def camera(robot: Robot) -> Iterator[Camera]:
    try:
        camera = Camera(robot)
    except InputError as error:
        pytest.skip(str(error))
    yield camera
    camera.close()


def changed(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.asarray((np.abs(one.astype(int) - other) > 8).any(axis=-1))


def redness(picture: np.ndarray) -> np.ndarray:
    return (picture[..., 0] > 120) & (picture[..., 1] < 80) & (picture[..., 2] < 90)


def test_a_picture_is_an_array_of_bytes(robot: Robot, camera: Camera) -> None:
    picture = camera.picture(np.array(robot.home), TARGET)
    assert picture.shape == (HEIGHT, WIDTH, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 10


def test_equal_scenes_give_equal_pictures(robot: Robot, camera: Camera) -> None:
    home = np.array(robot.home)
    first = camera.picture(home, TARGET)
    camera.picture(home + 0.3, TARGET + 0.1)
    assert np.array_equal(camera.picture(home, TARGET), first)


def test_the_red_target_is_drawn_where_it_is(robot: Robot, camera: Camera) -> None:
    home = np.array(robot.home)
    here, there = (camera.picture(home, np.array(point)) for point in ((0.6, -0.2, 0.1), (0.6, 0.2, 0.1)))
    centres = [np.argwhere(redness(picture)).mean(axis=0) for picture in (here, there)]
    assert np.linalg.norm(centres[0] - centres[1]) > 30
    higher = camera.picture(home, np.array((0.6, -0.2, 0.3)))
    assert np.argwhere(redness(higher)).mean(axis=0)[0] < centres[0][0] - 20, "up in the world is up in the picture"


def test_the_success_distance_is_drawn_as_a_ball_around_the_target(robot: Robot, camera: Camera) -> None:
    home, point = np.array(robot.home), np.array((0.6, -0.2, 0.1))

    def width(success_distance: float) -> float:
        """Of what turns green when the target is reached [pixels]."""
        red, green = (camera.picture(home, point, Marks(success_distance, reached)) for reached in (False, True))
        return float(np.ptp(np.argwhere(changed(red, green))[:, 1]))

    assert width(0.1) / width(0.05) == pytest.approx(2, rel=0.1)
    assert width(0.01) / width(0.02) == pytest.approx(0.5, rel=0.2), "a ball smaller than the target is the target"


def test_a_reached_target_is_green(robot: Robot, camera: Camera) -> None:
    home, point = np.array(robot.home), np.array((0.6, -0.2, 0.1))
    waiting, reached = (camera.picture(home, point, Marks(0.022, now)) for now in (False, True))
    target = changed(waiting, reached)
    assert redness(waiting)[target].mean() > 0.8
    assert (reached[target][:, 1] > reached[target][:, 0]).mean() > 0.95


def test_the_tools_path_is_drawn(robot: Robot, camera: Camera) -> None:
    home = np.array(robot.home)
    path = np.linspace((0.6, -0.2, 0.1), (0.6, 0.2, 0.1), 50)
    line = changed(camera.picture(home, TARGET), camera.picture(home, TARGET, Marks(path=path)))
    assert line.sum() > 100
    assert np.array_equal(camera.picture(home, TARGET), camera.picture(home, TARGET, Marks(path=path[:1])))


def test_the_trail_of_a_target_is_drawn_in_another_colour(robot: Robot, camera: Camera) -> None:
    home = np.array(robot.home)
    line, plain = np.linspace((0.6, -0.2, 0.1), (0.6, 0.2, 0.1), 20), camera.picture(home, TARGET)
    path, trail = (camera.picture(home, TARGET, marks).astype(int) for marks in (Marks(path=line), Marks(trail=line)))
    assert (path[changed(plain, path)] @ (1, 0, -1)).mean() < -50, "blue"
    assert (trail[changed(plain, trail)] @ (1, 0, -1)).mean() > 50, "orange"
    both = camera.picture(home, TARGET, Marks(path=line, trail=line))
    assert changed(both, trail).sum() > 100, "the path is seen inside the trail"


def test_an_orientation_is_drawn_as_three_axes_where_they_point(robot: Robot, camera: Camera) -> None:
    home, place = np.array(robot.home), np.array((0.6, 0.1, 0.2))
    turn = Rotation.from_euler("xyz", (20, 30, 40), degrees=True)
    axes = Axes(place, turn.as_quat(scalar_first=True), (0.2, 0.004))
    plain = camera.picture(home, TARGET)
    pixels = changed(plain, camera.picture(home, TARGET, Marks(axes=(axes,))))
    # A thin path from the middle to each tip covers no pixel beside those of the axes.
    for tip in place + 0.2 * turn.as_matrix().T:
        path = np.linspace(place, tip - 0.01 * (tip - place), 20)
        line = changed(plain, camera.picture(home, TARGET, Marks(path=path)))
        assert line.sum() > 20
        assert pixels[line].mean() > 0.9
    half = Axes(place, (turn * Rotation.from_rotvec((0, 0, np.pi))).as_quat(scalar_first=True), (0.2, 0.004))
    assert changed(
        camera.picture(home, TARGET, Marks(axes=(axes,))), camera.picture(home, TARGET, Marks(axes=(half,)))
    ).any()


def test_a_picture_of_a_pose_differs_where_only_its_orientation_does(camera: Camera) -> None:
    del camera
    env = Env(configure("pose"), 1)
    state = env.init(env_keys(0, 1))
    assert state.goal.quaternion is not None
    turned = Rotation.from_quat(np.asarray(state.goal.quaternion), scalar_first=True) * Rotation.from_rotvec((0, 0, 1))
    goal = replace(state.goal, quaternion=jnp.asarray(turned.as_quat(scalar_first=True), jnp.float32))
    one, other = env.render(state), env.render(replace(state, goal=goal))
    assert 20 < changed(one, other).sum() < 4000
    env.close()


def test_a_moving_arm_changes_the_picture(robot: Robot, camera: Camera) -> None:
    home = np.array(robot.home)
    moved = home.copy()
    moved[0] += 0.5
    assert 0.01 < changed(camera.picture(home, TARGET), camera.picture(moved, TARGET)).mean() < 0.6


def test_cameras_of_other_sizes_do_not_disturb_each_other(robot: Robot, camera: Camera) -> None:
    home = np.array(robot.home)
    before = camera.picture(home, TARGET)
    small = Camera(robot, width=84, height=60)
    assert small.picture(home, TARGET).shape == (60, 84, 3)
    assert np.array_equal(camera.picture(home, TARGET), before)
    assert small.picture(home, TARGET).std() > 10
    small.close()
    assert np.array_equal(camera.picture(home, TARGET), before)


def test_an_environment_draws_the_lane_that_is_asked_for(camera: Camera) -> None:
    del camera
    env = Env(configure(), 2)
    state = env.compile_whole(env.init)(env_keys(0, 2))
    first, second = env.render(state, 0), env.render(state, 1)
    assert first.shape == (HEIGHT, WIDTH, 3)
    assert changed(first, second).any(), "two environments have two targets"
    env.close()
    env.close()
    assert np.array_equal(env.render(state, 0), first), "a closed environment can draw again"
    env.close()


def test_an_environment_draws_whether_its_target_is_reached(camera: Camera) -> None:
    del camera
    env = Env(configure(), 1)
    state = env.compile_whole(env.init)(env_keys(0, 1))
    away, near = env.render(state), env.render(replace(state, errors=errors_of(state.distance * 0)))
    ball = changed(away, near)
    greener = near[ball].astype(int) - away[ball]
    assert (greener[:, 1] > greener[:, 0]).all()
    env.close()


def test_the_drawn_table_lies_where_targets_come_to_rest(robot: Robot) -> None:
    model = scene_spec(robot).compile()
    slabs = [i for i in range(model.ngeom) if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX]
    tops = [model.geom_pos[i][2] + model.geom_size[i][2] for i in slabs if model.geom_bodyid[i] == 0]
    # The target is the centre of a ball of 22 mm that rests on the table.
    assert max(tops) == pytest.approx(-0.0083 - 0.022, abs=1e-3)


def test_the_scene_keeps_the_arms_kinematics(robot: Robot) -> None:
    model = scene_spec(robot).compile()
    data = mujoco.MjData(model)
    data.qpos[: robot.chain.n] = robot.home
    mujoco.mj_forward(model, data)
    # The tutorial's start of the tool.
    assert data.body("link_7").xpos == pytest.approx((0.5321, -0.0011, 0.4963), abs=1e-4)


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_without_opengl_the_package_to_install_is_named(
    robot: Robot, backend: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", backend)
    monkeypatch.setitem(sys.modules, f"mujoco.{backend}", None)
    with pytest.raises(InputError, match=rf"pictures need OpenGL \({backend}\).*apt install libegl1") as refused:
        Camera(robot)
    assert "\n" not in str(refused.value)
