"""XML of a file that nobody vouches for: bounded in size and depth, without entities, with finite numbers only."""

from __future__ import annotations

import contextlib
import hashlib
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.parsers import expat

from reachlab.settings.reading import read_regular
from reachlab.settings.validation import InputError

MOST_XML = 20 * 2**20
"""Size of all XML text of a robot [bytes]."""
MOST_ELEMENTS, MOST_NESTING = 10_000, 200
LARGEST_NUMBER = 1e20
"""Larger numbers overflow when MuJoCo multiplies them."""

Element = ET.Element


def parse_xml(data: bytes, file: Path) -> Element:
    """The root element of XML text; comments are left out.

    Raises:
        InputError: it is not well-formed, declares a document type or entities, is too large or holds a number that
            is not finite.
    """
    if b"\0" in data[:64] and not data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"robot file {str(file)!r} does not compile: it is binary, not XML text.")
    builder, parser, depth, count = ET.TreeBuilder(), expat.ParserCreate(), 0, 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MOST_NESTING:
            raise InputError(f"robot file {str(file)!r} nests XML deeper than {MOST_NESTING} elements.")
        if count > MOST_ELEMENTS:
            raise InputError(f"robot file {str(file)!r} has more than {MOST_ELEMENTS:,} XML elements.")
        _check_numbers(tag, attributes, file)
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def refuse(*_: object) -> None:
        raise InputError(f"robot file {str(file)!r} declares a document type or entities: remove its <!DOCTYPE ...>.")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(_without_comments(data), True)
    except expat.ExpatError as error:
        raise InputError(f"robot file {str(file)!r} does not compile: it is not well-formed XML: {error}.") from None
    except (UnicodeError, LookupError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"robot file {str(file)!r} does not compile: its encoding is not known: {error}.") from None
    return builder.close()


def _without_comments(data: bytes) -> bytes:
    """The text without comments, line for line: many robot files write `--` inside them, which XML forbids."""
    return re.sub(rb"<!--.*?-->", lambda found: b"\n" * found[0].count(b"\n"), data.lstrip(), flags=re.DOTALL)


def _check_numbers(tag: str, attributes: Mapping[str, str], file: Path) -> None:
    for key, text in attributes.items():
        if key not in ("name", "class", "childclass") and not _finite(text):
            raise InputError(f"robot file {str(file)!r}: {key}={text[:40]!r} of <{tag}> must be finite numbers.")


def _finite(text: str) -> bool:
    """Whether a text is anything but numbers of which one is infinite, undefined or too large."""
    with contextlib.suppress(ValueError):
        return all(abs(value) <= LARGEST_NUMBER for value in map(float, text.split()))
    return True


def to_text(root: Element) -> str:
    """XML text of an element."""
    return ET.tostring(root, encoding="unicode")


def numbers(text: str | None, count: int, default: float = 0.0) -> tuple[float, ...]:
    """`count` numbers of an attribute; the default for each where it is absent or of another form."""
    with contextlib.suppress(ValueError, AttributeError):
        values = tuple(float(part) for part in (text or "").split())
        if len(values) == count and all(map(math.isfinite, values)):
            return values
    return (default,) * count


def are_numbers(text: str, count: int) -> bool:
    """Whether a text is so many finite numbers."""
    return numbers(text, count, math.nan) == numbers(text, count)


class XmlFiles:
    """Reads the XML files of one robot: together no larger than `MOST_XML`.

    Attributes:
        file: the robot file.
        files: all that were read.
        hash: SHA-256 of their text.
    """

    def __init__(self, file: Path, find: Callable[[str], Path | None]) -> None:
        self.file = file
        self.files: list[Path] = []
        self.hash = hashlib.sha256()
        self._find, self._left, self._elements = find, MOST_XML, 0

    def root(self) -> Element:
        """Root of the robot file itself.

        Raises:
            InputError: it is missing or no XML that can be read.
        """
        what = f"robot file {str(self.file)!r}"
        if not self.file.exists():
            raise InputError(f"{what} does not exist: put it there, or train with another --robot.")
        root = self._parse(self.file)
        prefixed = any(element.tag.startswith("xacro:") for element in root.iter())
        if prefixed or self.file.suffix == ".xacro":
            stem = self.file.name.removesuffix(".xacro").removesuffix(".urdf")
            raise InputError(f"{what} is a xacro file: expand it with `xacro {self.file.name} > {stem}_expanded.urdf`.")
        if root.tag == "mujocoinclude":
            raise InputError(f"{what} is a part that other files include: name the file that includes it.")
        if root.tag not in ("mujoco", "robot"):
            raise InputError(f"{what} is neither MJCF (<mujoco>) nor URDF (<robot>): its root is <{root.tag[:40]}>.")
        return root

    def part(self, name: str) -> Element:
        """Root of another file that the robot file names.

        Raises:
            InputError: it is not in the robot file's folders, or no XML that can be read.
        """
        path = self._find(name) if name.lower().endswith((".xml", ".mjcf")) else None
        if path is None:
            raise InputError(
                f"robot file {str(self.file)!r} includes {name[:80]!r}, which is no .xml file in its folder or the one"
                " above it."
            )
        return self._parse(path)

    def _parse(self, file: Path) -> Element:
        try:
            data, _ = read_regular(file, self._left)
        except OSError as error:
            raise InputError(f"robot file {str(file)!r} cannot be read: {error.strerror or error}.") from None
        self._left -= len(data)
        self.files.append(file)
        self.hash.update(data)
        root = parse_xml(data, file)
        self._elements += sum(1 for _ in root.iter())
        if self._elements > MOST_ELEMENTS:
            raise InputError(f"robot file {str(self.file)!r} includes more than {MOST_ELEMENTS:,} XML elements in all.")
        return root
