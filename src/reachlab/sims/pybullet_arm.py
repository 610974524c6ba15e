"""An arm as PyBullet reads it: a URDF file and meshes, written from the robot's own model."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement, indent

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from reachlab.robots.files.gripper import TIPS
from reachlab.robots.robot import PybulletModel, Robot
from reachlab.robots.shapes.solids import links_of_bodies

UNPAINTED = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
"""MuJoCo's colour of a geom that has none of its own; its material then shows."""

STL_HEADER, STL_FACET = bytes(80), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
"""Binary STL: a header, the number of facets, and the facets."""

UNIT_SPHERE = "sphere_smooth.obj"
"""Mesh of a ball of radius 1 in PyBullet's data."""

INERTIA = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
"""Where URDF's numbers are in the matrix of inertia."""


def write_arm(robot: Robot, folder: Path) -> PybulletModel:
    """The arm as a URDF file in a folder, beside the meshes that it names.

    Link `i + 1` is all that joint `i` moves and no later joint does, the gripper's joints after the arm's; the last
    link is the tool. With all joints at zero every link's frame is turned as the world is, so that the model's numbers
    are written as they are, in full. What MuJoCo draws by default is drawn. Nothing can be touched but finger tips.
    """
    data, n = mujoco.MjData(robot.spec().compile()), robot.chain.n
    model, joints = data.model, data.model.njnt
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    origins = np.concatenate([np.zeros((1, 3)), data.xanchor])
    moved_with = links_of_bodies(model)
    urdf = Element("robot", name="arm")
    for number, origin in enumerate(origins):
        link = SubElement(urdf, "link", name=str(number))
        _add_inertial(link, data, np.flatnonzero(moved_with == number), origin)
        for geom in np.flatnonzero(moved_with[model.geom_bodyid] == number):
            if _drawn(model)[geom]:
                _add_visual(link, data, int(geom), origin, folder)
            if model.geom(geom).name in TIPS:
                _add_geometry(SubElement(link, "collision"), data, int(geom), origin, folder)
    limits, slides = _limits(robot), model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    for i in range(joints):
        kind = "prismatic" if slides[i] else "revolute" if np.isfinite(limits["lower"][i]) else "continuous"
        body = model.jnt_bodyid[i]
        parent = i if i > model.body_jntadr[body] else int(moved_with[model.body_parentid[body]])
        joint = _add_joint(urdf, i, kind, parent, origins[i + 1] - origins[parent], np.eye(3))
        SubElement(joint, "axis", xyz=_text(data.xaxis[i]))
        SubElement(joint, "limit", {name: _text(values[i]) for name, values in limits.items()})
    position, rotation = _tool_frame(data, robot.tool)
    _add_inertial(SubElement(urdf, "link", name=str(joints + 1)), data, np.array([], int), position)
    _add_joint(urdf, joints, "fixed", n, position - origins[n], rotation)
    indent(urdf)  # PyBullet breaks lines of 1,024 characters, be it inside a number
    file = folder / "arm.urdf"
    ElementTree(urdf).write(file)
    return PybulletModel(str(file), joints, {robot.tool: 0.0})


def _limits(robot: Robot) -> dict[str, np.ndarray]:
    """Limits of all joints `[m]` by URDF's names."""
    arm = np.array([robot.chain.lower, robot.chain.upper, robot.torque, robot.speed])
    if hand := robot.gripper:
        ways = np.sort([hand.closed, hand.open], axis=0)
        arm = np.concatenate([arm, [*ways, np.full_like(ways[0], hand.force), np.full_like(ways[0], hand.speed)]], 1)
    return dict(zip(("lower", "upper", "effort", "velocity"), arm, strict=True))


def _tool_frame(data: mujoco.MjData, tool: str) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] and rotation matrix of the site or body `tool`."""
    site = mujoco.mj_name2id(data.model, mujoco.mjtObj.mjOBJ_SITE, tool)
    frame = data.site(site) if site >= 0 else data.body(tool)
    return frame.xpos, frame.xmat.reshape(3, 3)


def _drawn(model: mujoco.MjModel) -> np.ndarray:
    """For each geom whether MuJoCo draws it by default, and PyBullet can."""
    endless = np.isin(model.geom_type, [mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD])
    return mujoco.MjvOption().geomgroup[model.geom_group].astype(bool) & (_colours(model)[:, 3] > 0) & ~endless


def _colours(model: mujoco.MjModel) -> np.ndarray:
    """Colours of the geoms `[geoms, 4]`: their own, else their material's."""
    own = (model.geom_matid < 0) | (model.geom_rgba != UNPAINTED).any(1)
    return np.where(own[:, None], model.geom_rgba, model.mat_rgba[model.geom_matid] if model.nmat else UNPAINTED)


def _add_inertial(link: Element, data: mujoco.MjData, bodies: np.ndarray, origin: np.ndarray) -> None:
    """Mass [kg], its centre [m] and inertia [kg m²] of bodies that move as one."""
    masses, centres = data.model.body_mass[bodies], data.xipos[bodies]
    total, inertia = masses.sum(), np.zeros((3, 3))
    centre = masses @ centres / total if total else origin
    for body, mass, off in zip(bodies, masses, centres - centre, strict=True):
        axes = data.ximat[body].reshape(3, 3)
        inertia += axes * data.model.body_inertia[body] @ axes.T + mass * (off @ off * np.eye(3) - np.outer(off, off))
    inertial = SubElement(link, "inertial")
    _add_origin(inertial, centre - origin, np.eye(3))
    SubElement(inertial, "mass", value=_text(total))
    SubElement(inertial, "inertia", {name: _text(inertia[place]) for name, place in INERTIA.items()})


def _add_visual(link: Element, data: mujoco.MjData, geom: int, origin: np.ndarray, folder: Path) -> None:
    """What is drawn for a geom."""
    visual = SubElement(link, "visual")
    _add_geometry(visual, data, geom, origin, folder)
    SubElement(SubElement(visual, "material", name=str(geom)), "color", rgba=_text(_colours(data.model)[geom]))


def _add_geometry(part: Element, data: mujoco.MjData, geom: int, origin: np.ndarray, folder: Path) -> None:
    """Where a geom is in its link, and its shape."""
    _add_origin(part, data.geom_xpos[geom] - origin, data.geom_xmat[geom].reshape(3, 3))
    shape, sizes = _shape(data.model, geom, folder)
    SubElement(SubElement(part, "geometry"), shape, sizes)


def _shape(model: mujoco.MjModel, geom: int, folder: Path) -> tuple[str, dict[str, str]]:
    """URDF's name of a geom's shape, and its sizes [m]."""
    import pybullet_data

    size, kinds = model.geom_size[geom], mujoco.mjtGeom
    match kinds(model.geom_type[geom]):
        case kinds.mjGEOM_BOX:
            return "box", {"size": _text(2 * size)}
        case kinds.mjGEOM_SPHERE:
            return "sphere", {"radius": _text(size[0])}
        case kinds.mjGEOM_CYLINDER | kinds.mjGEOM_CAPSULE as kind:
            return kind.name[7:].lower(), {"radius": _text(size[0]), "length": _text(2 * size[1])}
        case kinds.mjGEOM_ELLIPSOID:
            return "mesh", {"filename": str(Path(pybullet_data.getDataPath()) / UNIT_SPHERE), "scale": _text(size)}
    return "mesh", {"filename": _write_mesh(model, int(model.geom_dataid[geom]), folder)}


def _write_mesh(model: mujoco.MjModel, mesh: int, folder: Path) -> str:
    """Path of a mesh as an STL file, which is written unless it is there."""
    file = folder / f"{mesh}.stl"
    if not file.exists():
        first_corner, first_face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
        faces = model.mesh_face[first_face : first_face + model.mesh_facenum[mesh]]
        facets = np.zeros(len(faces), STL_FACET)
        facets["corners"] = corners = model.mesh_vert[first_corner + faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        facets["normal"] = normals / np.maximum(lengths, np.finfo(np.float32).tiny)
        file.write_bytes(STL_HEADER + np.uint32(len(facets)).tobytes() + facets.tobytes())
    return str(file)


def _add_joint(urdf: Element, i: int, kind: str, parent: int, position: np.ndarray, rotation: np.ndarray) -> Element:
    """Joint number `i`, from link `parent` to link `i + 1`."""
    joint = SubElement(urdf, "joint", name=f"joint_{i}", type=kind)
    SubElement(joint, "parent", link=str(parent))
    SubElement(joint, "child", link=str(i + 1))
    _add_origin(joint, position, rotation)
    return joint


def _add_origin(element: Element, position: np.ndarray, rotation: np.ndarray) -> None:
    """A frame as URDF writes it: roll, pitch and yaw such that the rotation is Rz(yaw) Ry(pitch) Rx(roll)."""
    (a, b, c), (d, e, f), (g, _, _) = rotation
    yaw = np.arctan2(d, a)
    cos, sin = np.cos(yaw), np.sin(yaw)
    # With the yaw taken as it is, the other two are right even where the pitch is a right angle.
    pitch, roll = np.arctan2(-g, cos * a + sin * d), np.arctan2(sin * c - cos * f, cos * e - sin * b)
    SubElement(element, "origin", xyz=_text(position), rpy=_text([roll, pitch, yaw]))


def _text(numbers: ArrayLike) -> str:
    """Numbers in full."""
    return " ".join(map(repr, np.asarray(numbers, float).ravel().tolist()))
