"""URDF rewritten for MuJoCo's reader: names of meshes, joints and masses that it or the simulation refuses."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from reachlab.robots.picture_files import MISSING, PictureFiles
from reachlab.robots.safe_xml import MOST_NESTING, Element, are_numbers, numbers, to_text
from reachlab.robots.urdf_limits import Noted, rewrite_limits
from reachlab.settings.validation import InputError

MOST_BODIES = 2000
MOVING = ("revolute", "continuous", "prismatic", "planar", "spherical")
JOINT_TYPES = (*MOVING, "floating", "fixed")
SMALL_MASS, SMALL_RADIUS = 0.01, 0.03
"""Mass [kg] and radius of gyration [m] of a moving link that states none."""
LEAST_INERTIA = 1e-12
"""Least principal moment of inertia [kg m²]; MuJoCo refuses those below 1e-15."""
ROUNDING = 1e-9
"""Relative margin by which moments of inertia satisfy A + B >= C."""
SAID = 1e-6
"""Relative change of an inertia from which it is told."""

NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
    "safety_controller": dict.fromkeys(("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), 1),
    "box": {"size": 3},
    "sphere": {"radius": 1},
    **{key: {"radius": 1, "length": 1} for key in ("cylinder", "capsule")},
}
"""How many numbers an attribute of an element has."""


@dataclass(frozen=True)
class JointFacts:
    """What a URDF says of a joint and MuJoCo's model does not keep.

    Attributes:
        speed: speed limit [rad/s or m/s]; None where it is absent or 0.
        torque: torque or force limit [Nm or N]; None where it is absent or 0.
        mimics: the joint that it follows; None for a joint of its own.
    """

    speed: float | None = None
    torque: float | None = None
    mimics: str | None = None


def rewrite_urdf(root: Element, pictures: PictureFiles) -> tuple[str, dict[str, JointFacts], list[str]]:
    """Text for MuJoCo, facts on the joints, and one sentence on each change.

    Raises:
        InputError: the links and joints do not form one tree, or a joint or mass makes no sense.
    """
    file = pictures.folders.file
    notices: list[str] = []
    links = _by_name(root, "link", file)
    if not links:
        raise InputError(f"robot file {str(file)!r} has no links.")
    joints = _by_name(root, "joint", file)
    for other in [child for child in root if child.tag not in ("link", "joint", "material", "mujoco")]:
        root.remove(other)
    _check_tree(links, joints, file)
    _check_numbers(root, file)
    noted: Noted = defaultdict(list)
    facts = {name: _rewrite_joint(name, joint, file, notices, noted) for name, joint in joints.items()}
    notices += [f"{what}: {some(names)}." for what, names in noted.items()]
    moving = {_end(joint, "child") for joint in joints.values() if joint.get("type") in MOVING}
    _rewrite_masses(links, moving, file, notices)
    extension = _compiler(root)
    fallbacks = [name for name, link in links.items() if _rewrite_shapes(link, extension, pictures)]
    for parent in [root, *root.iter("visual")]:
        for material in parent.findall("material"):
            for texture in material.findall("texture"):
                material.remove(texture)
    notices += pictures.notice()
    if fallbacks:
        notices.append(f"Drawn by their collision shapes instead: {some(fallbacks)}.")
    return to_text(root), facts, notices


def some(names: Iterable[str], most: int = 6) -> str:
    """The first names, and how many more there are."""
    listed = list(names)
    return ", ".join(listed[:most]) + (f" and {len(listed) - most} more" if len(listed) > most else "")


def _by_name(root: Element, tag: str, file: Path) -> dict[str, Element]:
    elements = root.findall(tag)
    if len(elements) > MOST_BODIES:
        raise InputError(f"robot file {str(file)!r} has {len(elements):,} {tag}s; at most {MOST_BODIES:,} are read.")
    names = Counter(element.get("name", "") for element in elements)
    if "" in names:
        raise InputError(f"robot file {str(file)!r} has a {tag} without a name: give each its own.")
    if twice := [name for name, count in names.items() if count > 1]:
        raise InputError(f"robot file {str(file)!r} has two {tag}s named {twice[0]!r}: give each its own name.")
    return {element.get("name", ""): element for element in elements}


def _end(joint: Element, end: str) -> str:
    """Name of the parent or child link of a joint."""
    found = joint.find(end)
    return "" if found is None else found.get("link", "")


def _check_tree(links: Mapping[str, Element], joints: Mapping[str, Element], file: Path) -> None:
    what = f"robot file {str(file)!r}"
    parent_of: dict[str, str] = {}
    for name, joint in joints.items():
        parent, child = _end(joint, "parent"), _end(joint, "child")
        for link, end in ((parent, "parent"), (child, "child")):
            if link not in links:
                raise InputError(f"{what}: joint {name!r} has the {end} link {link!r}, which the file does not have.")
        if child in parent_of:
            raise InputError(f"{what}: link {child!r} is the child of two joints; only trees of links are read.")
        parent_of[child] = parent
    roots = [link for link in links if link not in parent_of]
    if len(roots) > 1:
        raise InputError(f"{what} has {len(roots)} links without a parent ({some(roots)}): join them to one tree.")
    for link in links:
        above, depth = link, 0
        while above in parent_of and depth <= MOST_NESTING:
            above, depth = parent_of[above], depth + 1
        if depth > MOST_NESTING:
            raise InputError(
                f"{what}: link {link!r} is part of a loop of joints, or more than {MOST_NESTING} joints from the base."
            )


def _check_numbers(root: Element, file: Path) -> None:
    for element in root.iter():
        for key, count in NUMBERS.get(element.tag, {}).items():
            text = element.get(key)
            if text is not None and not are_numbers(text, count):
                wanted = "a number" if count == 1 else f"{count} numbers"
                raise InputError(f"robot file {str(file)!r}: {key}={text[:40]!r} of <{element.tag}> must be {wanted}.")


def _rewrite_joint(name: str, joint: Element, file: Path, notices: list[str], noted: Noted) -> JointFacts:
    kind = joint.get("type", "")
    if kind not in JOINT_TYPES:
        raise InputError(
            f"robot file {str(file)!r}: joint {name!r} is of type {kind!r}, which is not one of:"
            f" {', '.join(JOINT_TYPES)}."
        )
    if kind == "floating":
        joint.set("type", "fixed")
        notices.append(f"Joint {name!r} is floating and is taken as fixed: the arm stands on its base.")
    axis = joint.find("axis")
    if axis is not None and kind in MOVING and not any(numbers(axis.get("xyz"), 3, 1.0)):
        raise InputError(f"robot file {str(file)!r}: the axis of joint {name!r} is zero; give it a direction.")
    speed, torque = rewrite_limits(joint, f"robot file {str(file)!r}: joint {name!r}", noted)
    mimic = joint.find("mimic")
    return JointFacts(speed, torque, None if mimic is None else mimic.get("joint"))


def _rewrite_masses(links: Mapping[str, Element], moving: set[str], file: Path, notices: list[str]) -> None:
    massless, balanced = [], []
    for name, link in links.items():
        mass = _mass(link)
        if mass < 0.0:
            raise InputError(f"robot file {str(file)!r}: the mass of link {name!r} is negative.")
        if mass > 0.0:
            inertia = _child(_child(link, "inertial"), "inertia")
            stated = _inertia(inertia)
            possible = balance(stated, mass)
            _set_inertia(inertia, possible)
            if np.abs(stated - possible).max() > SAID * np.abs(stated).max():
                balanced.append(name)
            continue
        for inertial in link.findall("inertial"):
            link.remove(inertial)
        if name in moving:
            massless.append(name)
            inertial = _child(link, "inertial")
            _child(inertial, "mass").set("value", repr(SMALL_MASS))
            _set_inertia(_child(inertial, "inertia"), SMALL_MASS * SMALL_RADIUS**2 * np.eye(3))
    if massless:
        notices.append(f"Moving links without a mass get {SMALL_MASS:g} kg: {some(massless)}.")
    if balanced:
        notices.append(f"Inertias that no rigid body has are replaced by the nearest possible: {some(balanced)}.")


def _mass(link: Element) -> float:
    found = link.find("inertial/mass")
    return 0.0 if found is None else numbers(found.get("value"), 1)[0]


def balance(inertia: np.ndarray, mass: float) -> np.ndarray:
    """The nearest inertia `[3, 3]` that a rigid body can have: positive moments with A + B >= C [kg m²]."""
    moments, axes = np.linalg.eigh(inertia)
    if moments[2] < LEAST_INERTIA:
        return mass * SMALL_RADIUS**2 * np.eye(3)
    possible = np.maximum(moments, LEAST_INERTIA)
    lack = possible[2] * (1 + ROUNDING) - possible[0] - possible[1]
    if lack > 0.0:
        possible = possible + lack / 3 * np.array([1.0, 1.0, -1.0])
    return inertia if np.array_equal(moments, possible) else axes @ np.diag(possible) @ axes.T


TERMS = (("ixx", 0, 0), ("iyy", 1, 1), ("izz", 2, 2), ("ixy", 0, 1), ("ixz", 0, 2), ("iyz", 1, 2))


def _inertia(element: Element) -> np.ndarray:
    inertia = np.zeros((3, 3))
    for key, row, column in TERMS:
        inertia[row, column] = inertia[column, row] = numbers(element.get(key), 1)[0]
    return inertia


def _set_inertia(element: Element, inertia: np.ndarray) -> None:
    for key, row, column in TERMS:
        element.set(key, repr(float(inertia[row, column])))


def _child(parent: Element, tag: str) -> Element:
    """The child of this tag, made where there is none."""
    found = parent.find(tag)
    if found is None:
        found = Element(tag)
        parent.append(found)
    return found


def _compiler(root: Element) -> str:
    """Folder of the meshes that MuJoCo's extension names; its settings become those that keep every link and shape."""
    extension = _child(root, "mujoco")
    for other in [child for child in extension if child.tag not in ("compiler", "option")]:
        extension.remove(other)
    compiler = _child(extension, "compiler")
    folder = compiler.get("meshdir", compiler.get("assetdir", ""))
    for key in ("meshdir", "assetdir", "texturedir"):
        compiler.attrib.pop(key, None)
    compiler.attrib |= {"discardvisual": "false", "fusestatic": "false", "strippath": "false"}
    compiler.attrib.setdefault("inertiafromgeom", "false")
    return folder


def _rewrite_shapes(link: Element, folder: str, pictures: PictureFiles) -> bool:
    """Name the meshes of a link plainly; whether it is drawn by its collision shapes because others are left out."""
    before = len(link.findall("visual"))
    for tag in ("visual", "collision"):
        for shape in link.findall(tag):
            if not _drawable(shape, folder, pictures):
                link.remove(shape)
    if not before or link.findall("visual") or not link.findall("collision"):
        return False
    for collision in link.findall("collision"):
        visual = Element("visual")
        visual.extend(child for child in collision if child.tag in ("origin", "geometry"))
        link.append(visual)
    return True


def _drawable(shape: Element, folder: str, pictures: PictureFiles) -> bool:
    geometry = shape.find("geometry")
    solid = None if geometry is None else next(iter(geometry), None)
    if solid is None:
        return False
    if solid.tag == "mesh":
        plain = pictures.add(solid.get("filename", ""), folder, scale=solid.get("scale", ""))
        solid.set("filename", plain)
        return plain != MISSING
    keys = {"box": ("size", 3), "sphere": ("radius", 1), "cylinder": ("radius", 1), "capsule": ("radius", 1)}
    if solid.tag not in keys:
        return False
    sizes = numbers(solid.get(keys[solid.tag][0]), keys[solid.tag][1])
    return min(sizes) > 0.0 and (solid.get("length") is None or numbers(solid.get("length"), 1)[0] > 0.0)
