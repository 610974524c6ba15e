"""`reachlab robot`: what is told of an arm is what its record holds; and runs of arms from files of one's own."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from reachlab import Robot, RunConfig, load_robot
from reachlab.cli.robot_command import LIMITS, MARKS
from reachlab.envs.presets import configure
from reachlab.envs.setup import make_setup
from reachlab.render.offscreen import portrait
from reachlab.render.scene import drawn_spec, in_front, scene_spec
from reachlab.render.view_randomisation import SAMPLES, make_views
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.files.gripper import GRASP
from reachlab.robots.robot import TUTORIAL_WORKSPACE
from reachlab.runs.directory import RunDirectory
from reachlab.settings.reading import cache_folder
from reachlab.settings.validation import InputError
from reachlab.tasks import TASKS
from reachlab.tasks.camera import FIELD_OF_VIEW
from test_cli import TINY, Said, Shell

AXES = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1")
"""Of the small arm's joints: it turns, bends three times, and turns its tool."""

LENGTHS = (0.0, 0.1, 0.2, 0.2, 0.08)
"""How far each joint is above the one before while the arm is straight [m]."""

BOUNDS = 'lower="-2.5" upper="2.5" effort="30" velocity="2"'
UNSTATED = 'lower="-2.9" upper="2.9" effort="0" velocity="0"'
RESISTING = '<dynamics damping="16" friction="1"/>'

GANTRY = """
<mujoco model="gantry">
  <compiler angle="radian"/>
  <worldbody>
    <body name="cart" pos="0 0 0.6">
      <inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
      <joint name="rail" type="slide" axis="1 0 0" range="0.1 0.9"/>
      <body name="beam" pos="0 0 0">
        <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
        <joint name="cross" type="slide" axis="0 1 0" range="-0.4 0.4"/>
        <body name="rod" pos="0 0 0">
          <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
          <joint name="lift" type="slide" axis="0 0 1" range="-0.5 0.1" damping="1"/>
          <site name="tool" pos="0 0 -0.1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="rail" kp="400" kv="39" forcerange="-50 50"/>
    <position joint="cross" kp="400" kv="40"/>
    <position joint="lift" kp="900" kv="44"/>
  </actuator>
  <keyframe><key name="home" qpos="0.5 0 -0.2"/></keyframe>
</mujoco>"""


def small_arm() -> str:
    """URDF of an arm of five joints, whose meshes lie in the package `parts`."""
    inertial = (
        '<inertial><mass value="0.5"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    visual = '<visual><geometry><mesh filename="package://parts/tetrahedron.stl"/></geometry></visual>'
    text = '<robot name="small"><link name="stand"/><link name="base"/>'
    text += '<joint name="mount" type="prismatic"><parent link="stand"/><child link="base"/><axis xyz="0 0 1"/>'
    text += f"<limit {BOUNDS}/></joint>"
    above = "base"
    for number, (axis, length) in enumerate(zip(AXES, LENGTHS, strict=True)):
        text += f'<link name="part{number}">{inertial}{visual}</link>'
        text += f'<joint name="j{number}" type="revolute"><parent link="{above}"/><child link="part{number}"/>'
        text += (
            f'<origin xyz="0 0 {length}"/><axis xyz="{axis}"/><limit {UNSTATED if number == 4 else BOUNDS}/>'
            f"{RESISTING if number in (0, 4) else ''}</joint>"
        )
        above = f"part{number}"
    text += '<link name="tool0"/><joint name="end" type="fixed"><parent link="part4"/><child link="tool0"/>'
    return text + '<origin xyz="0 0 0.1"/></joint></robot>'


def tetrahedron() -> bytes:
    """A binary STL file."""
    corners = 0.03 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    faces = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    return (
        bytes(80)
        + struct.pack("<I", 4)
        + b"".join(struct.pack("<12fH", 0, 0, 0, *corners[list(face)].ravel(), 0) for face in faces)
    )


@pytest.fixture(scope="module")
def arms(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with arms, and below `lib/` the package of one; what is derived is kept in a folder beside it."""
    folder = tmp_path_factory.mktemp("arms")
    (folder / "small.urdf").write_text(small_arm())
    (folder / "gantry.xml").write_text(GANTRY)
    (folder / "lib").mkdir()
    (folder / "lib" / "tetrahedron.stl").write_bytes(tetrahedron())
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAX_COMPILATION_CACHE_DIR", str(cache_folder() / "jax"))
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield folder


@pytest.fixture
def reachlab(capsys: pytest.CaptureFixture[str], arms: Path, monkeypatch: pytest.MonkeyPatch) -> Shell:
    monkeypatch.chdir(arms)
    return Shell(capsys)


OF_SMALL = ("small.urdf", "--base", "base", "--package", "parts=lib")
"""Words that name the small arm."""


def the_small_one(arms: Path) -> Robot:
    return load_robot(str(arms / "small.urdf"), base="base", packages=(f"parts={arms / 'lib'}",))


def as_json(said: Said) -> Any:
    assert said.status == 0, said.err
    return json.loads(said.out)


def check_joints(told: list[dict[str, Any]], robot: Robot) -> None:
    assert tuple(joint["name"] for joint in told) == robot.joint_names
    for number, joint in enumerate(told):
        assert joint["type"] == ("slide" if robot.chain.slides[number] else "hinge")
        assert (joint["lower"], joint["upper"]) == (robot.chain.lower[number], robot.chain.upper[number])
        assert (joint["speed"], joint["home"]) == (robot.speed[number], robot.home[number])
        assert joint["torque"] == (robot.torque[number] if np.isfinite(robot.torque[number]) else None)
        assert {what: joint["sources"][what] for what in (*LIMITS, "home")} == {
            **{what: robot.sources[what][number] for what in LIMITS},
            "home": robot.sources["home"],
        }
        assert set(joint["sources"].values()) <= set(MARKS)


# --- what is told ---------------------------------------------------------------------------------


@pytest.mark.parametrize("words", [("iiwa14",), OF_SMALL, ("gantry.xml",)], ids=lambda words: words[0])
def test_what_is_told_is_what_the_record_holds(reachlab: Shell, arms: Path, words: tuple[str, ...]) -> None:
    told = as_json(reachlab("robot", *words, "--json"))
    robot = the_small_one(arms) if words is OF_SMALL else load_robot(words[0])
    assert (told["name"], told["kind"], told["tool"]) == (robot.name, robot.model.kind, robot.tool)
    assert Path(told["file"]).name == robot.model.file.name
    check_joints(told["joints"], robot)
    for name, box in (("workspace", robot.workspace), ("goal_box", robot.goal_box)):
        assert (told[name]["low"], told[name]["high"]) == tuple(map(list, box))
        assert (told[name]["source"], told[name]["share"]) == (robot.sources[name], robot.shares.get(name))
    assert (told["mass"], told["payload"], told["scale"]) == (robot.mass, robot.payload, robot.scale)
    assert told["notices"] == list(robot.notices)


def test_a_person_reads_the_same_figures(reachlab: Shell, arms: Path) -> None:
    robot, said = the_small_one(arms), reachlab("robot", *OF_SMALL)
    assert said.status == 0, said.err
    assert said.out.startswith("small: URDF, ")
    assert "Tool frame: tool0 (named like a tool)." in said.out
    assert "Other frames for --tool: part4." in said.out
    rows = [line for line in said.out.splitlines() if line.startswith("│")]
    for number, row in enumerate(rows):
        assert robot.joint_names[number] in row
        lower, upper, home = np.degrees([robot.chain.lower[number], robot.chain.upper[number], robot.home[number]])
        assert f"{lower:.1f} to {upper:.1f}° f" in row
        assert f"{home:.1f}° d" in row
    assert "115°/s f" in rows[0]
    assert "30 Nm f" in rows[0]
    assert "85.9°/s *" in rows[4]  # nothing stated: the default of 1.5 rad/s
    assert f"{robot.torque[4]:.4g} Nm *" in rows[4]
    assert f"Size: {robot.scale:.3g} times the tutorial's arm" in said.out
    assert f"within {1000 * 0.1 * robot.scale:.4g} mm of it" in said.out
    assert f"displaces the tool by {1000 * 0.005 * robot.scale:.3g} mm" in said.out
    assert "Next: reachlab train --robot small.urdf --base base --package parts=lib" in said.err


def test_servos_that_are_derived_follow_in_a_tenth_of_a_second(reachlab: Shell) -> None:
    for joint in as_json(reachlab("robot", *OF_SMALL, "--json"))["joints"]:
        assert joint["sources"]["servo"] == "derived"
        assert joint["lag"] == pytest.approx(0.1)
        assert joint["frequency"] >= 20 * (1 - 1e-6)
        assert joint["damping"] == pytest.approx(0.1 * joint["stiffness"])


def test_a_joint_that_its_own_damping_slows_down_is_named(reachlab: Shell) -> None:
    said = reachlab("robot", *OF_SMALL)
    assert "than what gravity, friction and damping take at full speed: j0 has 30 of 33 Nm." in " ".join(
        said.err.split()
    )


def test_servos_of_the_file_are_told_as_they_are(reachlab: Shell) -> None:
    rail, cross, lift = as_json(reachlab("robot", "gantry.xml", "--json"))["joints"]
    assert [(joint["stiffness"], joint["damping"]) for joint in (rail, cross, lift)] == [
        (400, 39),
        (400, 40),
        (900, 45),
    ]
    assert [joint["sources"]["servo"] for joint in (rail, cross, lift)] == ["model file"] * 3
    assert (rail["torque"], cross["torque"]) == (50, None)
    # What moves with a rail is all above it and the payload.
    payload = as_json(reachlab("robot", "gantry.xml", "--json"))["payload"]
    assert rail["frequency"] == pytest.approx((400 / (4 + payload * (1 + 0.4 * 0.05**2))) ** 0.5, rel=1e-6)
    assert lift["lag"] == pytest.approx(0.05)


def test_slides_are_told_in_metres(reachlab: Shell) -> None:
    said = reachlab("robot", "gantry.xml")
    assert "0.100 to 0.900 m f" in said.out
    assert "50 N f" in said.out
    assert "1.5 m/s *" in said.out


# --- the tool frame -------------------------------------------------------------------------------


def test_the_catalogues_tool_is_the_one_of_the_task(reachlab: Shell) -> None:
    told = as_json(reachlab("robot", "iiwa14", "--json"))
    assert (told["tool"], told["tool_found"]) == ("link_7", "catalogue")
    assert told["catalogue_tools"] == dict(ROBOTS["iiwa14"].tools)
    assert {name: task["tool"] for name, task in told["tasks"].items()} == {
        name: {"tutorial": "link_7"}.get(name, GRASP if TASKS[name].load()().mounts else "flange") for name in TASKS
    }
    told = as_json(reachlab("robot", "iiwa14", "--task", "precise", "--json"))
    assert (told["tool"], set(told["tasks"])) == ("flange", {"precise"})
    assert told["next"] == "reachlab train --robot iiwa14 --task precise"


def test_a_tool_that_is_told_is_taken(reachlab: Shell) -> None:
    told = as_json(reachlab("robot", *OF_SMALL, "--tool", "part3", "--json"))
    assert (told["tool"], told["tool_found"], len(told["joints"])) == ("part3", "told", 4)
    assert told["tool_frames"] == ["part4", "tool0"]
    assert "--tool part3" in told["next"]


@pytest.mark.slow
def test_without_a_base_the_joint_below_it_belongs_to_the_arm(reachlab: Shell) -> None:
    told = as_json(reachlab("robot", "small.urdf", "--package", "parts=lib", "--json"))
    assert [joint["name"] for joint in told["joints"]] == ["mount", "j0", "j1", "j2", "j3", "j4"]


def test_what_is_missing_is_told(reachlab: Shell) -> None:
    said = reachlab("robot", "small.urdf", "--base", "base")
    assert said.status == 0
    assert "Note: " in said.err
    assert "tetrahedron.stl" in said.err


def test_deriving_is_told_once(arms: Path, caplog: pytest.LogCaptureFixture) -> None:
    (arms / "other.xml").write_text(GANTRY.replace("0.9", "0.8").replace(' name="home"', ""))
    load_robot(str(arms / "other.xml"))
    assert "finding home and workspace of other.xml" in caplog.text
    caplog.clear()
    (arms / "again.xml").write_text((arms / "other.xml").read_text())
    load_robot(str(arms / "again.xml"))
    assert "finding" not in caplog.text


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((), "robot needs one: name iiwa14, .*or the path of an MJCF or URDF file"),
        (("iiwa15",), "Did you mean 'iiwa14'"),
        (("iiwa14", "--task", "precis"), "Did you mean 'precise'"),
        (("iiwa14", "--out", "arm.gif"), "'arm.gif': name a file that ends in .png"),
        (("iiwa14", "--out", "no/arm.png"), "there is no folder 'no'"),
        (("gantry.xml", "--tool", "hook"), "'hook' is neither a site nor a body.*`reachlab robot .*gantry.xml` shows"),
        (("gantry.xml", "--base", "floor"), "base 'floor' is no body of the model, which has cart, beam, rod"),
        (("small.urdf", "--package", "parts=nowhere"), "a package is NAME=FOLDER with a folder that exists"),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, tuple) else "",
)
def test_what_does_not_fit_is_refused_in_a_sentence(reachlab: Shell, words: tuple[str, ...], sentence: str) -> None:
    said = reachlab("robot", *words)
    assert (said.status, said.out, said.err.count("\n")) == (2, "", 1)
    assert re.search(sentence, said.err), said.err


# --- pictures -------------------------------------------------------------------------------------


def test_the_picture_shows_the_arm(reachlab: Shell) -> None:
    said = reachlab("robot", *OF_SMALL, "--out", "arm.png")
    if "OpenGL" in said.err:
        pytest.skip(said.err)
    assert "Written: arm.png" in said.out
    with Image.open("arm.png") as picture:
        assert picture.size == (960, 720)
        red, green, _ = np.moveaxis(np.asarray(picture, int), -1, 0)
    rows, columns = np.nonzero(red > green + 80)
    assert len(rows) > 50, "the target is seen"
    assert 200 < rows.mean() < 600
    assert 200 < columns.mean() < 760


def test_a_portrait_shows_the_tool_frame_and_leaves_a_margin_around_the_arm() -> None:
    robot = load_robot("so101")
    try:
        picture = portrait(robot, 480, 360).astype(int)
    except InputError as error:
        pytest.skip(str(error))
    red, green, blue = np.moveaxis(picture, -1, 0)
    for one, *others in ((green, red, blue), (blue, red, green)):
        assert (one > np.maximum(*others) + 50).sum() > 10, "an axis is seen"
    yellow = (red > blue + 80) & (green > blue + 60)
    assert yellow.any()
    assert not yellow[: 360 // 20].any()


def test_an_arm_without_shapes_is_drawn_as_rods(arms: Path) -> None:
    bare = load_robot(str(arms / "gantry.xml"))
    assert drawn_spec(bare).compile().ngeom > bare.spec().compile().ngeom
    shown = the_small_one(arms)
    assert drawn_spec(shown).compile().ngeom == shown.spec().compile().ngeom


def test_the_scene_has_the_size_of_the_arm(arms: Path) -> None:
    small, iiwa = the_small_one(arms), load_robot("iiwa14")
    sizes = [scene_spec(robot).compile().geom("target").size[0] for robot in (small, iiwa)]
    assert sizes[0] == pytest.approx(small.scale * sizes[1])
    assert np.array_equal(in_front(iiwa, (1.5, -1.1, 0.95)), (1.5, -1.1, 0.95))


def test_the_observation_camera_sees_the_floor_of_every_workspace(arms: Path) -> None:
    edge = np.tan(np.radians(FIELD_OF_VIEW / 2))
    for robot in (load_robot("iiwa14"), the_small_one(arms), load_robot(str(arms / "gantry.xml"))):
        views = make_views(np.zeros((1, SAMPLES)), robot)
        (x0, y0, floor), (x1, y1, _) = robot.workspace
        for corner in ((x0, y0, floor), (x0, y1, floor), (x1, y0, floor), (x1, y1, floor)):
            right, up, back = views.rotation[0].T @ (np.array(corner) - views.position[0])
            assert max(abs(right), abs(up)) < edge * -back


# --- runs of it -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_finds_its_arm_from_any_folder(
    reachlab: Shell, arms: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    said = reachlab("train", "--robot", *OF_SMALL, "--out", out, *TINY.split())
    assert said.status == 0, said.err
    config = RunDirectory(out).read_config()
    assert (config.robot, config.base) == (str(arms / "small.urdf"), "base")
    assert config.package == (f"parts={arms / 'lib'}",)
    monkeypatch.chdir(tmp_path)
    assert len(make_setup(config).robot.spec().meshes) > 0
    said = reachlab("eval", "run", "--agent", "trained", "ik", "--episodes", 5, "--json")
    assert [report["robot"] for report in as_json(said)] == ["small", "small"]
    for verb, *words in (("video", "--fps", 5), ("view", "--out", "page.html")):
        said = reachlab(verb, "run", "--agent", "ik", "--episodes", 1, *words)
        assert said.status == 0 or "OpenGL" in said.err, said.err


def test_baselines_need_no_run(reachlab: Shell) -> None:
    said = reachlab("eval", "--agent", "ik", "--episodes", 20, "--json", "--robot", *OF_SMALL, "--tool", "tool0")
    report = as_json(said)
    assert report["robot"] == "small"
    assert report["success_rate"] == 1
    assert "leave --base and --package out" in reachlab("eval", "panda/lift", "--base", "base", "--package", "a=b").err


def test_folders_of_packages_are_kept_whole(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert RunConfig(package=("parts=lib",)).package == (f"parts={tmp_path / 'lib'}",)
    assert configure(package=("parts=/lib",)).package == ("parts=/lib",)
    with pytest.raises(InputError, match="a package is NAME=FOLDER"):
        make_setup(configure(robot="arm.urdf", package=("parts",)))


def test_the_tutorials_arm_has_the_tutorials_size() -> None:
    robot = load_robot("iiwa14")
    assert robot.scale == 1.0
    assert robot.workspace == TUTORIAL_WORKSPACE
