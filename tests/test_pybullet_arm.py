"""Arms that PyBullet's data does not contain: written from their own model, in a scene of their size."""

from __future__ import annotations

import tempfile
from dataclasses import replace

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from reachlab.control.situation import Goal
from reachlab.envs.presets import configure
from reachlab.render.marks import Marks
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import PybulletModel
from reachlab.sims.pybullet_arm import write_arm
from reachlab.sims.pybullet_world import GROUND, TABLE, TutorialWorld
from reachlab.sims.simulator import make_simulator
from situations import begin

pybullet = pytest.importorskip("pybullet")

CRANE = """
<mujoco model="crane">
  <compiler angle="radian"/>
  <asset>
    <mesh name="wedge" file="wedge.stl" scale="1 1 1.5"/>
    <material name="red" rgba="0.8 0.1 0.1 1"/>
  </asset>
  <worldbody>
    <geom type="plane" size="0 0 1" pos="0 0 -3" group="1"/>
    <body name="pillar" pos="0.1 0 0.2" euler="0 0.3 0">
      <geom type="cylinder" size="0.06 0.15"/>
      <geom type="box" size="0.3 0.05 0.02" pos="0.2 0 -0.1" euler="0.4 0 0.2"/>
      <body name="carriage" pos="0 0 0.1" euler="0.2 0.1 0.4">
        <joint name="lift" type="slide" axis="1 0 2" pos="0.05 0 0" range="-0.1 0.2" ref="0.02"/>
        <joint name="turn" axis="0.3 1 -0.2" pos="0.1 0.02 -0.03" range="-1 2" ref="-0.3"/>
        <geom type="capsule" size="0.04 0.12" pos="0.2 0 0" euler="0 1.3 0.2" material="red"/>
        <geom type="ellipsoid" size="0.1 0.04 0.07" pos="0.1 0.15 0.1" euler="0.5 0.2 0"/>
        <body name="trim" pos="0.1 -0.1 0.05"><geom type="sphere" size="0.05" mass="0.7"/></body>
        <body name="hand" pos="0.45 0 0" euler="0.1 0.2 1.1">
          <joint name="twist" axis="1 0.1 0"/>
          <geom type="mesh" mesh="wedge" euler="1 0 0.3"/>
          <geom type="sphere" size="0.5" group="3" mass="0"/>
          <site name="grip" pos="0.1 0.02 0" euler="0 1.5707963267948966 0.4"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>"""


@pytest.fixture
def crane(tmp_path):
    """An arm with a mesh, whose first two joints are in one body, off its origin, and not zero where it is drawn."""
    corners = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.15, 0], [0, 0, 0.1]], "<f4")
    facets = np.zeros(4, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")]))
    facets["corners"] = corners[[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]]
    (tmp_path / "wedge.stl").write_bytes(bytes(80) + np.uint32(4).tobytes() + facets.tobytes())
    file = tmp_path / "crane.xml"
    file.write_text(CRANE)
    return lambda tool: load_robot(str(file), tool)


@pytest.fixture
def iiwa():
    return replace(load_robot("iiwa14"), pybullet=None)


@pytest.fixture
def simulator():
    opened = []

    def simulator(robot):
        opened.append(make_simulator("pybullet", robot, configure().physics, 1))
        return opened[-1]

    yield simulator
    for one in opened:
        one.close()


@pytest.fixture
def loaded(tmp_path):
    """Loads an arm in a client of its own, which is empty but for it."""
    client = pybullet.connect(pybullet.DIRECT)

    def loaded(robot):
        folder = tmp_path / "arm"
        folder.mkdir()
        return pybullet.loadURDF(write_arm(robot, folder).file, useFixedBase=True, physicsClientId=client), client

    yield loaded
    pybullet.disconnect(physicsClientId=client)


def nowhere() -> Goal:
    return Goal.at(jnp.zeros((1, 3)))


def joints(robot, count: int) -> np.ndarray:
    low, high = robot.chain.lower, robot.chain.upper
    return np.random.default_rng(0).uniform(low, high, (count, robot.chain.n)).astype(np.float32)


def agrees_with_forward_kinematics(robot, bullet) -> None:
    q = joints(robot, 100)
    ours = forward_kinematics(robot.chain, jnp.asarray(q))
    state, positions, quaternions = bullet.reset(None, begin(q[:1]), None), [], []
    for row in q:
        state = bullet.step(state, row[None])
        positions.append(state.tool.position[0])
        quaternions.append(state.tool.quaternion[0])
    np.testing.assert_allclose(positions, ours.position, atol=2e-6)
    np.testing.assert_allclose(np.abs((np.array(quaternions) * np.asarray(ours.quaternion)).sum(1)), 1.0, atol=2e-6)


# --- where the tool is -------------------------------------------------------------------------------


def test_tool_of_the_iiwa_is_where_our_kinematics_have_it(iiwa, simulator):
    agrees_with_forward_kinematics(iiwa, simulator(iiwa))


@pytest.mark.parametrize("tool", ["grip", "hand"])
def test_tool_is_where_our_kinematics_have_it_be_it_a_site_or_a_body(crane, simulator, tool):
    agrees_with_forward_kinematics(crane(tool), simulator(crane(tool)))


def test_a_tool_that_pybullets_own_description_does_not_name_is_a_tool_like_any_other(simulator):
    own = PybulletModel("kuka_iiwa/model.urdf", 6, {"link_7": 0.0})
    robot = replace(load_robot("iiwa14", "flange"), pybullet=own)
    agrees_with_forward_kinematics(robot, simulator(robot))


# --- what is written ---------------------------------------------------------------------------------


def test_masses_are_the_models(crane, loaded):
    arm, client = loaded(crane("grip"))
    model = crane("grip").spec().compile()
    masses = [pybullet.getDynamicsInfo(arm, link, physicsClientId=client)[0] for link in range(4)]
    wanted = [0.0, model.body("carriage").mass[0] + 0.7, model.body("hand").mass[0], 0.0]
    np.testing.assert_allclose(masses, wanted, rtol=1e-9)


def test_limits_are_the_models(crane, loaded):
    robot = crane("grip")
    arm, client = loaded(robot)
    limits = [pybullet.getJointInfo(arm, joint, physicsClientId=client)[8:10] for joint in range(3)]
    np.testing.assert_allclose(limits, np.transpose([robot.chain.lower, robot.chain.upper]), rtol=1e-12)


OBJECT = 3
"""Number of the falling object in a world: plane, table and arm are loaded before it."""

SIDE, AWAY, ANGLE = 96, 1.4, 50.0
"""Pixels, distance [m] and angle of view [deg] of the shadows that are compared."""


def rays(eye: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Directions `[SIDE, SIDE, 3]` of the pixels of PyBullet's camera that looks from `eye`, z upwards."""
    forward = (middle - eye) / np.linalg.norm(middle - eye)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    # PyBullet's renderer looks through the lower left corner of a pixel.
    across, down = ((np.arange(SIDE) + corner) / SIDE * 2 - 1 for corner in (0, 1))
    sides = across[None, :, None] * right - down[:, None, None] * np.cross(right, forward)
    return forward + np.tan(np.deg2rad(ANGLE / 2)) * sides


@pytest.mark.parametrize("view", [(1, 0.1, 0.2), (0.1, -1, 0.1), (0.3, 0.3, 1)], ids=["front", "side", "above"])
def test_shapes_are_seen_where_mujocos_rays_meet_them(crane, loaded, view):
    robot = crane("grip")
    arm, client = loaded(robot)
    model = robot.spec().compile()
    data = mujoco.MjData(model)
    data.qpos[:] = joints(robot, 1)[0]
    mujoco.mj_forward(model, data)
    for joint, value in enumerate(data.qpos):
        pybullet.resetJointState(arm, joint, value, physicsClientId=client)
    middle = np.array([0.3, 0.0, 0.3])
    eye = middle + AWAY * np.array(view) / np.linalg.norm(view)
    shown = np.array([1, 0, 1, 0, 0, 0], np.uint8)  # all but the ground and the large ball
    hits = [
        mujoco.mj_ray(model, data, eye, ray, shown, 1, -1, np.array([-1], np.int32), None)
        for ray in rays(eye, middle).reshape(-1, 3)
    ]
    wanted = (np.array(hits) > 0).reshape(SIDE, SIDE)
    seen = pybullet.getCameraImage(
        SIDE,
        SIDE,
        pybullet.computeViewMatrix(eye.tolist(), middle.tolist(), (0, 0, 1)),
        pybullet.computeProjectionMatrixFOV(ANGLE, 1.0, 0.05, 10.0),
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=client,
    )[4]
    seen = np.reshape(seen, (SIDE, SIDE)) == arm
    assert wanted.mean() > 0.03
    assert (seen & wanted).sum() / (seen | wanted).sum() > 0.97


def test_a_picture_shows_the_arm_in_its_colours_and_its_pose(crane, simulator):
    robot = crane("grip")
    bullet = simulator(robot)
    poses = joints(robot, 2)
    pictures = [bullet.render(bullet.reset(None, begin(q[None]), None), nowhere(), 0, Marks()) for q in poses]
    red = [(picture[..., 0] > 2.0 * picture[..., 1:].max(-1).clip(1)) for picture in pictures]
    assert red[0].sum() > 100
    assert (red[0] != red[1]).sum() > 100


def test_no_file_is_left_behind(crane, simulator, tmp_path, monkeypatch):
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    simulator(crane("grip")).close()
    assert not list(folder.iterdir())


# --- the scene ---------------------------------------------------------------------------------------


def test_scene_of_the_tutorials_arm_is_the_tutorials():
    for tool in ("link_7", "flange"):
        robot = load_robot("iiwa14", tool)
        assert robot.scale == 1.0
        assert [tuple(robot.placed(point).tolist()) for point in (GROUND, TABLE)] == [GROUND, TABLE]


@pytest.mark.parametrize("scale", [0.4, 2.0])
def test_object_of_an_arm_of_another_size_settles_on_the_target_on_its_table(iiwa, tmp_path, scale):
    low, size = np.array([-0.3, 0.5, 0.25]), scale * np.array([0.5, 0.6, 0.55])
    robot = replace(iiwa, workspace=(tuple(low), tuple(low + size)))
    target = robot.placed((0.45, 0.1, -0.0083))
    np.testing.assert_allclose(target, low + size * [0.5, 0.5, 0] + scale * np.array([0, 0.1, -0.0083]))
    world = TutorialWorld(pybullet, robot, write_arm(robot, tmp_path), configure().physics.control_period, gui=False)
    world.drop(target)
    for _ in range(100):
        world.step()
    lies = world.bullet.getBasePositionAndOrientation(OBJECT)[0]
    world.close()
    np.testing.assert_allclose(lies, target, atol=0.002)
