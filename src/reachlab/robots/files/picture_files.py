"""Meshes and textures that a robot file names: which can be drawn, under plain names of their own."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from reachlab.robots.files.mesh_search import Folders
from reachlab.settings.reading import read_regular
from reachlab.settings.validation import InputError

MESHES, TEXTURES = (".stl", ".obj", ".msh"), (".png",)
"""Kinds of files that MuJoCo reads."""
MOST_MESH, MOST_MESHES = 100 * 2**20, 300 * 2**20
"""Size of one mesh and of all [bytes]."""
MOST_FILES = 1000
"""So many meshes and textures are looked for."""
MOST_PIXELS = 4096 * 4096
"""Pixels of one texture."""
LONGEST_NAME = 200
"""Letters of a name that are shown."""
MISSING = "missing.stl"
"""Name of what cannot be drawn."""
PNG, HEAD = b"\x89PNG\r\n\x1a\n", 24
"""How a PNG image begins, and the bytes of it up to the image's size."""


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
    _seen: dict[tuple[str, str], str] = field(default_factory=dict)
    _total: int = 0

    def add(self, name: str, below: str, kinds: tuple[str, ...]) -> str:
        """The plain name under which MuJoCo gets a file of some kinds; `MISSING` where it cannot be drawn.

        Raises:
            InputError: there are too many, or all together are too large.
        """
        if (name, below) not in self._seen:
            self._seen[name, below] = self._add(name, below, kinds)
            if len(self._seen) > MOST_FILES or self._total > MOST_MESHES:
                raise InputError(
                    f"names more than {MOST_FILES:,} meshes or textures, or more than {MOST_MESHES / 2**20:.0f} MB of"
                    " them: make them smaller, or remove some."
                )
        return self._seen[name, below]

    def _add(self, name: str, below: str, kinds: tuple[str, ...]) -> str:
        short = PurePosixPath(name.replace("\\", "/")[-LONGEST_NAME:])
        suffix = short.suffix.lower()
        if suffix not in kinds:
            return self._refuse(f"are {suffix or 'without suffix'}, which MuJoCo does not read", short.name)
        path = self.folders.find(name, below)
        if path is None or path.suffix.lower() not in kinds:
            shown = name[:LONGEST_NAME] if name.startswith("package:") else short.name  # what --package has to name
            where = "the folder of the robot file and the one above it, and others are not read"
            if shown != short.name:
                where = "the folders of their packages, which --package NAME=FOLDER says"
            return self._refuse(f"were not found in {where}", shown)
        try:
            head, size = read_regular(path, MOST_MESH, HEAD)
        except OSError as error:
            return self._refuse(f"cannot be read ({error.strerror or error})", short.name)
        if kinds == TEXTURES and not (head.startswith(PNG) and len(head) == HEAD and _pixels(head) <= MOST_PIXELS):
            return self._refuse(f"are no PNG images of at most {MOST_PIXELS:,} pixels", short.name)
        self._total += size
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
        count = sum(map(len, self.refused.values()))
        parts = [f"{len(names)} {why} ({some(names)})" for why, names in self.refused.items()]
        return [f"{count} files of meshes or textures are not drawn: {'; '.join(parts)}."] if parts else []


def _pixels(head: bytes) -> int:
    width, height = struct.unpack_from(">2I", head, 16)
    return width * height


def some(names: Iterable[str], most: int = 6) -> str:
    """The first names, and how many more there are."""
    listed = list(names)
    return ", ".join(listed[:most]) + (f" and {len(listed) - most} more" if len(listed) > most else "")
