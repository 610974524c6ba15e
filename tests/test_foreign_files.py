"""What a file of a user's has beside its arm: defaults, other arms, constraints, actuators of other things."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import reachlab
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot
from reachlab.settings.validation import InputError


def arm(prefix: str = "", place: str = "0 0 0") -> str:
    """Three links that bend up and down, one after the other, the last with a tool frame."""
    tip = f'<site name="{prefix}tcp" pos="0 0 0.2"/>'
    for number in reversed(range(3)):
        at, axis = (place, "0 0 1") if number == 0 else ("0 0 0.3", "0 1 0")
        tip = (
            f'<body name="{prefix}l{number}" pos="{at}"><joint name="{prefix}j{number}" axis="{axis}" range="-2 2"/>'
            f'<geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.2" mass="1"/>{tip}</body>'
        )
    return tip


MOTORS = "".join(f'<motor name="m{i}" joint="j{i}"/>' for i in range(3))


def made(tmp_path: Path, bodies: str = arm(), actuators: str = "", more: str = "", tool: str = "tcp") -> Robot:
    file = tmp_path / "mine.xml"
    file.write_text(
        f'<mujoco><compiler angle="radian"/>{more}<worldbody>{bodies}</worldbody>'
        f"<actuator>{actuators}</actuator></mujoco>"
    )
    return load_robot(str(file), tool)


def rest(robot: Robot) -> np.ndarray:
    """Joints `[n]` three seconds after the arm was commanded to 0.3 rad from home, by its own spec."""
    model = robot.spec().compile()
    data = mujoco.MjData(model)
    data.qpos[: robot.chain.n] = robot.at_home
    data.ctrl[: robot.chain.n] = np.add(robot.at_home, 0.3)
    for _ in range(round(3.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return data.qpos[: robot.chain.n] - robot.at_home


@pytest.mark.parametrize(("default", "gear"), [('gear="100"', ""), ("", ' gear="100"')])
def test_defaults_of_the_files_motors_are_not_those_of_the_servos(tmp_path: Path, default: str, gear: str) -> None:
    more = f'<default><motor ctrllimited="true" ctrlrange="-1 1" {default}/></default>'
    robot = made(tmp_path, actuators=MOTORS.replace("<motor", f"<motor{gear}"), more=more)
    np.testing.assert_allclose(robot.torque, 100.0)
    np.testing.assert_allclose(rest(robot), 0.3, atol=0.03)


def test_limits_are_within_what_servos_take(tmp_path: Path) -> None:
    servos = "".join(f'<position joint="j{i}" kp="900" kv="90" ctrlrange="-0.5 0.{4 + i}"/>' for i in range(3))
    robot = made(tmp_path, actuators=servos)
    np.testing.assert_allclose(robot.chain.lower, -0.5)
    np.testing.assert_allclose(robot.chain.upper, [0.4, 0.5, 0.6])
    with pytest.raises(InputError, match=r"joint 'j0' has the position limits -2 to 2, and its servo takes commands"):
        made(tmp_path, actuators=servos.replace("-0.5 0.4", "2.5 3"))


def test_speed_limits_are_those_of_the_arms_joints(tmp_path: Path) -> None:
    two = arm() + arm("right_", "0 2 0")
    limits = '<custom><numeric name="speed_limit" data="1 2 3 4 5 6"/></custom>'
    assert made(tmp_path, two, more=limits, tool="right_tcp").speed == (4.0, 5.0, 6.0)
    assert made(tmp_path, two, more=limits, tool="tcp").speed == (1.0, 2.0, 3.0)


def test_actuators_that_are_not_of_joints_are_none_of_the_arm(tmp_path: Path) -> None:
    motors = MOTORS.replace("<motor", '<motor ctrlrange="-50 50"')
    tendon = '<tendon><fixed name="t"><joint joint="j2" coef="1"/></fixed></tendon>'
    others = '<adhesion body="l2" ctrlrange="0 1" gain="500"/><position tendon="t" kp="500"/>'
    robot = made(tmp_path, actuators=motors + others, more=tendon)
    assert robot.torque == (50.0, 50.0, 50.0)
    assert robot.spec().compile().nu == 3
    np.testing.assert_allclose(rest(robot), 0.3, atol=0.03)


def test_what_holds_an_arm_to_something_that_stands_is_left_out(tmp_path: Path) -> None:
    teleoperated = arm() + '<body name="mocap" mocap="true" pos="0.3 0 0.3"/>'
    robot = made(tmp_path, teleoperated, MOTORS, '<equality><weld body1="mocap" body2="l2"/></equality>')
    assert robot.spec().compile().neq == 0
    np.testing.assert_allclose(rest(robot), 0.3, atol=0.05)
    assert any("connect or weld the arm to something that stands" in notice for notice in robot.notices)


def test_limits_that_seem_to_be_radians_where_the_file_has_degrees_are_noted(tmp_path: Path) -> None:
    file = tmp_path / "degrees.xml"
    file.write_text(f"<mujoco><worldbody>{arm()}</worldbody></mujoco>")
    said = [one.notices for one in (load_robot(str(file), "tcp"), made(tmp_path))]
    assert [any("as if their limits were radians" in notice for notice in one) for one in said] == [True, False]


def test_a_loop_through_the_arm_is_refused(tmp_path: Path) -> None:
    crank = (
        '<body name="crank" pos="0 0.1 0.3"><joint name="driven" axis="0 1 0"/>'
        '<geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.2" mass="0.3"/></body>'
    )
    closed = '<equality><connect body1="crank" body2="l2" anchor="0 0 0.2"/></equality>'
    with pytest.raises(InputError, match="an equality constraint closes a loop through the joint 'j0' and 'j1' and"):
        made(tmp_path, arm() + crank, MOTORS, closed)


def test_a_urdfs_masses_may_come_from_its_meshes(tmp_path: Path) -> None:
    corners = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)]
    faces += [(0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (tmp_path / "cube.obj").write_text("\n".join(lines))
    shape = '<collision><geometry><mesh filename="cube.obj"/></geometry></collision>'
    links = "".join(f'<link name="l{i}">{shape}</link>' for i in range(4))
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="0 1 0"/>'
        '<origin xyz="0 0 0.3"/><limit lower="-1" upper="1" effort="90" velocity="2"/></joint>'
        for i in range(3)
    )
    extension = '<mujoco><compiler inertiafromgeom="true"/></mujoco>'
    (tmp_path / "mine.urdf").write_text(f'<robot name="mine">{extension}{links}{joints}</robot>')
    model = reachlab.load_robot(str(tmp_path / "mine.urdf"), "l3").spec().compile()
    np.testing.assert_allclose(model.body_mass[-3:], 1.0, rtol=1e-6)  # a litre of water each


@pytest.mark.parametrize(
    "elements",
    [
        "<custom>" + "".join(f'<numeric name="n{i}" size="100000" data="0"/>' for i in range(400)) + "</custom>",
        "<asset>"
        + "".join(f'<hfield name="h{i}" nrow="2048" ncol="2048" size="1 1 1 1"/>' for i in range(20))
        + "</asset>",
        "<asset>"
        + "".join(f'<texture name="t{i}" builtin="flat" width="4096" height="4096" type="2d"/>' for i in range(16))
        + "</asset>",
    ],
    ids=["numeric", "hfield", "texture"],
)
def test_a_small_file_that_asks_for_much_memory_is_refused(tmp_path: Path, elements: str) -> None:
    with pytest.raises(InputError, match="textures, height fields and data of more than 33,554,432 numbers together"):
        made(tmp_path, more=elements)


def test_skies_and_cubes_of_usual_sizes_are_read(tmp_path: Path) -> None:
    cubes = "".join(f'<texture name="t{i}" type="cube" builtin="flat" width="680" height="4080"/>' for i in range(4))
    assert made(tmp_path, actuators=MOTORS, more=f"<asset>{cubes}</asset>").chain.n == 3
