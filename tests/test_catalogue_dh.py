"""The catalogue's UR5e, Gen3 and SO-101 against what their makers publish, computed without our kinematics."""

from __future__ import annotations

import re
from importlib import metadata
from pathlib import Path

import mujoco
import numpy as np
import pytest

from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot

PI = np.pi

UR5E = [(0, 0.1625, PI / 2), (-0.425, 0, 0), (-0.3922, 0, 0), (0, 0.1333, PI / 2), (0, 0.0997, -PI / 2), (0, 0.0996, 0)]
"""DH parameters (a, d, alpha) of the UR5e: Universal Robots, "DH parameters for calculations of kinematics"."""

GEN3 = [
    (-(0.1564 + 0.1284), PI / 2),
    (-(0.0054 + 0.0064), PI / 2),
    (-(0.2104 + 0.2104), PI / 2),
    (-(0.0064 + 0.0064), PI / 2),
    (-(0.2084 + 0.1059), PI / 2),
    (0.0, PI / 2),
    (-(0.1059 + 0.0615), PI),
]
"""DH parameters (d, alpha) of the Gen3, a is 0: Kinova, Gen3 user guide; all joints but the first are offset by pi."""

GEN3_EXACT = [
    0.15643 + 0.12838,
    0.005375 + 0.006375,
    2 * 0.21038,
    2 * 0.006375,
    0.20843 + 0.10593,
    2 * 0.00017505,
    0.10593 + 0.061525,
]
"""The same distances as Kinova's URDF has them, which the user guide rounds to 0.1 mm."""

PUBLIC_ROBOTS = "cmeel.prefix/share/example-robot-data/robots"
"""Where the Python package example-robot-data keeps its robots."""


def dh(theta: float, a: float, d: float, alpha: float) -> np.ndarray:
    """Transform `[4, 4]` of one row of a classic DH table."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]], dtype=float
    )


def compiled(robot: Robot) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(robot.model.file))


def random_joints(robot: Robot, count: int = 300) -> np.ndarray:
    lower, upper = robot.chain.lower, robot.chain.upper
    return np.random.default_rng(0).uniform(lower, upper, (count, robot.chain.n))


def tool_frames(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """Frames `[B, 4, 4]` of the tool, by MuJoCo in float64."""
    model = compiled(robot)
    data, frames = mujoco.MjData(model), np.tile(np.eye(4), (len(joints), 1, 1))
    for q, frame in zip(joints, frames, strict=True):
        data.qpos[: len(q)] = q
        mujoco.mj_kinematics(model, data)
        frame[:3, :3] = data.site(robot.tool).xmat.reshape(3, 3)
        frame[:3, 3] = data.site(robot.tool).xpos
    return frames


def dh_frames(table: list[tuple[float, float, float]], offsets: np.ndarray, first: np.ndarray, joints: np.ndarray):
    """Frames `[B, 4, 4]` of the end of a DH table whose joints have angle offsets."""
    frames = []
    for q in joints:
        frame = first
        for theta, row in zip(q + offsets, table, strict=True):
            frame = frame @ dh(theta, *row)
        frames.append(frame)
    return np.array(frames)


# --- all three ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ur5e", "gen3", "so101"])
def test_each_joint_follows_a_step_without_overshoot(name):
    model = compiled(load_robot(name))
    data = mujoco.MjData(model)
    for joint in range(model.nu):
        mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
        mujoco.mj_step(model, data, nstep=500)
        rest = data.qpos.copy()
        assert np.abs(rest - data.ctrl).max() < 0.03, "sag under gravity"
        data.ctrl[joint] += 0.1
        path = []
        for _ in range(250):
            mujoco.mj_step(model, data)
            path.append(data.qpos[joint] - rest[joint])
        assert max(path) - path[-1] < 1e-3
        assert path[-1] == pytest.approx(0.1, abs=0.003)
        assert 0.04 < model.opt.timestep * np.argmax(np.array(path) > 0.063) < 0.12


# --- UR5e --------------------------------------------------------------------------------------------


def test_ur5e_has_the_kinematics_of_its_makers_dh_table():
    robot = load_robot("ur5e", kind="flange")
    joints = random_joints(robot)
    # The base is turned by half a turn, so that the stretched arm points along +x.
    expected = dh_frames(UR5E, np.zeros(6), np.diag([-1.0, -1.0, 1.0, 1.0]), joints)
    np.testing.assert_allclose(tool_frames(robot, joints), expected, atol=1e-12)


def test_ur5e_has_its_makers_masses_and_limits():
    robot = load_robot("ur5e")
    model = compiled(robot)
    np.testing.assert_allclose(model.body_mass[2:], [3.761, 8.058, 2.846, 1.37, 1.3, 0.365])
    assert model.body_mass.sum() == pytest.approx(20.6)
    np.testing.assert_allclose(np.rad2deg(robot.chain.upper), [360, 360, 180, 360, 360, 360])
    np.testing.assert_allclose(robot.chain.lower, np.negative(robot.chain.upper))
    np.testing.assert_allclose(robot.speed, PI)
    np.testing.assert_allclose(robot.torque, [150, 150, 150, 28, 28, 28])


# --- Gen3 --------------------------------------------------------------------------------------------


def gen3_frames(distances: list[float], joints: np.ndarray) -> np.ndarray:
    table = [(0.0, d, alpha) for d, (_, alpha) in zip(distances, GEN3, strict=True)]
    return dh_frames(table, np.array([0.0, PI, PI, PI, PI, PI, PI]), np.diag([1.0, -1.0, -1.0, 1.0]), joints)


def test_gen3_has_the_kinematics_of_its_makers_dh_table():
    robot = load_robot("gen3", kind="flange")
    joints = random_joints(robot)
    frames = tool_frames(robot, joints)
    exact = gen3_frames([-d for d in GEN3_EXACT], joints)
    np.testing.assert_allclose(frames, exact, atol=1e-12)
    rounded = gen3_frames([d for d, _ in GEN3], joints)
    np.testing.assert_allclose(frames, rounded, atol=6e-4)


def test_gen3_has_its_makers_masses_and_limits():
    robot = load_robot("gen3")
    model = compiled(robot)
    np.testing.assert_allclose(model.body_mass[1:], [1.697, 1.3773, 1.1636, 1.1636, 0.9302, 0.6781, 0.6781, 0.5006])
    np.testing.assert_allclose(np.rad2deg(robot.chain.upper)[1::2], [128.9, 147.8, 120.3])
    np.testing.assert_allclose(robot.chain.lower, np.negative(robot.chain.upper))
    np.testing.assert_allclose(np.rad2deg(robot.speed), [80, 80, 80, 80, 70, 70, 70])
    np.testing.assert_allclose(robot.torque, [39, 39, 39, 39, 9, 9, 9])


# --- SO-101 ------------------------------------------------------------------------------------------


@pytest.fixture
def public_so101(tmp_path):
    """The public URDF without its meshes, in PyBullet: client, robot and its joints and links by name."""
    import pybullet

    try:
        package = metadata.distribution("example-robot-data")
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    text = Path(str(package.locate_file(f"{PUBLIC_ROBOTS}/so_arm_description/urdf/so101.urdf"))).read_text()
    file = tmp_path / "so101.urdf"
    file.write_text(re.sub("<(visual|collision)>.*?</\\1>", "", text, flags=re.S))
    client = pybullet.connect(pybullet.DIRECT)
    robot = pybullet.loadURDF(str(file), useFixedBase=True, physicsClientId=client)
    infos = [pybullet.getJointInfo(robot, i, client) for i in range(pybullet.getNumJoints(robot, client))]
    yield pybullet, client, robot, infos
    pybullet.disconnect(client)


def test_so101_has_the_kinematics_of_its_public_model(public_so101):
    pybullet, client, public, infos = public_so101
    robot = load_robot("so101", kind="flange")
    model = compiled(robot)
    index = {info[1].decode(): info[0] for info in infos}
    links = {info[12].decode(): info[0] for info in infos}
    joints, expected = random_joints(robot), []
    for q in joints:
        for i, angle in enumerate(q):
            pybullet.resetJointState(public, index[model.joint(i).name], angle, physicsClientId=client)
        state = pybullet.getLinkState(
            public, links["gripper_frame_link"], computeForwardKinematics=True, physicsClientId=client
        )
        frame = np.eye(4)
        frame[:3, 3], frame[:3, :3] = state[4], np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
        expected.append(frame)
    # The URDF rounds quarter turns to 1.5708 and 3.14159: up to 4e-6 rad a joint.
    np.testing.assert_allclose(tool_frames(robot, joints), expected, atol=2e-5)
    position = np.asarray(expected)[:, :3, 3]
    np.testing.assert_allclose(tool_frames(robot, joints)[:, :3, 3], position, atol=5e-6)


def test_so101_has_the_masses_and_position_limits_of_its_public_model(public_so101):
    pybullet, client, public, infos = public_so101
    robot = load_robot("so101")
    model = compiled(robot)
    masses = {info[12].decode(): pybullet.getDynamicsInfo(public, info[0], client)[0] for info in infos}
    masses["jaw_link"] = masses["moving_jaw_so101_v1_link"]
    for name in ("shoulder", "upper_arm", "lower_arm", "wrist", "gripper", "jaw"):
        assert model.body(name).mass[0] == pytest.approx(masses[f"{name}_link"])
    limits = {info[1].decode(): info[8:10] for info in infos}
    expected = [limits[model.joint(i).name] for i in range(robot.chain.n)]
    np.testing.assert_allclose(np.transpose([robot.chain.lower, robot.chain.upper]), expected, atol=1e-4)


def test_so101_has_the_servos_speed_and_torque_at_12_volts():
    robot = load_robot("so101")
    np.testing.assert_allclose(robot.speed, 45 * 2 * PI / 60, atol=0.02)
    np.testing.assert_allclose(robot.torque, 30 * 0.0980665, atol=0.005)
