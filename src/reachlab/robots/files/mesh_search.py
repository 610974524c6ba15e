"""Search of the files that a robot file names: in its own folders and in packages, and nowhere else."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from reachlab.settings.reading import read_regular

MOST_PACKAGE_XML = 2**20
"""Size of a package.xml [bytes]."""


@dataclass(frozen=True)
class Folders:
    """Where the files that a robot file names may lie.

    Attributes:
        file: the robot file.
        packages: folders of packages, by name, as the user gave them.
    """

    file: Path
    packages: Mapping[str, Path] = field(default_factory=dict)

    def find(self, name: str, below: str = "") -> Path | None:
        """The regular file that a robot file calls `name`, `package://name/...` or `file://...`.

        Args:
            name: as the robot file writes it.
            below: folder of the robot file's meshes or textures, relative to it.
        """
        for path, owners in self._candidates(name.strip().replace("\\", "/"), below.replace("\\", "/")):
            with contextlib.suppress(OSError, ValueError, RuntimeError):  # links in a circle, or the name is no path
                real = path.resolve(strict=True)
                if real.is_file() and (owners is None or any(real.is_relative_to(one.resolve()) for one in owners)):
                    return real
        return None

    def _candidates(self, name: str, below: str) -> Iterator[tuple[Path, list[Path] | None]]:
        """Paths that may be meant, with the folders that each must lie in; None where links lead on.

        Those of packages that the user has named or installed do: `colcon build --symlink-install` makes such.
        """
        scheme, found, rest = name.partition("://")
        own = self._own()
        if found and scheme in ("package", "model"):
            package, _, inside = rest.partition("/")
            for folder, trusted in self._package_folders(package):
                within = Path(os.path.normpath(folder / inside)).is_relative_to(os.path.normpath(folder))
                yield folder / inside, None if trusted and within else [folder]
            return
        path = PurePosixPath(unquote(rest) if found and scheme == "file" else name)
        if path.is_absolute():
            yield Path(path), own
        for start in self._starts():
            yield start / below / path, own
            yield start / path, own
            yield start / below / path.name, own

    def _starts(self) -> list[Path]:
        """Folder of the robot file, as it is named and as links lead to it."""
        return list(dict.fromkeys([self.file.absolute().parent, self.file.resolve().parent]))

    def _own(self) -> list[Path]:
        """The robot file's folder and the one above it, unless that holds the homes of users or the whole disk."""
        starts = self._starts()
        return [*starts, *(start.parent for start in starts if not _shared(start.parent))]

    def _package_folders(self, package: str) -> Iterator[tuple[Path, bool]]:
        """Folders that may be a package's, and whether the user has named or installed them."""
        if not re.fullmatch(r"[\w.+-]*[\w+-][\w.+-]*", package):
            return
        if package in self.packages:
            yield self.packages[package], True
        above = [folder for start in self._starts() for folder in (start, *start.parents)]
        for folder in (*above, *_listed("ROS_PACKAGE_PATH")):
            if _shared(folder):
                continue
            if folder.name == package or _package_name(folder / "package.xml") == package:
                yield folder, False
            yield folder / package, False
        for folder in _listed("AMENT_PREFIX_PATH"):
            yield folder / "share" / package, True


def _listed(variable: str) -> list[Path]:
    return [Path(part) for part in os.environ.get(variable, "").split(os.pathsep) if part]


def _shared(folder: Path) -> bool:
    """Whether a folder is the disk's root or holds the homes of its users."""
    return folder == folder.parent or folder in Path.home().parents


def _package_name(file: Path) -> str:
    """What a package.xml calls its package; empty without one."""
    try:
        data, _ = read_regular(file, MOST_PACKAGE_XML)
    except OSError:
        return ""
    found = re.search(rb"<name>\s*([^<\s]+)\s*</name>", data)
    return found[1].decode(errors="replace") if found else ""
