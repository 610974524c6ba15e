from __future__ import annotations

import re

import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.envs.presets import configure
from reachlab.envs.setup import make_setup
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.derive.frame import frame_of
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.loading import load_robot
from reachlab.settings.validation import InputError

TWO_LINKS = """
<mujoco model="two_links">
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper" pos="0 0 0.5">
      <joint name="shoulder" axis="0 0 1" range="-2 1"/><geom size="0.02"/>
      <body name="lower" pos="0.4 0 0">
        <joint name="elbow" axis="0 1 0" range="-1 1.5"/><geom size="0.02"/>
        <body name="hand" pos="0.3 0 0"><geom size="0.02"/><site name="grip" pos="0.1 0 0"/></body>
      </body>
    </body>
  </worldbody>
  {extra}
</mujoco>"""


@pytest.fixture
def write(tmp_path):
    def write(extra="", text=TWO_LINKS, name="two_links.xml"):
        file = tmp_path / name
        file.write_text(text.replace("{extra}", extra))
        return str(file)

    return write


# --- the iiwa ----------------------------------------------------------------------------------------


def test_iiwa_has_the_limits_of_kukas_tables():
    robot = load_robot("iiwa14")
    np.testing.assert_allclose(np.rad2deg(robot.chain.upper), [170, 120, 170, 120, 170, 120, 175])
    np.testing.assert_allclose(robot.chain.lower, np.negative(robot.chain.upper))
    np.testing.assert_allclose(np.rad2deg(robot.speed), [85, 85, 100, 75, 130, 135, 135])
    np.testing.assert_allclose(robot.torque, [320, 320, 176, 176, 110, 40, 40])


def test_flange_is_45_mm_beyond_link_7_along_its_axis():
    link, flange = load_robot("iiwa14", "link_7"), load_robot("iiwa14", "flange")
    q = jnp.asarray(np.random.default_rng(0).uniform(link.chain.lower, link.chain.upper, (50, 7)), jnp.float32)
    a, b = forward_kinematics(link.chain, q), forward_kinematics(flange.chain, q)
    w, x, y, z = np.moveaxis(np.asarray(a.quaternion), -1, 0)
    z_axis = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], -1)
    np.testing.assert_allclose(b.position - a.position, 0.045 * z_axis, atol=1e-6)
    np.testing.assert_allclose(a.quaternion, b.quaternion, atol=1e-6)


def test_held_orientation_is_the_tutorials():
    """Euler (0, −π, π/2): the tool's z points down, its x along the world's −y."""
    w, x, y, z = load_robot("iiwa14").held_quaternion
    np.testing.assert_allclose([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], [0, 0, -1])
    x_axis = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    np.testing.assert_allclose(x_axis, [0, -1, 0], atol=1e-15)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_tool_of_a_known_robot_starts_inside_limits_and_workspace(name):
    for tool in ROBOTS[name].tools.values():
        robot = load_robot(name, tool)
        n = robot.chain.n
        assert robot.tool == tool
        assert len(robot.home) == len(robot.speed) == len(robot.torque) == n
        assert (np.array(robot.chain.lower) < robot.home).all()
        assert (robot.home < np.array(robot.chain.upper)).all()
        np.testing.assert_allclose(np.linalg.norm(robot.held_quaternion), 1.0)
        position = np.asarray(forward_kinematics(robot.chain, jnp.asarray(robot.home)).position)
        low, high = np.array(robot.workspace)
        assert ((low < position) & (position < high)).all()


def test_the_first_tool_is_the_default_unless_another_kind_is_asked_for():
    for name, known in ROBOTS.items():
        first = next(iter(known.tools.values()))
        assert load_robot(name) == load_robot(name, first)
        for kind, tool in known.tools.items():
            assert load_robot(name, kind=kind) == load_robot(name, tool)
            assert load_robot(name, first, kind=kind) == load_robot(name, first)


# --- a file of one's own -----------------------------------------------------------------------------


def test_own_file_loads_with_its_keyframe_and_a_default_speed(write):
    extra = '<keyframe><key name="rest" qpos="0 0"/><key name="home" qpos="0.3 -0.4"/></keyframe>'
    robot = load_robot(write(extra), "grip")
    assert robot.name == "two_links"
    assert robot.joint_names == ("shoulder", "elbow")
    assert robot.home == (0.3, -0.4)
    assert robot.sources["home"] == "model file"
    assert len(robot.speed) == 2
    assert all(0 < speed < np.inf for speed in robot.speed)
    assert robot.sources["speed"] == robot.sources["torque"] == ("default", "default")


def test_own_arm_of_two_joints_without_a_keyframe_starts_in_the_middle_of_its_limits(write):
    robot = load_robot(write(), "grip")
    np.testing.assert_allclose(robot.home, (-0.5, 0.25), atol=1e-6)
    assert robot.sources["home"] == "derived"


def test_own_file_holds_the_tool_as_it_is_at_home(write):
    robot = load_robot(write(), "grip")
    pose = forward_kinematics(robot.chain, jnp.asarray(robot.home))
    np.testing.assert_allclose(robot.held_quaternion, pose.quaternion, atol=1e-6)


def test_own_file_states_its_speeds_and_torques(write):
    extra = (
        '<custom><numeric name="speed_limit" data="0.5 2"/></custom>'
        '<actuator><motor joint="elbow" forcerange="-7 7"/></actuator>'
    )
    robot = load_robot(write(extra), "grip")
    assert robot.speed == (0.5, 2.0)
    assert robot.torque[1] == 7.0
    assert robot.sources["torque"] == ("default", "model file")


def test_torque_that_no_file_states_is_three_times_what_holds_the_arm_in_its_hardest_pose(write):
    """The elbow holds most when the lower arm is level.

    The shoulder turns about the vertical and holds nothing; it gets what accelerates the stretched arm by 20 rad/s².
    """
    shoulder, elbow = load_robot(write(text=TWO_LINKS.replace("size", 'mass="2" size'))).torque
    np.testing.assert_allclose(shoulder, 20 * 2 * (0.4**2 + 0.7**2), rtol=0.02)
    np.testing.assert_allclose(elbow, 3 * 2 * 9.81 * 0.3, rtol=0.01)


@pytest.mark.parametrize("height", ["0.5", "0.2"], ids=["above the floor", "reaching below it"])
def test_workspace_of_an_own_file_is_a_box_the_tool_can_be_in(write, height):
    robot = load_robot(write(text=TWO_LINKS.replace("0 0 0.5", f"0 0 {height}")), "grip")
    low, high = np.array(robot.workspace)
    q = np.random.default_rng(1).uniform(robot.chain.lower, robot.chain.upper, (2000, 2))
    points = np.asarray(forward_kinematics(robot.chain, jnp.asarray(q, jnp.float32)).position)
    assert (points.min(0) - 1e-3 <= low).all()
    assert (low < high).all()
    assert (high <= points.max(0) + 1e-3).all()
    assert low[2] >= 0.0
    assert ((points >= low) & (points <= high)).all(1).mean() > 0.2
    home = np.asarray(forward_kinematics(robot.chain, jnp.asarray(robot.home)).position)
    assert ((low < home) & (home < high)).all()


@pytest.mark.parametrize(
    ("text", "tool", "at"),
    [
        (TWO_LINKS, "grip", [0.8, 0, 0.5]),
        (re.sub("<site[^>]*/>", "", TWO_LINKS), "hand", [0.7, 0, 0.5]),
        (re.sub("<site[^>]*/>", "", TWO_LINKS).replace('"hand"', '"cover"'), "lower", [0.4, 0, 0.5]),
    ],
    ids=["a site named like a tool", "a body named like one", "the last body that is moved"],
)
def test_tool_of_an_own_file_is_by_default_what_is_named_like_one_at_its_end(write, text, tool, at):
    robot = load_robot(write(text=text))
    assert robot.tool == tool
    np.testing.assert_allclose(forward_kinematics(robot.chain, jnp.zeros(2)).position, at, atol=1e-6)


@pytest.mark.parametrize("limits", ["4 6", "-6 -4", "-1 5"])
def test_own_file_starts_within_its_limits_wherever_they_lie(write, limits):
    robot = load_robot(write(text=TWO_LINKS.replace("-2 1", limits)), "grip")
    assert robot.chain.lower[0] <= robot.home[0] <= robot.chain.upper[0]


def test_joints_of_an_own_file_need_no_names(write):
    text = TWO_LINKS.replace('name="shoulder"', "").replace('name="elbow"', "")
    named, nameless = load_robot(write(), "grip"), load_robot(write(text=text, name="nameless.xml"), "grip")
    assert nameless.home == named.home
    assert nameless.chain.frames == named.chain.frames


ONE_JOINT = """
    <robot name="one">
      <link name="base"/>
      <link name="arm">
        <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
      </link>
      <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0.1 0.2 0.3"/>
        <axis xyz="0 0 1"/><limit lower="-1" upper="2" effort="5" velocity="3"/></joint>
      <link name="tip"/>
      <joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.5 0 0"/></joint>
    </robot>"""


def test_urdf_loads(write):
    robot = load_robot(write(text=ONE_JOINT, name="one.urdf"), "tip")
    assert robot.joint_names == ("turn",)
    assert (robot.speed, robot.torque) == ((3.0,), (5.0,))
    np.testing.assert_allclose((robot.chain.lower[0], robot.chain.upper[0]), (-1, 2))
    np.testing.assert_allclose(forward_kinematics(robot.chain, jnp.zeros(1)).position, [0.6, 0.2, 0.3], atol=1e-7)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("0 0 0", "the frame of 'base', the arm's base"),
        (
            "0.1 0.2 0",
            "the frame of 'world' in the robot's file, where the arm's base 'base' stands at (0.1, 0.2, 0) m",
        ),
    ],
)
def test_the_frame_of_places_is_named_and_where_the_base_stands_in_it(write, place, words):
    fixed = f"""<link name="world"/><joint name="foot" type="fixed"><parent link="world"/><child link="base"/>
        <origin xyz="{place}"/></joint></robot>"""
    robot = load_robot(write(text=ONE_JOINT.replace("</robot>", fixed), name="stood.urdf"), "tip")
    assert frame_of(robot).in_words().startswith(words)
    there = np.array(place.split(), float) + np.array([0.6, 0.2, 0.3])
    np.testing.assert_allclose(forward_kinematics(robot.chain, jnp.zeros(1)).position, there, atol=1e-7)


def test_a_base_that_is_turned_about_is_told():
    assert frame_of(load_robot("ur5e"))[:3] == ("world", "base", (0.0, 0.0, 0.0))
    assert frame_of(load_robot("panda")).in_words() == "the frame of 'base', the arm's base"


# --- refusals ----------------------------------------------------------------------------------------


def test_unknown_robot_is_refused_with_the_nearest_name():
    with pytest.raises(InputError) as refused:
        load_robot("iiwa41")
    assert str(refused.value).startswith("robot 'iiwa41' is not one of: ")
    assert str(refused.value).endswith("Did you mean 'iiwa14'?")


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.xml' does not exist"):
        load_robot(str(tmp_path / "nowhere.xml"))


@pytest.mark.parametrize("text", ["<mujoco><worldbody>", "<mujoco><worldbody><body pos='x'/></worldbody></mujoco>"])
def test_broken_file_is_refused_in_one_line(write, text):
    with pytest.raises(InputError, match="does not compile") as refused:
        load_robot(write(text=text))
    assert "\n" not in str(refused.value)


def test_unknown_tool_is_refused():
    with pytest.raises(InputError, match="robot 'iiwa14': tool 'gripper' is neither a site nor a body") as refused:
        load_robot("iiwa14", "gripper")
    assert "sites link_7, flange and the bodies base, link_1" in str(refused.value)


def test_arm_that_cannot_move_its_tool_is_refused(write):
    file = write(text='<mujoco><worldbody><body name="base"><geom size="1"/></body></worldbody></mujoco>')
    with pytest.raises(InputError, match="no joint moves tool 'base'"):
        load_robot(file, "base")
    with pytest.raises(InputError, match="nothing in it has a name that is moved by a joint"):
        load_robot(file)


def test_tool_on_the_axis_of_the_only_joint_is_refused(write):
    with pytest.raises(InputError, match="the arm's tool stays within a centimetre"):
        load_robot(write(text=ONE_JOINT, name="one.urdf"), "arm")


def test_an_object_is_refused_where_the_hand_has_no_room_for_it(write):
    text = ONE_JOINT.replace('axis xyz="0 0 1"', 'axis xyz="0 1 0"').replace('"-1" upper="2"', '"-0.2" upper="0.2"')
    file = write(text=text, name="one.urdf")
    with pytest.raises(InputError, match="begin 80 mm from its goal, and the hand of robot 'one', which has 1 joint,"):
        make_setup(configure("push", robot=file))


def test_an_arm_that_ends_at_an_earlier_tool_takes_the_first_speed_limits():
    whole, part = load_robot("iiwa14"), load_robot("iiwa14", "link_4")
    assert part.chain.n == 4
    assert part.speed == whole.speed[:4]


def test_speed_limits_of_another_number_of_joints_are_refused(write):
    with pytest.raises(InputError, match="'speed_limit' has to be a positive number for each of the 2 joints"):
        load_robot(write('<custom><numeric name="speed_limit" data="1 2 3"/></custom>'), "grip")
