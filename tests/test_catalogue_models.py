"""The catalogue's own models against the public descriptions of the same arms."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from foreign_arms import DESCRIPTIONS
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.loading import load_robot


@dataclass(frozen=True)
class Public:
    """A public description of a robot of the catalogue.

    Attributes:
        robot: our name.
        urdf: file below `DESCRIPTIONS`.
        tip: its link that is compared, and ...
        frame: ... the same frame of ours, a site or body.
        joints: its joints in the order of ours.
        links: its links by our bodies, where the masses are from this file.
    """

    robot: str
    urdf: str
    tip: str
    frame: str
    joints: tuple[str, ...]
    links: dict[str, str]


PUBLIC = (
    Public(
        "panda",
        "panda_description/urdf/panda.urdf",
        "panda_link8",
        "flange",
        tuple(f"panda_joint{i}" for i in range(1, 8)),
        {"base": "panda_link0", **{f"link_{i}": f"panda_link{i}" for i in range(1, 8)}},
    ),
    Public(
        "xarm7",
        "xarm_description/urdf/xarm7.urdf",
        "link_eef",
        "flange",
        tuple(f"joint{i}" for i in range(1, 8)),
        {"base": "link_base", **{f"link_{i}": f"link{i}" for i in range(1, 8)}},
    ),
)

every_public = pytest.mark.parametrize("public", PUBLIC, ids=lambda public: public.robot)


def parsed(public: Public) -> ElementTree.Element:
    """The description without shapes and with exact quarter turns, which some files round to 1.5708."""
    text = (DESCRIPTIONS / public.urdf).read_text(encoding="utf-8")
    root = ElementTree.fromstring(re.sub(r"\b1\.570[78]\d*\b", repr(math.pi / 2), text))
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    return root


def vector(element: ElementTree.Element | None, name: str) -> np.ndarray:
    return np.array([float(number) for number in ("0 0 0" if element is None else element.get(name, "0 0 0")).split()])


@pytest.fixture(scope="module")
def bullet() -> Iterator[Any]:
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

    client = BulletClient(pybullet.DIRECT)
    yield client
    client.disconnect()


@every_public
def test_the_forward_kinematics_are_those_of_the_public_description(
    public: Public, bullet: Any, tmp_path: Path
) -> None:
    file = tmp_path / "arm.urdf"
    file.write_bytes(ElementTree.tostring(parsed(public)))
    theirs = bullet.loadURDF(str(file), useFixedBase=True)
    info = [bullet.getJointInfo(theirs, i) for i in range(bullet.getNumJoints(theirs))]
    joints = [next(i[0] for i in info if i[1].decode() == name) for name in public.joints]
    tip = next(i[0] for i in info if i[12].decode() == public.tip)

    robot = load_robot(public.robot, public.frame)
    model = mujoco.MjSpec.from_file(str(robot.model.file)).compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(300):
        data.qpos[:] = rng.uniform(robot.chain.lower, robot.chain.upper)
        mujoco.mj_kinematics(model, data)
        for joint, angle in zip(joints, data.qpos, strict=True):
            bullet.resetJointState(theirs, joint, angle)
        state = bullet.getLinkState(theirs, tip, computeForwardKinematics=True)
        turn = np.reshape(bullet.getMatrixFromQuaternion(state[5]), (3, 3))
        np.testing.assert_allclose(data.site(public.frame).xpos, state[4], atol=2e-6)
        np.testing.assert_allclose(data.site(public.frame).xmat.reshape(3, 3), turn, atol=4e-6)


@every_public
def test_masses_centres_and_inertias_are_those_of_the_public_description(public: Public) -> None:
    links = {link.get("name"): link.find("inertial") for link in parsed(public).findall("link")}
    model = mujoco.MjSpec.from_file(str(ROBOTS[public.robot].file)).compile()
    for ours, theirs in public.links.items():
        inertial, body = links[theirs], model.body(ours)
        assert inertial is not None
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        assert mass is not None
        assert inertia is not None
        assert body.mass[0] == pytest.approx(float(mass.get("value", "nan")))
        np.testing.assert_allclose(body.ipos, vector(inertial.find("origin"), "xyz"), atol=1e-9)
        assert not vector(inertial.find("origin"), "rpy").any()
        moments = np.array([[float(inertia.get("i" + "".join(sorted(a + b)), 0)) for b in "xyz"] for a in "xyz"])
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, body.iquat)
        axes = turn.reshape(3, 3)
        np.testing.assert_allclose(axes @ np.diag(body.inertia) @ axes.T, moments, atol=2e-8)
    assert sum(model.body_mass) == pytest.approx(sum(model.body(ours).mass[0] for ours in public.links))


@every_public
def test_limits_are_those_of_the_public_description(public: Public) -> None:
    robot = load_robot(public.robot)
    joints = {joint.get("name"): joint.find("limit") for joint in parsed(public).findall("joint")}
    for i, name in enumerate(public.joints):
        limit = joints[name]
        assert limit is not None
        # Descriptions write 180 degrees as 3.14 and 118 degrees as 2.059.
        figures = robot.chain.lower[i], robot.chain.upper[i], robot.speed[i], robot.torque[i]
        theirs = [float(limit.get(what, "nan")) for what in ("lower", "upper", "velocity", "effort")]
        np.testing.assert_allclose(figures, theirs, atol=2e-3)


@every_public
def test_the_servos_hold_home_and_settle_without_overshoot(public: Public) -> None:
    robot = load_robot(public.robot)
    model = mujoco.MjSpec.from_file(str(robot.model.file)).compile()
    data = mujoco.MjData(model)

    def simulate(target: np.ndarray) -> np.ndarray:
        """Joints `[500, n]` of 2 s from the present ones to a target `[n]`."""
        data.ctrl[:] = target
        path = np.empty((500, model.nq))
        for q in path:
            mujoco.mj_step(model, data)
            q[:] = data.qpos
        return path

    home = np.array(robot.home)
    data.qpos[:] = home
    held = simulate(home)[-1]
    assert np.abs(held - home).max() < 0.03
    assert (np.abs(data.actuator_force) < 0.5 * np.array(robot.torque)).all()
    for i in range(model.nq):
        data.qpos[:], data.qvel[:] = held, 0.0
        path = simulate(home + 0.1 * np.eye(model.nq)[i])[:, i] - held[i]
        assert path[-1] == pytest.approx(0.1, abs=0.003)
        assert path.max() < path[-1] + 1e-4
        # As for the iiwa: 63 % of a step after kv / kp = 0.1 s.
        assert np.argmax(path > 0.063) * model.opt.timestep == pytest.approx(0.1, abs=0.02)


@every_public
def test_home_holds_the_tool_down_in_front_of_the_arm(public: Public) -> None:
    robot = load_robot(public.robot, public.frame)
    model = mujoco.MjSpec.from_file(str(robot.model.file)).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home
    mujoco.mj_kinematics(model, data)
    tool = data.site(public.frame)
    assert tool.xmat[8] == pytest.approx(-1.0, abs=1e-9)
    np.testing.assert_allclose(tool.xpos, np.mean(robot.workspace, axis=0), atol=0.15)
    room = np.minimum(np.array(robot.home) - robot.chain.lower, robot.chain.upper - np.array(robot.home))
    assert room.min() > 0.7


@every_public
def test_models_are_of_primitive_shapes_only(public: Public) -> None:
    model = mujoco.MjSpec.from_file(str(ROBOTS[public.robot].file)).compile()
    assert model.nmesh == 0
    for body in range(1, model.nbody):
        groups = set(model.geom_group[model.geom_bodyid == body])
        assert groups == {1, 3}, f"{model.body(body).name} is seen and can be touched"
