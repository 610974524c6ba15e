"""Meshes and textures that a robot file names: which can be drawn, under plain names of their own."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from reachlab.robots.mesh_search import Folders
from reachlab.settings.reading import read_regular
from reachlab.settings.validation import InputError

MESHES, TEXTURES = (".stl", ".obj", ".msh"), (".png",)
"""Kinds of files that MuJoCo reads."""
MOST_MESH, MOST_MESHES = 100 * 2**20, 300 * 2**20
"""Size of one mesh and of all [bytes]."""
MOST_FILES = 1000
"""So many meshes and textures are looked for."""
MOST_FACES = 200_000
"""Faces that MuJoCo reads from an STL file."""
MOST_PIXELS = 4096 * 4096
"""Pixels of one texture."""
MOST_NAMED = 6
"""So many files are named in a notice."""
LONGEST_NAME = 200
"""Letters of a name that are shown."""
MISSING = "missing.stl"
"""Name of what cannot be drawn."""
HEAD = 84
"""Bytes that tell whether a file is what its name says."""


@dataclass
class PictureFiles:
    """Collects the meshes and textures of a robot file.

    Attributes:
        folders: where they may lie.
        files: path of each that can be drawn, by the name under which MuJoCo gets it.
        refused: why others are not drawn, with their names.
    """

    folders: Folders
    files: dict[str, Path] = field(default_factory=dict)
    refused: defaultdict[str, dict[str, None]] = field(default_factory=lambda: defaultdict(dict))
    _seen: dict[tuple[str, str, str], str] = field(default_factory=dict)
    _total: int = 0

    def add(self, name: str, below: str = "", kinds: tuple[str, ...] = MESHES, scale: str = "") -> str:
        """The plain name under which MuJoCo gets a file, another for each scale; `MISSING` where it cannot be drawn.

        Raises:
            InputError: there are too many, or all together are too large.
        """
        if (name, below, scale) not in self._seen:
            if len(self._seen) == MOST_FILES:
                raise InputError(
                    f"robot file {str(self.folders.file)!r} names more than {MOST_FILES:,} meshes or textures."
                )
            self._seen[name, below, scale] = self._add(name, below, kinds)
        return self._seen[name, below, scale]

    def _add(self, name: str, below: str, kinds: tuple[str, ...]) -> str:
        short = PurePosixPath(name.replace("\\", "/")[-LONGEST_NAME:])
        suffix = short.suffix.lower()
        if suffix not in kinds:
            return self._refuse(f"are {suffix or 'without suffix'}, which MuJoCo does not read", short.name)
        path = self.folders.find(name, below)
        if path is None or path.suffix.lower() not in kinds:
            asked = name[:LONGEST_NAME] if name.startswith("package:") else short.name  # what --package has to name
            return self._refuse("were not found in the folders of the robot file or of its packages", asked)
        try:
            head, size = read_regular(path, MOST_MESH, HEAD)
        except OSError as error:
            return self._refuse(f"cannot be read ({error.strerror or error})", short.name)
        if suffix in UNLIKE and (why := UNLIKE[suffix](head, size)):
            return self._refuse(why, short.name)
        self._total += size
        if self._total > MOST_MESHES:
            raise InputError(
                f"robot file {str(self.folders.file)!r} names meshes of more than {MOST_MESHES / 2**20:.0f} MB in all:"
                " make them smaller, or remove some."
            )
        plain, number = f"{short.stem}{suffix}", 1
        while plain in self.files or plain == MISSING:
            number += 1
            plain = f"{short.stem}_{number}{suffix}"
        self.files[plain] = path
        return plain

    def _refuse(self, why: str, name: str) -> str:
        self.refused[why][name] = None
        return MISSING

    def notice(self) -> list[str]:
        """One sentence on all that is not drawn."""
        if not self.refused:
            return []
        count = sum(map(len, self.refused.values()))
        parts = [f"{len(names)} {why} ({_some(list(names))})" for why, names in self.refused.items()]
        return [f"{count} files of meshes or textures are not drawn: {'; '.join(parts)}."]


def _some(names: list[str]) -> str:
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more


def _unlike_stl(head: bytes, size: int) -> str:
    if len(head) < HEAD:
        return "are shorter than any STL file"
    faces = struct.unpack_from("<I", head, 80)[0]
    if size < HEAD + 50 * faces:
        return "are text or cut short, while MuJoCo reads binary STL files"
    return "" if 1 <= faces <= MOST_FACES else f"have no faces, or more than {MOST_FACES:,}"


def _unlike_msh(head: bytes, size: int) -> str:
    if len(head) < 16:
        return "are shorter than any MSH file"
    vertices, normals, corners, faces = counts = struct.unpack_from("<4i", head)
    fits = size == 16 + 4 * (3 * vertices + 3 * normals + 2 * corners + 3 * faces)
    return "" if min(counts) >= 0 and fits else "are no MSH files of MuJoCo"


def _unlike_png(head: bytes, size: int) -> str:
    if size < HEAD // 2 or head[:8] != b"\x89PNG\r\n\x1a\n" or head[12:16] != b"IHDR":
        return "are no PNG images"
    width, height = struct.unpack_from(">2I", head, 16)
    return "" if 0 < width * height <= MOST_PIXELS else f"have more than {MOST_PIXELS:,} pixels"


UNLIKE: dict[str, Callable[[bytes, int], str]] = {".stl": _unlike_stl, ".msh": _unlike_msh, ".png": _unlike_png}
"""Why a file, by its head and size, is not what its suffix says; empty where it is."""
