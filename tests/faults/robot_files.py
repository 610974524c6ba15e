"""Robot files that mean harm, and what is to be said of each."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path

from faults.robot_parts import (
    JOINT,
    LINK,
    SECRET,
    big_meshes,
    chain,
    mesh_asset,
    mesh_of,
    mjcf,
    obj,
    png,
    sparse,
    stl,
    urdf,
)

Content = str | bytes | Callable[[Path], object]
ENTITIES = '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "{}">]>'.format("&a;" * 100)
OUTSIDE = f"../../{SECRET}"
NOT_DRAWN = "read: 1 files of meshes or textures are not drawn"

HOSTILE: dict[str, tuple[dict[str, Content], str]] = {
    # --- text -----------------------------------------------------------------------------------------
    "is empty": ({"arm.urdf": ""}, "not well-formed"),
    "is a folder": ({"arm.urdf": os.mkdir}, "cannot be read"),
    "is a pipe": ({"arm.urdf": os.mkfifo}, "not a regular file"),
    "is a device": ({"arm.urdf": lambda path: path.symlink_to("/dev/zero")}, "not a regular file"),
    "is a link to itself": ({"arm.urdf": lambda path: path.symlink_to(path)}, "arm.urdf"),
    "is missing": ({"other.urdf": ""}, "does not exist"),
    "is binary": ({"arm.urdf": bytes(range(256)) * 100}, "not well-formed"),
    "is noise": ({"arm.xml": b"\x80\x81\xfe<mujoco/>"}, "not well-formed"),
    "is a terabyte": ({"arm.xml": sparse(2**40)}, "larger than 20 MB"),
    "is a page of the web": ({"arm.xml": "<html><body/></html>"}, "its root is <html>"),
    "is SDF": ({"arm.xml": "<sdf version='1.7'><model/></sdf>"}, "its root is <sdf>"),
    "is a part": ({"arm.xml": "<mujocoinclude/>"}, "its root is <mujocoinclude>"),
    "is xacro": ({"arm.urdf": urdf('<xacro:macro name="x"/>')}, "xacro arm.urdf > "),
    "is named xacro": ({"arm.urdf.xacro": urdf()}, "xacro arm.urdf.xacro > arm"),
    "stops in the middle": ({"arm.urdf": urdf()[:-30]}, "not well-formed"),
    "has an unknown encoding": ({"arm.urdf": f'<?xml version="1.0" encoding="klingon"?>{urdf()}'}, "read"),
    "expands entities": ({"arm.urdf": ENTITIES + urdf()}, "DOCTYPE"),
    "reads a file as an entity": (
        {"arm.xml": f'<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>{mjcf()}'},
        "DOCTYPE",
    ),
    "has a document type elsewhere": ({"arm.xml": f'<!DOCTYPE r SYSTEM "http://localhost/x.dtd">{mjcf()}'}, "DOCTYPE"),
    "is deep": ({"arm.xml": "<a>" * 100_000}, "more than 20,000 XML tags"),
    "is deep in bodies": ({"arm.xml": mjcf("<body>" * 300 + "</body>" * 300)}, "deeper than 200"),
    "has a million elements": ({"arm.xml": mjcf("<geom/>" * 1_000_000)}, "more than 20,000 XML tags"),
    "has a number of a million digits": ({"arm.urdf": urdf(speed="9" * 1_000_000)}, "finite numbers up to"),
    # --- MJCF -----------------------------------------------------------------------------------------
    "includes itself": ({"arm.xml": mjcf('<include file="arm.xml"/>')}, "includes 'arm.xml' twice"),
    "includes in a circle": (
        {
            "arm.xml": mjcf('<include file="a.xml"/>'),
            "a.xml": '<m><include file="b.xml"/></m>',
            "b.xml": '<m><include file="a.xml"/></m>',
        },
        "includes 'a.xml' twice",
    ),
    "includes a file twice by two names": (
        {
            "arm.xml": mjcf('<include file="a.xml"/>'),
            "a.xml": '<m><include file="./a.xml"/><include file=".//a.xml"/></m>',
        },
        "twice",
    ),
    "includes what is no XML": ({"arm.xml": mjcf('<include file="/etc/passwd"/>')}, "no .xml file in its folder"),
    "includes from outside": ({"arm.xml": mjcf('<include file="../../secret.xml"/>')}, "no .xml file in its folder"),
    "includes a link to outside": (
        {"arm.xml": mjcf('<include file="a.xml"/>'), "a.xml": lambda path: path.symlink_to("/etc/passwd")},
        "no .xml file in its folder",
    ),
    "has sub-models": (
        {"arm.xml": mjcf('<attach model="m" prefix="a"/>', '<asset><model name="m" file="arm.xml"/></asset>')},
        "<model>, which is not read",
    ),
    "replicates a million times": (
        {"arm.xml": mjcf('<replicate count="1000000"><geom size="1"/></replicate>')},
        "<replicate>, which is not read",
    ),
    "has a composite": (
        {"arm.xml": mjcf('<composite type="cable" count="100000 1 1"/>')},
        "<composite>, which is not read",
    ),
    "has a flexcomp": (
        {"arm.xml": mjcf('<flexcomp type="grid" count="1000 1000 1000"/>')},
        "<flexcomp>, which is not read",
    ),
    "has a plugin": (
        {"arm.xml": mjcf(top='<extension><plugin plugin="mujoco.pid"/></extension>')},
        "<extension>, which is not read",
    ),
    "has an enormous height field": (
        {"arm.xml": mjcf(top='<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>')},
        "finite numbers up to",
    ),
    "has an enormous texture": (
        {
            "arm.xml": mjcf(
                top='<asset><texture name="t" type="2d" builtin="flat" width="100000" height="100000"/></asset>'
            )
        },
        "finite numbers up to",
    ),
    "has an enormous number": (
        {"arm.xml": mjcf(top='<custom><numeric name="n" size="2000000000"/></custom>')},
        "finite numbers up to",
    ),
    "asks for memory": ({"arm.xml": mjcf(top='<size memory="900G" njmax="2000000000" nkey="2000000000"/>')}, "read"),
    "has an enormous sensor": (
        {"arm.xml": mjcf(top='<sensor><user dim="2000000000" needstage="pos"/></sensor>')},
        "read",
    ),
    "has an enormous delay": (
        {"arm.xml": mjcf(top='<actuator><motor joint="j" delay="1" nsample="2000000000"/></actuator>')},
        "finite numbers up to",
    ),
    "has an enormous mesh of its own": (
        {"arm.xml": mjcf(top='<asset><mesh name="m" builtin="plate" params="100000 100000"/></asset>')},
        "finite numbers up to",
    ),
    "searches length ranges without end": (
        {
            "arm.xml": mjcf(
                top='<compiler><lengthrange mode="all" inttotal="1e9"/></compiler>'
                '<actuator><motor joint="j"/></actuator>'
            )
        },
        "read",
    ),
    "has NaN": ({"arm.xml": mjcf(geom='<geom size="nan"/>')}, "finite numbers"),
    "has infinity": ({"arm.xml": mjcf('<body pos="0 0 1e999"/>')}, "finite numbers"),
    "has no mass": ({"arm.xml": mjcf(geom="")}, "read: Moving bodies without a mass get 0.01 kg: arm."),
    "has a mass that overflows": ({"arm.xml": mjcf(geom='<geom size="1e5" density="1e20"/>')}, "weighs more than"),
    "has two thousand bodies with shapes": (
        {
            "arm.xml": mjcf(
                '<body pos="1 0 0"><geom size="1"/><geom size="1" type="box"/></body>' * 1900,
                geom='<geom type="box" size="1 1 1"/>',
            ).replace('"1" type="box"', '"1 1 1" type="box"')
        },
        "read",
    ),
    "has thousands of sites": (
        {"arm.xml": mjcf("".join(f'<site name="s{i}"/>' for i in range(9000)))},
        "read",
    ),
    # --- URDF -----------------------------------------------------------------------------------------
    "has NaN in a joint": ({"arm.urdf": urdf(axis="0 nan 1")}, "finite numbers"),
    "has a zero axis": ({"arm.urdf": urdf(axis="0 0 0")}, "axis too small"),
    "has an unknown joint": ({"arm.urdf": urdf(kind="wobbly")}, "invalid joint type"),
    "has two roots": ({"arm.urdf": urdf(LINK.format("stray", ""))}, "read"),
    "has a missing parent": (
        {"arm.urdf": urdf(JOINT.format("ghost", "arm", "fixed", "1 0 0", "1"))},
        "parent or child missing",
    ),
    "has a link of two parents": (
        {
            "arm.urdf": urdf(
                LINK.format("x", ""),
                JOINT.format("base", "x", "fixed", "1 0 0", "1"),
                JOINT.format("arm", "x", "fixed", "1 0 0", "1"),
            )
        },
        "multiple parents",
    ),
    "is a loop": ({"arm.urdf": urdf(JOINT.format("arm", "base", "fixed", "1 0 0", "1"))}, "not found"),
    "has two links of a name": ({"arm.urdf": urdf(LINK.format("arm", ""))}, "repeated"),
    "has two joints of a name": (
        {
            "arm.urdf": urdf(
                LINK.format("x", ""),
                JOINT.format("arm", "x", "revolute", "1 0 0", "1").replace("arm_x", "base_arm"),
            )
        },
        "has several joints of the name 'base_arm': give each its own.",
    ),
    "has no links": ({"arm.urdf": "<robot/>"}, "has no links."),
    "has a thousand links in a chain": ({"arm.urdf": chain(1000)}, "held by more than 200 others"),
    "has thousands of links": ({"arm.urdf": urdf('<link name="x"/>' * 2100)}, "repeated"),
    "has a negative mass": (
        {"arm.urdf": urdf(child="").replace('mass value="1"', 'mass value="-1"')},
        "mass and inertia of moving bodies must be larger",
    ),
    # --- files of meshes and textures -----------------------------------------------------------------
    "names a mesh outside": ({"arm.urdf": urdf(child=mesh_of(OUTSIDE))}, NOT_DRAWN),
    "names a mesh outside as a file": ({"arm.urdf": urdf(child=mesh_of(f"file://{{root}}/{SECRET}"))}, NOT_DRAWN),
    "names a mesh outside through a package": ({"arm.urdf": urdf(child=mesh_of(f"package://../{SECRET}"))}, NOT_DRAWN),
    "leaves its package": ({"arm.urdf": urdf(child=mesh_of(f"package://a/../../../{SECRET}"))}, NOT_DRAWN),
    "names a folder of meshes outside": (
        {"arm.xml": mesh_asset(SECRET).replace("<mujoco>", '<mujoco><compiler meshdir="{root}"/>')},
        NOT_DRAWN,
    ),
    "names a link to a mesh outside": (
        {"arm.urdf": urdf(child=mesh_of("a.stl")), "a.stl": lambda path: path.symlink_to(f"../../{SECRET}")},
        NOT_DRAWN,
    ),
    "names a link to text as a mesh": (
        {"arm.urdf": urdf(child=mesh_of("a.stl")), "a.stl": lambda path: path.symlink_to("/etc/passwd")},
        NOT_DRAWN,
    ),
    "names a page of the web": ({"arm.urdf": urdf(child=mesh_of("http://localhost/a.stl"))}, NOT_DRAWN),
    "names text as a mesh": ({"arm.urdf": urdf(child=mesh_of("/etc/passwd"))}, NOT_DRAWN),
    "names a mesh with a zero byte": ({"arm.urdf": urdf(child=mesh_of("a%00.stl"))}, NOT_DRAWN),
    "names a mesh of many letters": ({"arm.urdf": urdf(child=mesh_of("a" * 100_000 + ".stl"))}, NOT_DRAWN),
    "names thousands of meshes": (
        {"arm.urdf": urdf(child="".join(mesh_of(f"package://p{i}/{i}.stl") for i in range(1100)))},
        "more than 1,000 meshes or textures",
    ),
    "names a thousand packages": (
        {"arm.urdf": urdf(child="".join(mesh_of(f"package://p{i}/{i}.stl") for i in range(1000)))},
        "read: 1000 files",
    ),
    "has a pipe as a mesh": ({"arm.urdf": urdf(child=mesh_of("a.stl")), "a.stl": os.mkfifo}, NOT_DRAWN),
    "has a folder as a mesh": ({"arm.urdf": urdf(child=mesh_of("a.stl")), "a.stl": os.mkdir}, NOT_DRAWN),
    "has an enormous mesh": ({"arm.urdf": urdf(child=mesh_of("a.stl")), "a.stl": sparse(2**40)}, NOT_DRAWN),
    "has enormous meshes in all": (
        {"arm.urdf": urdf(child="".join(mesh_of(f"{i}.stl") for i in range(4))), "0.stl": big_meshes},
        "more than 300 MB",
    ),
    "has a mesh that lies about its faces": (
        {"arm.urdf": urdf(child=mesh_of("a.stl")), "a.stl": stl(faces=2**32 - 1)},
        "not drawn",
    ),
    "has an empty mesh": ({"arm.urdf": urdf(child=mesh_of("a.stl")), "a.stl": ""}, "not drawn"),
    "has a mesh of NaN": ({"arm.urdf": urdf(child=mesh_of("a.stl")), "a.stl": stl(float("nan"))}, "not drawn"),
    "has a mesh of zero size": (
        {"arm.urdf": urdf(child=mesh_of("a.stl").replace("/></g", ' scale="0 0 0"/></g')), "a.stl": stl()},
        "not drawn",
    ),
    "has a mesh whose faces name no corner": (
        {"arm.urdf": urdf(child=mesh_of("a.obj")), "a.obj": obj("f 1 2 1000000000\nf -9 -8 -7\n")},
        "not drawn",
    ),
    "has a mesh that names a material outside": (
        {"arm.urdf": urdf(child=mesh_of("a.obj")), "a.obj": obj(more="mtllib {root}/secret.mtl\n")},
        "read",
    ),
    "has a mesh of lies about its counts": (
        {"arm.xml": mesh_asset("a.msh"), "a.msh": struct.pack("<4i", 2**30, 0, 0, 2**30)},
        "not drawn",
    ),
    "has a mesh whose faces name no vertex": (
        {"arm.xml": mesh_asset("a.msh"), "a.msh": struct.pack("<4i12f3i", 4, 0, 0, 1, *range(12), 0, 1, 2**30)},
        "not drawn",
    ),
    "has a texture that unpacks to gigabytes": (
        {
            "arm.xml": mjcf(top='<asset><texture name="t" type="2d" file="t.png"/></asset>'),
            "t.png": png(65_535, 65_535),
        },
        NOT_DRAWN,
    ),
    "has a texture cut short": (
        {"arm.xml": mjcf(top='<asset><texture name="t" type="2d" file="t.png"/></asset>'), "t.png": png(64, 64)},
        "not drawn",
    ),
    "has a skin of a file": (
        {
            "arm.xml": mjcf(top='<asset><skin name="s" file="s.skn"/></asset>'),
            "s.skn": struct.pack("<4i", 2**30, 2**30, 2**30, 1),
        },
        "read",
    ),
}
"""Files by name, and part of what is said: the refusal, or `read: ` and the notices."""
