"""Grippers in files of one's own: how joints, tendons and linkages of each convention are found and driven."""

from __future__ import annotations

from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest

from reachlab.agents.acting import make_act
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.robots.derive.arm import find_arm
from reachlab.robots.derive.gripper import UnrecognisedError, own_gripper
from reachlab.robots.files.gripper import GRASP, TIPS, OwnGripper
from reachlab.robots.files.model_file import read_model_file
from reachlab.robots.loading import load_robot

FINGER = '<geom type="box" size="0.01 0.005 0.03" pos="0 {side}0.005 0.08"/>'
"""A finger whose inner face is in the hand's middle plane where its joint is at 0."""

LINK = '<geom type="capsule" fromto="0 0 0 {} 0 0" size="0.03"/>'
ARM = (
    """<mujoco><compiler angle="radian"/>
  <default><joint range="-2 2"/><geom contype="0" conaffinity="0"/></default><worldbody>
  <body name="one" pos="0 0 0.3"><joint name="a1" axis="0 0 1"/><geom type="box" size="0.05 0.05 0.1"/>
  <body name="two" pos="0 0 0.1"><joint name="a2" axis="0 1 0"/>"""
    + LINK.format(0.3)
    + """<body name="three" pos="0.3 0 0"><joint name="a3" axis="0 1 0"/>"""
    + LINK.format(0.2)
    + """<body name="hand" pos="0.2 0 0" quat="1 0 1 0"><joint name="a4" axis="0 0 1"/>
  <geom type="box" size="0.02 0.06 0.02"/>{fixed}{fingers}<site name="tool0"/>
  </body></body></body></body></worldbody>{rest}</mujoco>"""
)


def body(name: str, joint: str, shapes: str, *, inside: str = "", pos: str = "0 0 0") -> str:
    return f'<body name="{name}" pos="{pos}"><joint name="{name}" {joint}/>{shapes}{inside}</body>'


def slides(right: str, left: str) -> str:
    """Two fingers on slides, to +y and to −y of the hand."""
    axis = 'type="slide" axis="0 1 0" range='
    return body("right", f'{axis}"{right}"', FINGER.format(side="")) + body(
        "left", f'{axis}"{left}"', FINGER.format(side="-")
    )


HINGED = FINGER.replace('pos="0 {side}0.005 0.08"', 'pos="0 {side}0.005 0.06"')
LINKS = (
    body(
        "crank",
        'axis="1 0 0" range="-0.7 0"',
        '<geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.004"/>',
        pos="0 0.02 0.02",
    ),
    body(
        "rod",
        'axis="1 0 0"',
        '<geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.004"/>',
        pos="0 0.04 0.02",
        inside=body("tip", 'axis="1 0 0"', FINGER.format(side="").replace("0.005 0.08", "-0.035 0.03"), pos="0 0 0.04"),
    ),
)
SHAPE = '<visual><origin xyz="0 {} 0.08"/><geometry><box size="0.02 0.01 0.06"/></geometry></visual>'
MASS = '<inertial><mass value="0.5"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'


def link(name: str, joint: str, kind: str, above: str, place: str, axis: str, limit: str, *rest: str) -> str:
    """A link of a URDF, with its shapes, and the joint that holds it, with what else it has."""
    low, high, effort, speed = limit.split()
    limits = f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{speed}"/>'
    frame = f'<parent link="{above}"/><child link="{name}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
    held = f'<joint name="{joint}" type="{kind}">{frame}{limits}{"".join(rest[1:])}</joint>'
    return f'<link name="{name}">{MASS}{"".join(rest[:1])}</link>{held}'


MIMIC = "".join(
    [
        '<robot name="arm"><link name="base"/>',
        link("one", "a1", "revolute", "base", "0 0 0.3", "0 0 1", "-2 2 50 2"),
        link("two", "a2", "revolute", "one", "0 0 0.1", "0 1 0", "-2 2 50 2"),
        link("three", "a3", "revolute", "two", "0.3 0 0", "0 1 0", "-2 2 50 2"),
        link("hand", "a4", "revolute", "three", "0.2 0 0", "0 0 1", "-2 2 50 2"),
        link("right", "drive", "prismatic", "hand", "0 0 0", "0 1 0", "0 0.03 20 0.04", SHAPE.format(0.005)),
        link(
            *("left", "follow", "prismatic", "hand", "0 0 0", "0 1 0", "-0.03 0 20 0.04", SHAPE.format(-0.005)),
            '<mimic joint="drive" multiplier="-1"/>',
        ),
        "</robot>",
    ]
)
EQUAL = '<equality><joint joint1="left" joint2="right" polycoef="0 -1 0 0 0"/></equality>'
TENDON = """<tendon><fixed name="split"><joint joint="right" coef="0.5"/>
  <joint joint="left" coef="-0.5"/></fixed></tendon>
  <actuator><general tendon="split" ctrlrange="0 255" forcerange="-40 40" gainprm="0.0157" biasprm="0 -100 -10"
  biastype="affine"/></actuator>"""
SERVO = '<position joint="{}" kp="500" forcerange="-20 20"/>'
SERVOS = f"<actuator>{SERVO.format('right')}{SERVO.format('left')}</actuator>"
CONNECT = """<equality><connect body1="crank" body2="tip" anchor="0 0 0.04"/></equality>
  <actuator><motor joint="crank" gear="2" ctrlrange="-1 1"/></actuator>"""
FILES = {
    "two slides, a servo each": ARM.format(fingers=slides("0 0.04", "-0.04 0"), fixed="", rest=SERVOS),
    "an equality and a tendon with commands to 255": ARM.format(
        fingers=slides("0 0.04", "-0.04 0"), fixed="", rest=EQUAL + TENDON
    ),
    "two hinges, closed where they are high": ARM.format(
        fingers=body("right", 'axis="1 0 0" range="-0.6 0"', HINGED.format(side=""), pos="0 0.001 0.02")
        + body("left", 'axis="-1 0 0" range="-0.6 0"', HINGED.format(side="-"), pos="0 -0.001 0.02"),
        fixed="",
        rest="",
    ),
    "a hinge against a fixed jaw": ARM.format(
        fingers=body("right", 'axis="1 0 0" range="-1.2 0.1"', HINGED.format(side=""), pos="0 0 0.02"),
        fixed=FINGER.format(side="-"),
        rest="",
    ),
    "a linkage with a loop": ARM.format(fingers="".join(LINKS), fixed=FINGER.format(side="-"), rest=CONNECT),
    "a mimic joint": MIMIC,
}
JOINTS = [["right", "left"]] * 3 + [["right"], ["crank", "rod", "tip"], ["drive", "follow"]]
WIDEST = [0.08, 0.08, 0.1, 0.079, 0.0258, 0.06]


def found(text: str, folder: Path) -> tuple[OwnGripper, mujoco.MjModel]:
    file = folder / f"arm.{'urdf' if '<robot' in text else 'xml'}"
    file.write_text(text)
    read = read_model_file(file)
    arm = find_arm(read, None, None)
    return own_gripper(read, arm), arm.whole


@pytest.mark.parametrize(("kind", "joints", "widest"), list(zip(FILES, JOINTS, WIDEST, strict=True)))
def test_the_gripper_of_a_file_is_found(kind: str, joints: list[str], widest: float, tmp_path: Path) -> None:
    own, model = found(FILES[kind], tmp_path)
    assert [model.joint(joint).name for joint in own.joints] == joints
    assert own.drive.widest == pytest.approx(widest, abs=0.003)
    openings = np.linspace(0, own.drive.widest, 9)[:, None]
    assert own.drive.opening(own.drive.fingers(openings)) == pytest.approx(openings, abs=1e-6)


@pytest.mark.parametrize("kind", FILES)
def test_pads_are_as_far_apart_as_the_opening_says(kind: str, tmp_path: Path) -> None:
    found(FILES[kind], tmp_path)
    robot = load_robot(str(next(tmp_path.iterdir())), gripper="own", grips=True)
    model = robot.spec(pictures=False).compile()
    data, site = mujoco.MjData(model), model.site(GRASP).id
    assert robot.tool == GRASP
    assert robot.gripper is not None
    for opening in robot.gripper.widest * np.array([0.3, 0.6, 0.9]):
        data.qpos[:] = robot.posture(np.array([*robot.home, opening]))
        mujoco.mj_kinematics(model, data)
        face = np.array([0.0, -0.006, 0.0185])  # of a pad, at the height of the grasp point
        points = [
            data.geom(tip).xpos + data.geom(tip).xmat.reshape(3, 3) @ (face * [1, side, 1])
            for tip, side in zip(TIPS, (1, -1), strict=True)
        ]
        one, other = (np.array(points) - data.site_xpos[site]) @ data.site_xmat[site].reshape(3, 3)
        assert one[1] - other[1] == pytest.approx(opening, abs=0.001)


def test_force_and_speed_are_those_of_the_file(tmp_path: Path) -> None:
    own, _ = found(FILES["two slides, a servo each"], tmp_path)
    assert own.drive.force == pytest.approx(20.0, rel=1e-4)
    own, _ = found(FILES["an equality and a tendon with commands to 255"], tmp_path)
    assert own.drive.force == pytest.approx(20.0, rel=1e-4)
    own, _ = found(FILES["a mimic joint"], tmp_path)
    assert (own.drive.force, own.drive.speed) == pytest.approx((10.0, 0.08), rel=1e-4)


THREE = "".join(body(f"f{i}", 'type="slide" axis="0 1 0" range="0 0.04"', FINGER.format(side="")) for i in range(3))


@pytest.mark.parametrize(
    ("fingers", "sentence"),
    [
        ("", "no joints beyond the arm's"),
        (THREE, "one or two joints with limits have to move its fingers, and it has 'f0', 'f1', 'f2'"),
        (body("right", 'axis="0 0 1" range="0 0.02"', FINGER.format(side="")), "no"),
    ],
)
def test_why_none_is_recognised_is_said(fingers: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(UnrecognisedError, match=sentence):
        found(ARM.format(fingers=fingers, fixed="", rest=""), tmp_path)


def test_a_file_without_a_gripper_gets_a_parallel_one(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(ARM.format(fingers="", fixed="", rest=""))
    robot = load_robot(str(file), gripper="own", grips=True)
    assert robot.gripper is not None
    assert robot.gripper.widest == 0.08
    assert any(notice.startswith("a parallel gripper is mounted") for notice in robot.notices)


def test_so101_grips_with_its_own_jaw() -> None:
    env = Env(configure("lift", robot="so101", randomise=(), object_size=0.015), 64)
    state, key = env.init(episode_keys(1, REPORT_STREAM, 0, 64)), jax.random.key(0)
    act, transition = make_act(env, "ik"), None
    for _ in range(env.config.rules.max_steps):
        state, transition, key = act(None, state, key)
    assert transition is not None
    assert np.asarray(transition.terms["success"]).mean() >= 0.95
