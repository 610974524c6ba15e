"""The arm alone in its file: other joints locked, motors replaced by servos."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

from reachlab.robots.derive.arm import Arm, find_arm
from reachlab.robots.derive.isolation import apply
from reachlab.robots.files.model_file import read_model_file
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot

FILE = """
<mujoco>
  <compiler angle="radian" eulerseq="XYZ"/>
  <default>
    <joint damping="0.1"/>
    <default class="rail"><joint type="slide" axis="0 1 0" range="0 0.5"/></default>
  </default>
  <worldbody>
    <frame pos="0.3 0.1 0.2" euler="0.2 -0.4 0.7">
      <body name="cart" pos="0 0 0.1" euler="0.1 0.2 0.3"><joint name="rail" class="rail"/><geom size="0.1"/>
        <body name="turret" pos="0 0 0.2" euler="0.5 0 0.1"><joint name="spin" axis="0 0 1" range="-3 3"/>
          <geom size="0.05"/>
          <frame pos="0 0.02 0.1" euler="0.3 0 0">
            <body name="upper" pos="0 0 0.1"><joint name="shoulder" axis="0 1 0" range="-2 2"/><geom size="0.05"/>
              <body name="lower" pos="0.3 0 0" quat="0.9 0.1 0 0.2"><joint name="elbow" axis="0 1 0" range="-2 2"/>
                <geom size="0.05"/>
                <body name="wrist" pos="0.2 0 0" axisangle="1 0 0 0.4">
                  <joint name="wrist" axis="1 0 0" range="-3 3"/><geom size="0.03"/>
                  <body name="finger" pos="0.1 0 0" euler="0 0.3 0">
                    <joint name="left_finger" type="slide" axis="0 1 0" range="0 0.05"/>
                    <joint name="left_finger_tip" axis="0 0 1" pos="0.01 0 0" range="-1 1"/><geom size="0.01"/>
                  </body>
                  <body name="other" pos="0.1 0 0">
                    <joint name="right_finger" type="slide" axis="0 -1 0" range="0 0.05"/><geom size="0.01"/>
                  </body>
                  <site name="tcp" pos="0.1 0 0.02"/>
                </body></body></body>
          </frame></body></body>
    </frame>
    <body name="ball" pos="1 1 1"><freejoint/><geom size="0.03"/></body>
  </worldbody>
  <tendon>
    <fixed name="fingers"><joint joint="left_finger" coef="1"/><joint joint="right_finger" coef="1"/></fixed>
  </tendon>
  <equality><joint joint1="left_finger" joint2="right_finger"/></equality>
  <actuator>
    <motor name="drive" joint="spin" ctrlrange="-20 20"/>
    <position name="own" joint="shoulder" kp="321" kv="12" forcerange="-40 40"/>
    <motor name="elbow" joint="elbow" gear="2" ctrlrange="-10 10"/>
    <velocity name="speedy" joint="wrist" kv="3" forcerange="-7 7"/>
    <position name="grip" tendon="fingers" kp="10"/>
  </actuator>
  <sensor><jointpos joint="left_finger"/><jointpos joint="elbow"/></sensor>
  <keyframe>
    <key name="home" qpos="0.2 0.4 -0.3 0.9 0.2 0.03 0.5 0.02 1 1 1 1 0 0 0"/>
  </keyframe>
</mujoco>"""

LOCKED = {"rail": 0.2, "spin": 0.4, "left_finger": 0.03, "left_finger_tip": 0.5, "right_finger": 0.02}
"""Values of the keyframe `home` of joints that are no arm's."""


@pytest.fixture
def found(tmp_path: Path):
    """Finds the arm in a file's text; no home and boxes are derived."""

    def found(text: str, base: str | None = None) -> tuple[Arm, mujoco.MjModel]:
        (tmp_path / "arm.xml").write_text(text)
        file = read_model_file(tmp_path / "arm.xml")
        arm = find_arm(file, None, base)
        spec = file.spec()
        apply(spec, arm.isolation)
        return arm, spec.compile()

    return found


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder = tmp_path_factory.mktemp("robot")
    (folder / "arm.xml").write_text(FILE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        yield load_robot(str(folder / "arm.xml"))


def places(model: mujoco.MjModel, values: dict[str, float]) -> dict[str, np.ndarray]:
    """Poses of all named bodies and sites, with joints by name, the others where the model has them."""
    data = mujoco.MjData(model)
    for name, value in values.items():
        data.joint(name).qpos[0] = value
    mujoco.mj_kinematics(model, data)
    bodies = {f"body {model.body(i).name}": [data.xpos[i], data.xmat[i]] for i in range(1, model.nbody)}
    sites = {f"site {model.site(i).name}": [data.site_xpos[i], data.site_xmat[i]] for i in range(model.nsite)}
    return {name: np.concatenate(pose) for name, pose in (bodies | sites).items()}


def assert_as_in_the_file(
    found: tuple[Arm, mujoco.MjModel], text: str, locked: dict[str, float], bodies: list[str]
) -> None:
    (arm, alone), whole = found, mujoco.MjModel.from_xml_string(text)
    assert [alone.joint(i).name for i in range(alone.njnt)] == list(arm.names)
    assert arm.tool == "tcp"
    random = np.random.default_rng(0)
    for q in random.uniform(arm.chain.lower, arm.chain.upper, (20, arm.chain.n)):
        values = dict(zip(arm.names, q.tolist(), strict=True))
        ours, theirs = places(alone, values), places(whole, locked | values)
        for name in (*(f"body {body}" for body in bodies), "site tcp"):
            np.testing.assert_allclose(ours[name], theirs[name], atol=1e-9, err_msg=name)
        position, _ = arm.chain.tool_at(q)
        np.testing.assert_allclose(position, theirs["site tcp"][:3], atol=1e-6)


BODIES = ["cart", "turret", "upper", "lower", "wrist", "finger", "other"]


def test_the_arm_moves_as_in_its_file_with_other_joints_where_the_keyframe_has_them(found) -> None:
    there = found(FILE)
    locked = {name: value for name, value in LOCKED.items() if name not in ("rail", "spin")}
    assert there[0].names == ("rail", "spin", "shoulder", "elbow", "wrist")
    assert there[0].home == (0.2, 0.4, -0.3, 0.9, 0.2)
    assert_as_in_the_file(there, FILE, locked, BODIES)


def test_joints_above_the_base_are_locked_at_the_keyframe(found) -> None:
    there = found(FILE, base="turret")
    assert there[0].names == ("shoulder", "elbow", "wrist")
    assert there[0].home == (-0.3, 0.9, 0.2)
    assert_as_in_the_file(there, FILE, LOCKED, BODIES)


def test_without_a_keyframe_other_joints_are_locked_where_the_file_draws_them(found) -> None:
    text = FILE[: FILE.index("<keyframe>")] + "</mujoco>"
    text = text.replace('name="left_finger_tip"', 'name="left_finger_tip" ref="0.4"')
    there = found(text, base="turret")
    assert there[0].home is None
    assert_as_in_the_file(there, text, {}, BODIES)


def test_a_floating_base_stands_where_the_file_has_it(found) -> None:
    text = """<mujoco><compiler angle="radian"/><worldbody><body name="base" pos="0.1 0.2 0.5" euler="0.3 0.2 1">
      <freejoint/><geom size="0.1"/><body name="a" euler="0.1 0 0"><joint name="a" axis="0 1 0" range="-1 1"/>
      <geom size="0.05"/><body name="b" pos="0.2 0 0"><joint name="b" axis="0 0 1" range="-1 1"/><geom size="0.05"/>
      <site name="tcp" pos="0.1 0 0"/></body></body></body></worldbody></mujoco>"""
    there = found(text)
    assert there[0].names == ("a", "b")
    assert_as_in_the_file(there, text, {}, ["base", "a", "b"])


def test_every_joint_has_one_servo_and_the_files_own_are_kept(robot: Robot) -> None:
    model = robot.spec().compile()
    by_joint = {model.joint(model.actuator_trnid[i, 0]).name: i for i in range(model.nu)}
    assert sorted(by_joint) == sorted(robot.joint_names)
    assert model.nu == robot.chain.n
    own = by_joint["shoulder"]
    assert model.actuator(own).name == "own"
    np.testing.assert_allclose(model.actuator_gainprm[own, 0], 321)
    np.testing.assert_allclose(model.actuator_biasprm[own, :3], [0, -321, -12])
    for joint, actuator in by_joint.items():
        gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
        assert bias[1] == -gain[0] < 0, joint
        own_damping = model.dof_damping[model.jnt_dofadr[model.actuator_trnid[actuator, 0]]]
        assert own_damping - bias[2] > 0, joint
    limits = dict(zip(robot.joint_names, robot.torque, strict=True))
    assert [limits[name] for name in ("spin", "shoulder", "elbow", "wrist")] == [20, 40, 20, 7]
    for joint in ("spin", "elbow", "wrist"):
        np.testing.assert_allclose(model.actuator_forcerange[by_joint[joint]], [-limits[joint], limits[joint]])


def test_nothing_but_the_arm_is_left(robot: Robot) -> None:
    model = robot.spec().compile()
    assert (model.nkey, model.nsensor, model.neq, model.ntendon) == (0, 0, 0, 0)
    assert model.nq == model.nv == 5


def test_a_file_that_is_an_arm_and_nothing_else_keeps_what_it_has() -> None:
    robot = load_robot("iiwa14")
    ours, file = robot.spec().compile(), mujoco.MjModel.from_xml_path(str(robot.model.file))
    assert (ours.nu, ours.nkey, ours.nmesh) == (file.nu, file.nkey, file.nmesh)
    np.testing.assert_array_equal(ours.actuator_gainprm, file.actuator_gainprm)
    np.testing.assert_array_equal(ours.body_inertia, file.body_inertia)


def test_joints_without_names_get_one(found) -> None:
    text = FILE[: FILE.index("<tendon>")] + "</mujoco>"
    for name in ("shoulder", "elbow"):
        text = text.replace(f'name="{name}"', "")
    arm, alone = found(text)
    assert len(set(arm.names)) == alone.njnt == 5
    assert all(arm.names)
