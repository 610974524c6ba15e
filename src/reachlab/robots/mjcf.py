"""MJCF rewritten for MuJoCo: one text without includes, plain names of files, and nothing that grows without bound."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import PurePosixPath

from reachlab.robots.picture_files import TEXTURES, PictureFiles
from reachlab.robots.safe_xml import MOST_ELEMENTS, MOST_NESTING, Element, XmlFiles, numbers, to_text
from reachlab.robots.urdf import MOST_BODIES
from reachlab.settings.validation import InputError

REFUSED = {
    "plugin": "plugins are not loaded",
    "extension": "plugins are not loaded",
    "composite": "an arm has no soft bodies",
    "flexcomp": "an arm has no soft bodies",
    "flex": "an arm has no soft bodies",
}
"""Elements that are not read, and why."""

MOST_INCLUDED, MOST_PARTS, DEEPEST_PART = 200, 50, 5
"""Number of included files and of sub-models, and depth to which sub-models may name others."""

LARGEST = {
    ("size", "nkey"): 10_000,
    ("size", "nuserdata"): 10_000,
    **{
        ("size", f"nuser_{what}"): 1000
        for what in ("actuator", "body", "cam", "geom", "jnt", "sensor", "site", "tendon")
    },
    ("numeric", "size"): 100_000,
    ("user", "dim"): 10_000,
    ("contact", "num"): 1000,
    ("texture", "width"): 4096,
    ("texture", "height"): 32_768,
    ("texture", "nchannel"): 4,
    ("texture", "gridsize"): 12,
    ("hfield", "nrow"): 2048,
    ("hfield", "ncol"): 2048,
    ("mesh", "params"): 100,
    ("mesh", "maxhullvert"): 10_000,
    ("camera", "resolution"): 8192,
    ("global", "offwidth"): 8192,
    ("global", "offheight"): 8192,
    ("quality", "shadowsize"): 16_384,
    ("quality", "offsamples"): 64,
    ("quality", "numslices"): 1000,
    ("quality", "numstacks"): 1000,
    ("quality", "numquads"): 1000,
    ("lengthrange", "inttotal"): 100,
    ("lengthrange", "interval"): 100,
}
"""Largest number of an attribute, or of any of its numbers; memory and time grow with it."""

LEAST_TIMESTEP = 1e-4
"""Least time step of the search for length ranges [s]."""
MOST_SAMPLES = 10_000
"""Longest delay buffer of an actuator or sensor."""


@dataclass
class _Document:
    """One model of an MJCF file, which may name others as its parts."""

    texts: XmlFiles
    pictures: PictureFiles
    parts: dict[str, bytes] = field(default_factory=dict)
    left_out: dict[str, None] = field(default_factory=dict)


def rewrite_mjcf(root: Element, texts: XmlFiles, pictures: PictureFiles) -> tuple[str, dict[str, bytes], list[str]]:
    """Text for MuJoCo, text of each sub-model by name, and one sentence on each change.

    Raises:
        InputError: it includes what it must not, or is too large.
    """
    document = _Document(texts, pictures)
    _rewrite(root, document, 0)
    notices = pictures.notice()
    if document.left_out:
        notices.append(f"Left out: {', '.join(document.left_out)}.")
    return to_text(root), document.parts, notices


def _rewrite(root: Element, document: _Document, depth: int) -> int:
    """Rewrite one model in place; its number of elements once it is unfolded."""
    file = document.texts.file
    if root.tag != "mujoco":
        raise InputError(f"robot file {str(file)!r} names a model of kind <{root.tag}>; <mujoco> is read.")
    _include(root, document, set(), 0)
    for element in root.iter():
        if element.tag in REFUSED:
            raise InputError(
                f"robot file {str(file)!r} has the element <{element.tag}>, which is not read: {REFUSED[element.tag]}."
            )
        _check_size(element, document)
    _rewrite_files(root, document)
    part = max((_rewrite_part(model, document, depth) for model in root.findall("asset/model")), default=0)
    elements, bodies = _unfolded(root, "", part), _unfolded(root, "body", part)
    if elements > MOST_ELEMENTS or bodies > MOST_BODIES:
        raise InputError(
            f"robot file {str(file)!r} unfolds to {elements:,} elements and {bodies:,} bodies; at most"
            f" {MOST_ELEMENTS:,} and {MOST_BODIES:,} are read."
        )
    return elements


def _include(parent: Element, document: _Document, included: set[str], depth: int) -> None:
    """Put the content of included files in the place of their `<include>`."""
    if depth > MOST_NESTING:
        raise InputError(f"robot file {str(document.texts.file)!r} nests its includes too deep.")
    position = 0
    while position < len(parent):
        child = parent[position]
        if child.tag != "include":
            _include(child, document, included, depth + 1)
            position += 1
            continue
        name = child.get("file", "")
        if name in included:
            raise InputError(f"robot file {str(document.texts.file)!r} includes {name!r} twice; once is allowed.")
        included.add(name)
        if len(included) > MOST_INCLUDED:
            raise InputError(f"robot file {str(document.texts.file)!r} includes more than {MOST_INCLUDED} files.")
        parent[position : position + 1] = [*document.texts.part(name)]


def _check_size(element: Element, document: _Document) -> None:
    for key, text in element.attrib.items():
        most = MOST_SAMPLES if key == "nsample" else LARGEST.get((element.tag, key), math.inf)
        if most < math.inf and max(numbers(text, len(text.split())), default=0.0) > most:
            raise InputError(
                f"robot file {str(document.texts.file)!r}: {key}={text[:40]!r} of <{element.tag}> is too large;"
                f" at most {most} is read."
            )
    if element.tag == "lengthrange" and numbers(element.get("timestep"), 1, 1.0)[0] < LEAST_TIMESTEP:
        raise InputError(
            f"robot file {str(document.texts.file)!r}: timestep of <lengthrange> must be at least {LEAST_TIMESTEP:g} s."
        )
    if element.tag == "size":
        for key in ("memory", "njmax", "nconmax", "nstack"):
            element.attrib.pop(key, None)


def _unfolded(element: Element, tag: str, part: int) -> int:
    """Number of elements of a tag (of any, if empty) once replicates and sub-models are unfolded."""
    if element.tag == "attach":
        return part
    inside = sum(_unfolded(child, tag, part) for child in element)
    times = max(1, int(numbers(element.get("count"), 1, 1.0)[0])) if element.tag == "replicate" else 1
    return times * inside + (element.tag == tag or not tag)


def _rewrite_part(model: Element, document: _Document, depth: int) -> int:
    """Give a sub-model a plain name; its number of elements."""
    name = model.get("file", "")
    if depth == DEEPEST_PART or len(document.parts) == MOST_PARTS:
        raise InputError(
            f"robot file {str(document.texts.file)!r} names more than {MOST_PARTS} models, or nests them deeper than"
            f" {DEEPEST_PART}."
        )
    root = document.texts.part(name)
    plain = f"part_{len(document.parts)}.xml"
    document.parts[plain] = b""
    elements = _rewrite(root, document, depth + 1)
    document.parts[plain] = to_text(root).encode()
    model.attrib.pop("content_type", None)
    model.set("file", plain)
    return elements


def _rewrite_files(root: Element, document: _Document) -> None:
    folders = _folders(root)
    for parent in [*root.iter("asset"), *root.iter("deformable")]:
        for skin in parent.findall("skin"):
            if skin.get("file") is not None:
                parent.remove(skin)
                document.left_out["skins of files"] = None
    for element in root.iter():
        element.attrib.pop("content_type", None)
        if element.tag == "mesh" and element.get("file"):
            _rename(element, "file", folders["meshdir"], document.pictures)
        elif element.tag == "hfield" and element.get("file"):
            _rename(element, "file", folders["meshdir"], document.pictures, TEXTURES)
        elif element.tag == "texture":
            for key in [key for key in element.attrib if key.startswith("file")]:
                _rename(element, key, folders["texturedir"], document.pictures, TEXTURES)
        elif element.tag == "attach" and not element.get("model"):
            raise InputError(
                f"robot file {str(document.texts.file)!r} attaches parts of itself, which is not read: copy them."
            )


def _folders(root: Element) -> dict[str, str]:
    """Folders of the meshes and textures; the compiler elements no longer name them."""
    said: dict[str, str] = {}
    for compiler in root.iter("compiler"):
        for key in ("assetdir", "meshdir", "texturedir", "strippath"):
            if key in compiler.attrib:
                said[key] = compiler.attrib.pop(key)
    both = said.get("assetdir", "")
    return {"meshdir": said.get("meshdir", both), "texturedir": said.get("texturedir", both)}


def _rename(element: Element, key: str, folder: str, pictures: PictureFiles, kinds: tuple[str, ...] = ()) -> None:
    name = element.get(key, "")
    if key == "file" and not element.get("name"):
        element.set("name", PurePosixPath(name.replace("\\", "/")).stem)
    element.set(key, pictures.add(name, folder, kinds) if kinds else pictures.add(name, folder))
