"""URDF rewritten for MuJoCo's reader: names of meshes, limits of joints and shapes that it refuses."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from xml.etree.ElementTree import SubElement

from reachlab.robots.files.picture_files import MESHES, PictureFiles, some
from reachlab.robots.files.safe_xml import Element, number, to_text
from reachlab.settings.validation import InputError

SHAPES = {"mesh", "box", "sphere", "cylinder", "capsule"}
"""Geometries that MuJoCo knows."""

FIXED = "Floating joints are taken as fixed, so that the arm stands on its base"
PLANAR = "Planar joints are taken as two slides and a hinge, a metre or a turn either way where they have no limits"
NONE = "Position limits from 0 to 0 are taken as none, so a turn or a metre either way"
SOFT = "Position limits are narrowed to the soft limits of safety_controller"


@dataclass(frozen=True)
class JointFacts:
    """What a URDF says of a joint and MuJoCo's model does not keep.

    Attributes:
        speed: speed limit [rad/s or m/s]; None where it is absent or 0.
        mimics: the joint that it follows; None for a joint of its own.
    """

    speed: float | None = None
    mimics: str | None = None


def rewrite_urdf(root: Element, pictures: PictureFiles) -> tuple[str, dict[str, JointFacts], list[str]]:
    """Text for MuJoCo, facts on the joints, and one sentence on each change.

    Raises:
        InputError: there are no links, two joints have one name, or a limit of speed or torque makes no sense.
    """
    if root.find("link") is None:
        raise InputError("has no links.")
    names = Counter(joint.get("name") for joint in root.findall("joint"))
    if twice := [repr(name) for name, count in names.items() if name and count > 1]:
        raise InputError(f"has several joints of the name {' and '.join(twice)}: give each its own.")
    noted: dict[str, list[str]] = defaultdict(list)
    facts = {joint.get("name", ""): _rewrite_joint(joint, noted) for joint in root.findall("joint")}
    folder = _rewrite_compiler(root)
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            if not SHAPES & {solid.tag for solid in shape.findall("geometry/*")}:
                link.remove(shape)
        for mesh in link.iter("mesh"):
            mesh.set("filename", pictures.add(mesh.get("filename", ""), folder, MESHES))
        for inertial in link.findall("inertial"):
            mass = inertial.find("mass")
            if mass is None or not number(mass, "value"):
                link.remove(inertial)
    return to_text(root), facts, [f"{what}: {some(names)}." for what, names in noted.items()]


def _rewrite_joint(joint: Element, noted: dict[str, list[str]]) -> JointFacts:
    """Facts on a joint, whose position limits become the soft ones; what is changed is noted, with its name."""
    name, kind = joint.get("name", ""), joint.get("type")
    if kind == "floating":
        joint.set("type", "fixed")
        noted[FIXED].append(name)
    if kind == "planar":
        noted[PLANAR].append(name)
    limit, mimic = joint.find("limit"), joint.find("mimic")
    speed = 0.0
    if limit is not None:
        if kind in ("revolute", "prismatic"):
            _narrow(joint, limit, noted)
        speed = number(limit, "velocity")
        if min(speed, number(limit, "effort")) < 0.0:
            raise InputError(f"gives joint {name!r} a negative limit of speed or torque: leave its sign out.")
    return JointFacts(speed or None, None if mimic is None else mimic.get("joint"))


def _narrow(joint: Element, limit: Element, noted: dict[str, list[str]]) -> None:
    low, high = number(limit, "lower"), number(limit, "upper")
    if low == high == 0.0:
        noted[NONE].append(joint.get("name", ""))
        for end in ("lower", "upper"):
            limit.attrib.pop(end, None)
        return
    for soft in joint.findall("safety_controller")[:1]:
        soft_low, soft_high = number(soft, "soft_lower_limit", low), number(soft, "soft_upper_limit", high)
        if (soft_low > low or soft_high < high) and (soft_low or soft_high):  # both 0 is how URDF says: there are none
            low, high = max(low, soft_low), min(high, soft_high)
            noted[SOFT].append(joint.get("name", ""))
    limit.attrib |= {"lower": repr(low), "upper": repr(high)}  # one that is not given is 0


def _rewrite_compiler(root: Element) -> str:
    """Folder of the meshes that MuJoCo's extension names; its settings become those that keep every link and shape."""
    extension = root.find("mujoco")
    extension = SubElement(root, "mujoco") if extension is None else extension
    compiler = extension.find("compiler")
    compiler = Element("compiler") if compiler is None else compiler
    extension[:] = [compiler, *extension.findall("option")]
    folders = [compiler.attrib.pop(key, "") for key in ("meshdir", "assetdir", "texturedir")]
    kept = {"discardvisual": "false", "fusestatic": "false", "strippath": "false"}
    compiler.attrib = {"inertiafromgeom": "false"} | compiler.attrib | kept
    return folders[0] or folders[1]
