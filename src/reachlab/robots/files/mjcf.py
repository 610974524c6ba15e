"""MJCF rewritten for MuJoCo: one text without includes, plain names of files, and nothing that grows without bound."""

from __future__ import annotations

from pathlib import PurePosixPath

from reachlab.robots.files.picture_files import MESHES, TEXTURES, PictureFiles
from reachlab.robots.files.safe_xml import Element, XmlFiles, to_text
from reachlab.settings.validation import InputError

REFUSED = ("attach", "composite", "extension", "flex", "flexcomp", "model", "plugin", "replicate")
"""Elements that are not read: they stand for any number of others, or for code."""

SKIPPED = ("global", "lengthrange", "quality", "sensor", "size", "skin")
"""Elements that are left out: the arm does not depend on them, and memory or time could grow with them."""

FILES = {"mesh": ("meshdir", MESHES), "hfield": ("meshdir", TEXTURES), "texture": ("texturedir", TEXTURES)}
"""Setting of the compiler that names the folder of an element's files, and their kinds."""


def rewrite_mjcf(root: Element, texts: XmlFiles, pictures: PictureFiles) -> str:
    """Text for MuJoCo.

    Raises:
        InputError: it includes what it must not, or is too large.
    """
    _include(root, texts)
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in REFUSED:
                raise InputError(
                    f"has the element <{child.tag}>, which is not read: write it out, as does"
                    " `mujoco.MjSpec.from_file(...).to_xml()`, without plugins and soft bodies."
                )
            if child.tag in SKIPPED:
                parent.remove(child)
    folders = _folders(root)
    for element in root.iter():
        element.attrib.pop("content_type", None)
        folder, kinds = FILES.get(element.tag, ("", ()))
        for key in [key for key in element.attrib if folder and key.startswith("file")]:
            name = element.attrib[key]
            if key == "file" and not element.get("name"):
                element.set("name", PurePosixPath(name.replace("\\", "/")).stem)
            element.set(key, pictures.add(name, folders[folder], kinds))
    return to_text(root)


def _include(root: Element, texts: XmlFiles) -> None:
    """Put the content of included files in the place of their `<include>`."""
    waiting = [root]
    for parent in waiting:
        while (include := parent.find("include")) is not None:
            place = list(parent).index(include)
            parent[place : place + 1] = [*texts.part(include.get("file", ""))]
        waiting += parent


def _folders(root: Element) -> dict[str, str]:
    """Folders of the meshes and textures; the compiler elements no longer name them."""
    named: dict[str, str] = {}
    for compiler in root.iter("compiler"):
        for key in ("assetdir", "meshdir", "texturedir", "strippath"):
            if key in compiler.attrib:
                named[key] = compiler.attrib.pop(key)
    both = named.get("assetdir", "")
    return {"meshdir": both, "texturedir": both} | named
