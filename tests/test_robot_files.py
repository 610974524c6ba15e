"""Model files of robots: what is read in them, and that a hostile one does no harm."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from faults.robot_files import HOSTILE
from faults.robot_parts import JOINT, LINK, mesh_of, mjcf, obj, png, stl, urdf
from reachlab.robots.derive.arm import find_arm
from reachlab.robots.files.model_file import read_model_file
from reachlab.robots.files.repair import balance
from reachlab.robots.files.urdf import JointFacts
from reachlab.settings.validation import InputError

SLOWEST, MOST_MEMORY = 10.0, 500 * 2**20
"""A hostile file is refused within this time [s] and memory [bytes]."""


@pytest.fixture
def write(tmp_path):
    def write(text, name="arm.urdf", **files):
        folder = tmp_path / "robot" / "urdf"
        folder.mkdir(parents=True, exist_ok=True)
        for other, data in files.items():
            path = tmp_path / "robot" / other.replace("__", "/").replace("_dot_", ".")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data if isinstance(data, bytes) else data.encode())
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
        return folder / name

    return write


def names(model, kind):
    return [
        mujoco.mj_id2name(model, kind, i)
        for i in range(model.nbody if kind == mujoco.mjtObj.mjOBJ_BODY else model.njnt)
    ]


def assert_same_robot(model_file):
    bare, drawn = model_file.spec(pictures=False).compile(), model_file.spec().compile()
    for kind in (mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_JOINT):
        assert names(bare, kind) == names(drawn, kind)
    for part in ("body_mass", "body_inertia", "body_ipos", "body_pos", "jnt_axis", "jnt_range", "jnt_actfrcrange"):
        np.testing.assert_allclose(getattr(bare, part), getattr(drawn, part), atol=1e-9)
    return bare, drawn


# --- files that mean harm ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tried(tmp_path_factory):
    child = subprocess.run(
        [sys.executable, "-m", "faults.robot_trial", str(tmp_path_factory.mktemp("hostile"))],
        capture_output=True, text=True, timeout=120, check=False,
        env={"PYTHONPATH": f"{Path(__file__).parent}:{Path(__file__).parents[1] / 'src'}", "PATH": "", "HOME": "/root"},
    )  # fmt: skip
    found = {entry["name"]: entry for entry in map(json.loads, child.stdout.splitlines())}
    assert child.returncode == 0, f"died after {list(found)[-1:]}: {child.stderr[-500:]}"
    return found


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_file_is_refused_in_one_sentence_or_read_without_its_harm(name, tried):
    entry = tried[name]
    assert HOSTILE[name][1] in entry["said"]
    assert "\n" not in entry["said"]
    assert len(entry["said"]) < 700
    assert entry["outside"] == []
    assert entry["took"] < SLOWEST
    assert entry["peak"] < MOST_MEMORY


# --- foreign robots ----------------------------------------------------------------------------------


def foreign_files():
    """Robots of packages that are installed here, if any; none of them belongs to this project."""
    places = {"pybullet_data": ["franka_panda/panda.urdf", "xarm/xarm6_robot.urdf"]}
    for package, files in places.items():
        if (found := importlib.util.find_spec(package)) and found.origin:
            origin = Path(found.origin)
            yield from (origin.parent / file for file in files)
    robots = Path(mujoco.__file__).parents[1] / "cmeel.prefix/share/example-robot-data/robots"
    for file in (
        "panda_description/urdf/panda.urdf", "ur_description/urdf/ur3_robot.urdf", "ur_description/urdf/ur5_robot.urdf",
        "ur_description/urdf/ur10_robot.urdf", "xarm_description/urdf/xarm7.urdf", "so_arm_description/urdf/so100.urdf",
        "so_arm_description/urdf/so101.urdf", "kinova_description/robots/kinova.urdf", "z1_description/urdf/z1.urdf",
    ):  # fmt: skip
        if (robots / file).is_file():
            yield robots / file


@pytest.mark.parametrize("file", list(foreign_files()), ids=lambda file: f"{file.parts[-3]}-{file.stem}")
def test_foreign_robot_reads(file):
    model_file = read_model_file(file)
    bare, _ = assert_same_robot(model_file)
    assert bare.njnt >= 6
    assert bare.nmesh == 0
    speeds = [model_file.joints[name].speed for name in names(bare, mujoco.mjtObj.mjOBJ_JOINT)]
    assert all(speed is None or speed > 0 for speed in speeds)


# --- URDF --------------------------------------------------------------------------------------------


def test_speeds_torques_and_followers_are_read_from_the_text(write):
    more = LINK.format("tip", "") + (
        '<joint name="finger" type="prismatic"><parent link="arm"/><child link="tip"/><limit lower="0" upper="1"/>'
        '<mimic joint="base_arm"/></joint>'
    )
    model_file = read_model_file(write(urdf(more)))
    assert model_file.kind == "URDF"
    assert model_file.joints == {
        "base_arm": JointFacts(speed=2.0),
        "finger": JointFacts(mimics="base_arm"),
    }
    assert model_file.notices == ()
    bare, _ = assert_same_robot(model_file)
    np.testing.assert_allclose(bare.jnt_actfrcrange[0], [-5, 5])
    np.testing.assert_allclose(bare.jnt_axis[1], [1, 0, 0])


def test_every_link_and_shape_of_a_urdf_is_kept(write):
    text = urdf(LINK.format("tip", ""), JOINT.format("arm", "tip", "fixed", "1 0 0", "1"), child=mesh_of("../a.stl"))
    model_file = read_model_file(write(text, a_dot_stl=stl()))
    _, drawn = assert_same_robot(model_file)
    assert names(drawn, mujoco.mjtObj.mjOBJ_BODY) == ["world", "base", "arm", "tip"]
    assert (drawn.nmesh, drawn.ngeom) == (1, 1)


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("../a.stl", "a_dot_stl"),
        ("..\\meshes\\a.stl", "meshes__a_dot_stl"),
        ("package://robot/meshes/a.stl", "meshes__a_dot_stl"),
        ("model://meshes/a.stl", "meshes__a_dot_stl"),
        ("package://renamed/meshes/a.stl", "meshes__a_dot_stl"),
        ("package://given/a.stl", "elsewhere__a_dot_stl"),
        ("package://ros/a.stl", "ros1__ros__a_dot_stl"),
        ("package://ament/a.stl", "ros2__share__ament__a_dot_stl"),
    ],
)
def test_mesh_is_found(name, place, write, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "robot/ros1"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "robot/ros2"))
    files = {place: stl(), "package_dot_xml": "<package><name>renamed</name></package>"}
    model_file = read_model_file(write(urdf(child=mesh_of(name)), **files), {"given": tmp_path / "robot/elsewhere"})
    assert model_file.notices == ()
    assert model_file.spec().compile().nmesh == 1


@pytest.mark.parametrize("named", [True, False])
def test_links_lead_out_of_packages_that_the_user_names_alone(named, write, tmp_path, monkeypatch):
    kept = tmp_path / "source" / "a.stl"
    kept.parent.mkdir()
    kept.write_bytes(stl())
    for package in ("installed", "robot/beside"):
        folder = tmp_path / package / ("share/given" if package == "installed" else "")
        folder.mkdir(parents=True)
        (folder / "a.stl").symlink_to(kept)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "installed"))
    name = "package://given/a.stl" if named else "package://beside/a.stl"
    drawn = read_model_file(write(urdf(child=mesh_of(name)))).spec().compile()
    assert drawn.nmesh == named
    for outside in (f"package://given/{kept}", "package://given/../../../source/a.stl"):
        file = write(urdf(child=mesh_of(outside)), "outside.urdf")
        assert "1 were not found in the folders of their packages" in read_model_file(file).notices[0]


def test_collision_shapes_are_drawn_of_links_alone_that_have_no_others(write):
    solid = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    seen = '<visual><geometry><sphere radius="1"/></geometry></visual>'
    for child, groups in ((solid + seen, [1, 3]), (solid, [0]), (solid + mesh_of("gone.stl"), [0])):
        assert sorted(read_model_file(write(urdf(child=child))).spec().compile().geom_group) == groups


def test_a_mesh_in_millimetres_and_why_one_is_not_read_are_told(write, caplog):
    files = {"m__a_dot_stl": stl(5000.0), "m__b_dot_stl": stl(faces=9)}
    read_model_file(write(urdf(child=mesh_of("../m/a.stl")), **files)).spec()
    assert "a mesh of arm is 5e+03 m long: are its vertices in millimetres?" in caplog.text
    read_model_file(write(urdf(child=mesh_of("../m/b.stl")), "b.urdf")).spec()
    assert "MuJoCo does not read b.stl (stl_decoder: STL file 'b.stl' has wrong size" in caplog.text


def test_what_stands_beside_the_arm_is_told(write):
    box = '<link name="table"><collision><geometry><box size="1 1 1"/></geometry></collision></link>'
    fixed = '<joint name="t" type="fixed"><parent link="base"/><child link="table"/></joint>'
    arm = find_arm(read_model_file(write(urdf(box, fixed))), "arm", None)
    assert arm.notices[0].startswith("Solid things stand beside the arm: table.")


def test_meshes_that_are_not_drawn_are_told_in_one_line(write):
    child = "".join(mesh_of(name) for name in ("a.dae", "b.dae", "c.stl"))
    child += '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    model_file = read_model_file(write(urdf(child=child)))
    assert len(model_file.notices) == 1
    assert model_file.notices[0].startswith(
        "3 files of meshes or textures are not drawn: 2 are .dae, which MuJoCo does"
    )
    assert "c.stl" in model_file.notices[0]
    assert model_file.spec().compile().geom_contype == [1]


def test_two_meshes_of_one_name_and_of_two_scales_stay_apart(write):
    shapes = [mesh_of(name) for name in ("../a/x.stl", "../b/x.stl")]
    shapes.append(shapes[0].replace("/></g", ' scale="2 2 2"/></g'))
    files = {"a__x_dot_stl": stl(), "b__x_dot_stl": stl(-1.0)}
    drawn = read_model_file(write(urdf(child="".join(shapes)), **files)).spec().compile()
    assert drawn.nmesh == 3
    sizes = sorted(
        np.ptp(drawn.mesh_vert[s : s + n], axis=0).max()
        for s, n in zip(drawn.mesh_vertadr, drawn.mesh_vertnum, strict=True)
    )
    assert sizes[2] > sizes[0] * 1.3


def test_moving_link_without_a_mass_gets_a_small_one(write):
    text = urdf().replace('<mass value="1"/>', '<mass value="0"/>')
    model_file = read_model_file(write(text))
    assert model_file.notices == ("Moving bodies without a mass get 0.01 kg: arm.",)
    bare, _ = assert_same_robot(model_file)
    np.testing.assert_allclose(bare.body_mass, [0, 0, 0.01])


def test_impossible_inertia_is_balanced_and_told(write):
    text = urdf().replace('izz="1"', 'izz="5"', 1).replace('izz="1"', 'izz="2"')
    model_file = read_model_file(write(text))
    assert model_file.notices == ("Inertias that no rigid body has are replaced by the nearest possible: base.",)
    bare, _ = assert_same_robot(model_file)
    np.testing.assert_allclose(sorted(bare.body_inertia[1]), [2, 2, 4], rtol=1e-6)
    np.testing.assert_allclose(sorted(bare.body_inertia[2]), [1, 1, 2], rtol=1e-6)


def test_balanced_inertias_are_those_of_rigid_bodies_and_possible_ones_stay():
    for inertia in np.random.default_rng(0).normal(size=(200, 3, 3)):
        symmetric = inertia + inertia.T
        a, b, c = np.linalg.eigvalsh(balance(symmetric, 1.0))
        assert a > 0
        assert a + b >= c * (1 - 1e-12)
    for rod in ((0.0, 0.01, 0.01), (0.01, 0.0, 0.01), (-0.01, 0.01, 0.01)):
        a, b, c = np.linalg.eigvalsh(balance(np.diag(rod), 1.0))
        assert a + b >= c
        np.testing.assert_allclose([a, b, c], [0.0, 0.01, 0.01], atol=1e-6)
    possible = np.diag([2.0, 3.0, 4.0])
    np.testing.assert_array_equal(balance(possible, 1.0), possible)


def test_a_thin_rod_is_read(write):
    rods = read_model_file(write(urdf().replace('ixx="1"', 'ixx="0"')))
    assert rods.notices[0].startswith("Inertias that no rigid body has are replaced by the nearest possible: base")


def test_floating_base_stands_still(write):
    model_file = read_model_file(write(urdf(kind="floating")))
    assert model_file.notices == ("Floating joints are taken as fixed, so that the arm stands on its base: base_arm.",)
    assert model_file.spec().compile().njnt == 0


def test_extension_of_mujoco_of_urdf_is_kept(write):
    text = urdf(
        '<mujoco><compiler meshdir="../meshes" strippath="true"/><option timestep="0.5"/></mujoco>',
        child=mesh_of("x/a.stl"),
    )
    model_file = read_model_file(write(text, meshes__a_dot_stl=stl()))
    drawn = model_file.spec().compile()
    assert (drawn.nmesh, drawn.opt.timestep) == (1, 0.5)


def test_comments_that_are_never_closed_are_looked_at_once(write):
    with pytest.raises(InputError, match="more than 20,000 XML tags"):
        read_model_file(write('<robot name="r">' + "<!--" * 50_000))


@pytest.mark.parametrize("number", ["0x1p900", "-0X1P900", "0x1p99999", "nan(1)", "-NaN(2)"])
def test_numbers_that_mujoco_alone_reads_are_refused(number, write):
    with pytest.raises(InputError, match="finite numbers up to"):
        read_model_file(write(limited(f'<origin xyz="0 0 {number}"/>')))


@pytest.mark.parametrize("what", ["damping", "frictionloss", "armature"])
def test_joints_that_would_push_themselves_are_refused(what, write):
    text = f'<mujoco><worldbody><body><joint name="j" {what}="-5"/><geom size="1"/></body></worldbody></mujoco>'
    with pytest.raises(InputError, match="gives joint 'j' a negative damping, friction or armature"):
        read_model_file(write(text, "arm.xml"))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_encodings_and_loose_comments_are_read(encoding, write):
    text = "\n\n<!-- a -- b -->\n" * (encoding == "utf-8") + urdf().replace('name="r"', 'name="ä"')
    assert read_model_file(write(text.encode(encoding))).spec().modelname == "ä"


LIMITS = '<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>{}</joint>'


def limited(limits):
    return f'<robot name="r">{LINK.format("base", "")}{LINK.format("arm", "")}{LIMITS.format(limits)}</robot>'


@pytest.mark.parametrize(
    ("limits", "why"),
    [
        ('<limit lower="2" upper="-2"/>', "has the position limits 2 to -2: the upper one has to be the larger one"),
        ('<limit lower="1" upper="1"/>', "has the position limits 1 to 1: the upper"),
        (
            '<limit lower="-1" upper="1"/><safety_controller soft_lower_limit="1" soft_upper_limit="2"/>',
            "has the position limits 1 to 1: the upper",
        ),
        ('<limit lower="-1" upper="1" velocity="x"/>', "velocity='x' of <limit>, which must be a number."),
        ('<limit lower="-1" upper="1"/><origin xyz="0 0"/>', "'xyz' does not have enough data"),
        ('<limit lower="-1" upper="1" velocity="-2"/>', "'j' a negative limit of speed or torque"),
        ('<limit lower="-1" upper="1" effort="-5"/>', "'j' a negative limit of speed or torque"),
    ],
)
def test_limits_without_sense_are_refused(write, limits, why):
    with pytest.raises(ValueError, match=why):
        find_arm(read_model_file(write(limited(limits))), None, None)


@pytest.mark.parametrize(
    ("limits", "lower", "upper", "noted"),
    [
        ('<limit lower="-2"/>', -2.0, 0.0, ""),
        ('<limit upper="2"/>', 0.0, 2.0, ""),
        ('<limit lower="0" upper="0"/>', -2 * np.pi, 2 * np.pi, "from 0 to 0 are taken as none"),
        ('<limit lower="-150" upper="150"/>', -2 * np.pi, 2 * np.pi, "beyond ±100 rad or m are taken as none"),
        (
            '<limit lower="-1" upper="1"/><safety_controller soft_lower_limit="-0.5" soft_upper_limit="2"/>',
            -0.5, 1.0, "narrowed to the soft limits",
        ),
        ('<limit lower="-1" upper="1"/><safety_controller soft_upper_limit="0.5"/>', -1.0, 0.5, "narrowed"),
        ('<limit lower="-1" upper="1"/><safety_controller k_velocity="20"/>', -1.0, 1.0, ""),
    ],
)  # fmt: skip
def test_limits_that_are_changed_are_noted(write, limits, lower, upper, noted):
    model_file = read_model_file(write(limited(limits)))
    arm = find_arm(model_file, None, None)
    assert (*arm.chain.lower, *arm.chain.upper) == pytest.approx((lower, upper))
    notices = " ".join(model_file.notices + arm.notices)
    assert notices.endswith(": j.") == bool(noted)
    assert noted in notices


# --- MJCF --------------------------------------------------------------------------------------------


def test_includes_folders_and_names_of_meshes_are_kept(write):
    top = '<compiler assetdir="../assets"/><asset><mesh file="a/x.obj"/><include file="more.xml"/></asset>'
    model_file = read_model_file(
        write(mjcf('<geom type="mesh" mesh="x" mass="0"/><geom type="mesh" mesh="y" mass="0"/>', top), "arm.xml",
              urdf__more_dot_xml='<mujocoinclude><mesh name="y" file="b/x.obj"/></mujocoinclude>',
              assets__a__x_dot_obj=obj(), assets__b__x_dot_obj=obj())
    )  # fmt: skip
    assert (model_file.kind, model_file.notices, model_file.joints) == ("MJCF", (), {})
    bare, drawn = assert_same_robot(model_file)
    assert [drawn.mesh(i).name for i in range(2)] == ["x", "y"]
    assert (bare.nmesh, bare.ngeom, drawn.ngeom) == (0, 1, 3)


GRIPPED = """
<mujoco>
  <worldbody>
    <body name="upper"><joint name="a" range="-90 90"/><geom size="0.1"/>
      <body name="fore" pos="0.4 0 0"><joint name="b" axis="0 1 0" range="-90 90"/><geom size="0.1"/>
        <body name="hand" pos="0.4 0 0"><joint name="c" axis="0 1 0" range="-90 90"/><geom size="0.1"/>
          <body name="left"><joint name="l" type="slide" range="0 0.1"/><geom size="0.01"/></body>
          <body name="right"><joint name="r" type="slide" range="0 0.1"/><geom size="0.01"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  {}
</mujoco>"""


def tendon(first, second):
    return (
        f'<tendon><fixed name="t"><joint joint="{first}" coef="1"/><joint joint="{second}" coef="1"/></fixed></tendon>'
    )


@pytest.mark.parametrize(
    ("coupling", "why"),
    [
        (
            '<equality><joint joint1="c" joint2="b"/></equality>',
            "an equality constraint couples the joint 'c' of the arm",
        ),
        ('<equality><joint joint1="c"/></equality>', "an equality constraint couples the joint 'c' of the arm"),
        (tendon("b", "c"), "tendon 't' couples the joint 'b' and 'c' of the arm"),
    ],
)
def test_an_arm_whose_joints_are_coupled_is_refused(write, coupling, why):
    with pytest.raises(ValueError, match=rf"{why}.*, and every joint of a chain has to move by itself"):
        find_arm(read_model_file(write(GRIPPED.format(coupling), "arm.xml")), None, None)


@pytest.mark.parametrize(
    "coupling",
    [
        "",
        '<equality><joint joint1="l" joint2="r"/></equality>',
        '<equality><joint joint1="c" joint2="b" active="false"/></equality>',
        tendon("l", "r"),
    ],
)
def test_an_arm_whose_fingers_are_coupled_is_read(write, coupling):
    arm = find_arm(read_model_file(write(GRIPPED.format(coupling), "arm.xml")), None, None)
    assert arm.names == ("a", "b", "c")
    assert arm.notices == ("Joints that are not on the way to the tool are locked: l, r.",)


def test_a_finger_that_becomes_a_joint_of_the_arm_is_noted(write):
    arm = find_arm(read_model_file(write(GRIPPED.format(""), "arm.xml")), "left", None)
    assert arm.names == ("a", "b", "c", "l")
    assert arm.notices == (
        "Joints of the gripper that are joints of the arm here; a --tool before them leaves them out: l.",
        "Joints that are not on the way to the tool are locked: r.",
    )


def test_limits_that_are_exchanged_in_mjcf_are_refused(write):
    text = GRIPPED.format("").replace('name="c" axis="0 1 0" range="-90 90"', 'name="c" range="90 -90"')
    with pytest.raises(ValueError, match="joint 'c' has the position limits 90 to -90"):
        find_arm(read_model_file(write(text, "arm.xml")), None, None)


def test_mesh_that_gives_a_body_its_inertia_stays_without_pictures(write):
    top = '<asset><mesh name="m" file="a.obj"/></asset>'
    model_file = read_model_file(write(mjcf("", top, '<geom type="mesh" mesh="m"/>'), "arm.xml", urdf__a_dot_obj=obj()))
    bare, _ = assert_same_robot(model_file)
    assert bare.nmesh == 1
    np.testing.assert_allclose(bare.body_mass[1], 1000 / 6, rtol=1e-6)


def test_pairs_and_sensors_of_shapes_that_are_left_out_go_with_them(write):
    shapes = (
        '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'
        '<geom name="ball" size="1"/><geom name="m" type="mesh" mesh="m"/>'
    )
    top = (
        '<asset><texture name="t" type="2d" file="t.png"/><material name="s" texture="t"/>'
        '<mesh name="m" file="a.dae"/></asset>'
        '<contact><pair geom1="m" geom2="ball"/></contact>'
        '<sensor><distance geom1="m" geom2="ball" cutoff="1"/><jointpos joint="j"/></sensor>'
    )
    model_file = read_model_file(write(mjcf(geom=shapes, top=top), "arm.xml"))
    _, drawn = assert_same_robot(model_file)
    assert (drawn.ngeom, drawn.npair, drawn.nsensor, drawn.ntex) == (1, 0, 0, 0)
    assert "2 files of meshes or textures are not drawn" in model_file.notices[0]


def test_impossible_inertia_of_mjcf_is_balanced_and_told(write):
    text = mjcf('<inertial mass="1" pos="0 0 0" diaginertia="1 1 4"/>')
    model_file = read_model_file(write(text, "arm.xml"))
    assert model_file.notices == ("Inertias that no rigid body has are replaced by the nearest possible: arm.",)
    bare, _ = assert_same_robot(model_file)
    np.testing.assert_allclose(sorted(bare.body_inertia[1]), [5 / 3, 5 / 3, 10 / 3])


def test_specifications_are_fresh_and_the_digest_tells_texts_apart(write):
    one = read_model_file(write(urdf()))
    one.spec().body("arm").name = "other"
    assert one.spec().body("arm") is not None
    assert one.digest == read_model_file(write(urdf())).digest
    assert one.digest != read_model_file(write(urdf(speed="3"))).digest


def test_what_decides_the_arm_is_read_anew_where_it_changed(write):
    top = '<asset><mesh file="a.stl"/><texture type="2d" file="a.png"/></asset><include file="more.xml"/>'
    parts = {
        "urdf__a_dot_stl": stl(),
        "urdf__more_dot_xml": "<mujocoinclude><worldbody/></mujocoinclude>",
        "urdf__a_dot_png": png(1, 1),
    }
    first = read_model_file(file := write(mjcf(top=top), "arm.xml", **parts))
    assert read_model_file(file) is first
    changes = [stl(0.5), "<mujocoinclude><worldbody><site/></worldbody></mujocoinclude>", png(2, 1)]
    for (name, before), after, decides in zip(parts.items(), changes, (True, True, False), strict=True):
        changed = read_model_file(write(mjcf(top=top), "arm.xml", **parts | {name: after}))
        assert changed is not first
        assert (changed.digest != first.digest) == decides, name
        assert read_model_file(write(mjcf(top=top), "arm.xml", **parts | {name: before})).digest == first.digest


def test_refusal_names_the_file(write):
    with pytest.raises(InputError, match=r"robot file '.*arm\.urdf'"):
        read_model_file(write("<robot>"))
