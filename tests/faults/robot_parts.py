"""Small robot files, meshes and images, of which hostile ones are made."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

SECRET = "secret.stl"
"""A mesh that lies outside of the robot's folders."""

LINK = (
    '<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    "{1}</link>"
)
JOINT = (
    '<joint name="{0}_{1}" type="{2}"><parent link="{0}"/><child link="{1}"/><axis xyz="{3}"/>'
    '<limit lower="-1" upper="1" effort="5" velocity="{4}"/></joint>'
)


def urdf(*parts: str, child: str = "", kind: str = "revolute", axis: str = "0 0 1", speed: str = "2") -> str:
    """An arm of one joint, with more parts."""
    links = LINK.format("base", "") + LINK.format("arm", child)
    return f'<robot name="r">{links}{JOINT.format("base", "arm", kind, axis, speed)}{"".join(parts)}</robot>'


def mjcf(inside: str = "", top: str = "", geom: str = '<geom size="0.1"/>') -> str:
    """An arm of one joint."""
    return f'<mujoco>{top}<worldbody><body name="arm"><joint name="j"/>{geom}{inside}</body></worldbody></mujoco>'


def mesh_of(name: str) -> str:
    """A shape of a URDF link."""
    return f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'


def mesh_asset(name: str) -> str:
    """An arm whose only geom is a mesh."""
    return mjcf(
        '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>',
        f'<asset><mesh name="m" file="{name}"/></asset>',
        '<geom type="mesh" mesh="m"/>',
    )


def stl(value: float = 0.0, faces: int | None = None) -> bytes:
    """A tetrahedron."""
    corners = [(value, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    data = bytes(80) + struct.pack("<I", 4 if faces is None else faces)
    for face in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)):
        data += struct.pack("<12fH", 0, 0, 0, *(x for corner in face for x in corners[corner]), 0)
    return data


def obj(faces: str = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n", more: str = "") -> str:
    """A tetrahedron."""
    return f"{more}v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n{faces}"


def png(width: int, height: int) -> bytes:
    """The head of an image."""
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4s2I", 13, b"IHDR", width, height) + bytes(60)


def sparse(size: int) -> Callable[[Path], None]:
    """A file of zeros."""

    def make(path: Path) -> None:
        with path.open("wb") as file:
            file.truncate(size)

    return make


def big_meshes(path: Path) -> None:
    """Four meshes of 90 MB."""
    for number in range(4):
        with (path.parent / f"{number}.stl").open("wb") as file:
            file.write(bytes(80) + struct.pack("<I", 100))
            file.truncate(90 * 2**20)


def chain(count: int) -> str:
    """An arm of many joints."""
    links = "".join(LINK.format(f"l{i}", "") for i in range(count))
    joints = "".join(JOINT.format(f"l{i}", f"l{i + 1}", "fixed", "1 0 0", "1") for i in range(count - 1))
    return f"<robot>{links}{joints}</robot>"
