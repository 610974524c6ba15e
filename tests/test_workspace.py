"""Home and boxes of arms for which nobody states them."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from params import tried
from reachlab import jax_setup
from reachlab.envs.presets import configure
from reachlab.envs.setup import make_setup
from reachlab.jax_setup import jit
from reachlab.robots import loading
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.derive import reaching
from reachlab.robots.kinematics.forward import Pose, forward_kinematics
from reachlab.robots.kinematics.inverse import inverse_kinematics
from reachlab.robots.loading import NO_BOX, _load, load_robot
from reachlab.robots.robot import Robot
from reachlab.settings.validation import InputError
from reachlab.tasks.reachability import survey

FIVE = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="base"><geom type="cylinder" size="0.05 0.05"/>
  <body name="turret" pos="0 0 0.1"><joint name="pan" axis="0 0 1" range="-2.5 2.5"/><geom size="0.03"/>
  <body name="upper"><joint name="shoulder" axis="0 1 0" range="-2 2"/>
    <geom type="capsule" size="0.015" fromto="0 0 0.04 0 0 0.2"/>
  <body name="fore" pos="0 0 0.24"><joint name="elbow" axis="0 1 0" range="-0.2 2.8"/>
    <geom type="capsule" size="0.015" fromto="0 0 0.04 0 0 0.16"/>
  <body name="wrist" pos="0 0 0.2"><joint name="bend" axis="0 1 0" range="-2 2"/>
    <geom type="capsule" size="0.012" fromto="0 0 0.03 0 0 0.05"/>
  <body name="hand" pos="0 0 0.06"><joint name="roll" axis="0 0 1" range="-2.9 2.9"/>
    <geom type="capsule" size="0.01" fromto="0 0 0.02 0 0 0.05"/><site name="tcp" pos="0 0 0.08"/>
  </body></body></body></body></body></body></worldbody></mujoco>"""
"""A desktop arm of five joints, made of capsules."""

SIX = FIVE.replace(
    '<body name="wrist" pos="0 0 0.2">',
    '<body name="forearm" pos="0 0 0.1"><joint name="twist" axis="0 0 1" range="-2.9 2.9"/><geom size="0.015"/>'
    '<body name="wrist" pos="0 0 0.1">',
).replace("</body></body></body></body></body></body>", "</body></body></body></body></body></body></body>")

PLANAR = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="upper" pos="0 0 0.3"><joint name="a" axis="0 1 0" range="-2 2"/><geom size="0.02"/>
  <body name="lower" pos="0.4 0 0"><joint name="b" axis="0 1 0" range="-2 2.4"/><geom size="0.02"/>
    <site name="tcp" pos="0.3 0 0"/></body></body></worldbody></mujoco>"""

ARMS = {"five": FIVE, "six": SIX, "hanging": SIX.replace('name="base"', 'name="base" pos="0 0 1.5" quat="0 1 0 0"')}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder of robot files, and the user's cache in it."""
    folder = tmp_path_factory.mktemp("arms")
    for name, text in (ARMS | {"planar": PLANAR}).items():
        (folder / f"{name}.xml").write_text(text)
    shutil.copytree(ROBOTS["iiwa14"].file.parent, folder / "iiwa")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        yield folder


@pytest.fixture(scope="module", params=tried(["five.xml", "six.xml", "iiwa/iiwa14.xml"], ["five.xml"]))
def robot(request: pytest.FixtureRequest, folder: Path) -> Robot:
    return load_robot(str(folder / request.param))


def tool(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Tool points `[B, 3]` m by MuJoCo's own kinematics."""
    model = robot.spec().compile()
    data, points = mujoco.MjData(model), []
    for row in np.atleast_2d(q):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        points.append(data.site(robot.tool).xpos.copy())
    return np.array(points)


def test_home_is_inside_limits_and_workspace_with_the_tool_held_as_it_is_there(robot: Robot) -> None:
    home, (low, high) = np.array(robot.home), np.array(robot.workspace)
    assert (np.array(robot.chain.lower) < home).all()
    assert (home < np.array(robot.chain.upper)).all()
    (point,) = tool(robot, home)
    assert (low <= point + 1e-3).all()
    assert (point <= high + 1e-3).all()
    pose = forward_kinematics(robot.chain, jnp.asarray(home, jnp.float32))
    np.testing.assert_allclose(np.abs(np.dot(pose.quaternion, robot.held_quaternion)), 1.0, atol=1e-5)
    assert robot.sources["workspace"] == robot.sources["goal_box"] == "derived"


def test_boxes_are_above_the_ground_and_worth_working_in(robot: Robot) -> None:
    reach = np.linalg.norm(
        tool(robot, np.random.default_rng(0).uniform(robot.chain.lower, robot.chain.upper, (2000, robot.chain.n))),
        axis=1,
    ).max()
    for low, high in (np.array(robot.workspace), np.array(robot.goal_box)):
        assert low[2] >= -1e-9
        assert ((high - low) > 0.1 * reach).all()


def test_the_stated_share_of_the_goal_box_is_reached_by_an_independent_solver(robot: Robot) -> None:
    assert robot.shares["goal_box"] >= 0.999
    setup = make_setup(configure("precise", robot=str(robot.model.file), success_distance=0.005))
    assert survey(setup).reached >= 0.99


def test_the_stated_share_of_the_workspace_is_reached_with_the_tool_held(robot: Robot) -> None:
    """Inverse kinematics from many starts knows nothing of straight ways; with five joints the point counts."""
    assert robot.shares["workspace"] >= 0.999
    points = np.random.default_rng(7).uniform(*robot.workspace, (300, 3)).astype(np.float32)
    wanted = Pose(jnp.asarray(points), jnp.broadcast_to(jnp.asarray(robot.held_quaternion, jnp.float32), (300, 4)))
    if robot.chain.poses:
        solve = jit(functools.partial(inverse_kinematics, robot.chain, restarts=2))
        found = solve(wanted, jnp.asarray(robot.home, jnp.float32), jax.random.key(0))
        assert np.asarray(found.converged).mean() >= 0.99
    else:
        setup = make_setup(
            configure(
                robot=str(robot.model.file),
                targets="box",
                target_low=robot.workspace[0],
                target_high=robot.workspace[1],
                success_distance=0.005,
            )
        )
        assert survey(setup).reached >= 0.99


# --- the cache ---------------------------------------------------------------------------------------


def places(robot: Robot) -> tuple[object, ...]:
    return robot.home, robot.held_quaternion, robot.workspace, robot.goal_box, dict(robot.shares)


def test_a_second_load_derives_nothing_and_is_equal(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = str(folder / "five.xml")
    first = load_robot(file)
    _load.cache_clear()

    def derive(*_: object) -> None:
        raise AssertionError("derived again")

    monkeypatch.setattr(loading, "derive", derive)
    again = load_robot(file)
    assert again is not first
    assert places(again) == places(first)
    _load.cache_clear()
    (folder / "five.xml").write_text(FIVE.replace("0.08", "0.081"))
    with pytest.raises(AssertionError, match="derived again"):
        load_robot(file)
    (folder / "five.xml").write_text(FIVE)


@pytest.mark.parametrize("broken", tried(["", "{", "[]", '{"home": 1}', '{"home": [1]}'], ["{"]))
def test_what_is_broken_in_the_cache_is_derived_again(
    tmp_path: Path, folder: Path, broken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    file = str(folder / "planar.xml")
    _load.cache_clear()
    first = load_robot(file)
    (kept,) = (tmp_path / "reachlab" / "robots").iterdir()
    whole = kept.read_text()
    kept.write_text(broken)
    _load.cache_clear()
    assert places(load_robot(file)) == places(first)
    assert kept.read_text() == whole


def test_without_a_cache_that_can_be_written_an_arm_loads(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "reachlab").write_text("a file where the folder would be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    _load.cache_clear()
    assert load_robot(str(folder / "planar.xml")).chain.n == 2


def test_an_arm_that_hangs_works_below_its_base_in_as_large_boxes(folder: Path) -> None:
    standing, hanging = (load_robot(str(folder / f"{name}.xml")) for name in ("six", "hanging"))
    for one, other in ((standing.workspace, hanging.workspace), (standing.goal_box, hanging.goal_box)):
        assert other[1][2] <= 1.5
        sizes = [np.prod(np.subtract(high, low)) for low, high in (one, other)]
        assert sizes[1] > 0.5 * sizes[0]
    assert set(hanging.shares) == {"workspace", "goal_box"}
    assert min(hanging.shares.values()) >= 0.999
    (home,) = tool(hanging, np.array(hanging.home))
    assert (np.array(hanging.workspace[0]) < home).all()
    assert (home < hanging.workspace[1]).all()
    assert survey(make_setup(configure("precise", robot=str(folder / "hanging.xml")))).reached > 0.99


# --- arms that reach no box --------------------------------------------------------------------------


def test_an_arm_in_a_plane_starts_in_the_middle_of_its_limits_inside_a_box_around_what_it_reaches(folder: Path) -> None:
    robot = load_robot(str(folder / "planar.xml"))
    np.testing.assert_allclose(robot.home, [0.0, 0.2], atol=1e-6)
    low, high = np.array(robot.workspace)
    (home,) = tool(robot, np.array(robot.home))
    assert ((low < home) & (home < high)).all()
    points = tool(robot, np.random.default_rng(0).uniform(robot.chain.lower, robot.chain.upper, (1000, 2)))
    assert ((low < points) & (points < high)).all(axis=1).mean() > 0.3
    assert robot.goal_box == robot.workspace
    assert robot.shares == {}
    assert NO_BOX in robot.notices
    assert NO_BOX not in load_robot(str(folder / "five.xml")).notices


def test_an_arm_that_cannot_point_its_tool_down_starts_away_from_its_limits(tmp_path: Path) -> None:
    text = FIVE.replace('range="-2 2"', 'range="-0.3 0.3"').replace('range="-0.2 2.8"', 'range="-0.3 0.3"')
    (tmp_path / "upright.xml").write_text(text)
    robot = load_robot(str(tmp_path / "upright.xml"))
    lower, upper, home = np.array(robot.chain.lower), np.array(robot.chain.upper), np.array(robot.home)
    assert (np.minimum(home - lower, upper - home) > 0.05 * (upper - lower)).all()


def test_an_arm_is_led_the_same_where_jax_computes_with_64_bits() -> None:
    robot = load_robot("ur5e")
    points = np.array([robot.goal_box[0], robot.goal_box[1]])
    reaching._compiled.cache_clear()
    with jax.enable_x64(True):
        there = reaching.lead(robot.chain, np.array(robot.home), points, None)
    reaching._compiled.cache_clear()
    plain = reaching.lead(robot.chain, np.array(robot.home), points, None)
    assert (there.off < 1e-3).all()
    np.testing.assert_array_equal(there.q, plain.q)


def test_who_leads_an_arm_in_a_fork_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = load_robot("ur5e")
    monkeypatch.setattr(jax_setup, "FORKED", [1])
    with pytest.raises(InputError, match="JAX cannot compute in this process, a fork"):
        reaching.lead(robot.chain, np.array(robot.home), np.zeros((1, 3)), None)
