"""XML of a file that nobody vouches for: bounded in size and depth, without entities, with finite numbers only."""

from __future__ import annotations

import contextlib
import hashlib
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

from reachlab.settings.reading import read_regular
from reachlab.settings.validation import InputError

MOST_XML, MOST_TAGS, MOST_NESTING = 20 * 2**20, 20_000, 200
"""Size of all XML text of a robot [bytes], its tags, and how deep they are nested."""

LARGEST_NUMBER = 1e20
"""Larger numbers overflow when MuJoCo multiplies them."""

LARGEST = {
    "size": 100_000,
    **dict.fromkeys(("maxhullvert", "nsample"), 10_000),
    **dict.fromkeys(("width", "height", "resolution"), 4096),
    **dict.fromkeys(("nrow", "ncol"), 2048),
    "params": 100,
    **dict.fromkeys(("gridsize", "nchannel"), 12),
}
"""Largest number of attributes with which memory and time grow."""

MOST_DRAWN = 2**25
"""Numbers that all elements together may stand for by their sizes: pixels, heights, entries."""

BYTE_ORDERS = (b"\xff\xfe", b"\xfe\xff")
"""How text in UTF-16 begins."""

Element = ET.Element


def parse_xml(text: str) -> Element:
    """The root element of XML text; comments are left out.

    Raises:
        InputError: it is not well-formed, declares a document type or entities, or holds a number that is too large.
    """
    if "<!DOCTYPE" in text:
        raise InputError("declares a document type or entities: remove its <!DOCTYPE ...>.")
    try:
        root = ET.fromstring(text)  # noqa: S314 (without a document type there are no entities)
    except ET.ParseError as error:
        raise InputError(f"does not compile: it is not well-formed XML: {error}.") from None
    for element in root.iter():
        for key, value in element.attrib.items():
            most = LARGEST.get(key, LARGEST_NUMBER)
            if key not in ("name", "class", "childclass") and not _bounded(value, most):
                raise InputError(
                    f"has {key}={value[:40]!r} of <{element.tag}>: finite numbers up to {most:g} are read."
                )
    return root


def _bounded(text: str, most: float) -> bool:
    """Whether a text is anything but numbers of which one is infinite, undefined or too large."""
    with contextlib.suppress(ValueError):
        return all(abs(value) <= most for value in map(_value, text.split()))
    return True


def _value(word: str) -> float:
    """A number as MuJoCo reads it: in hexadecimal too, and `nan(...)`."""
    if word.lower().lstrip("+-").startswith("nan("):
        return math.nan
    try:
        return float.fromhex(word) if "0x" in word.lower() else float(word)
    except OverflowError:
        return math.inf


def to_text(root: Element) -> str:
    """XML text of an element.

    Raises:
        InputError: it is nested too deep.
    """
    level = [root]
    for _ in range(MOST_NESTING):
        level = [child for element in level for child in element]
    if level:
        raise InputError(f"nests XML deeper than {MOST_NESTING} elements.")
    return ET.tostring(root, encoding="unicode")


def number(element: Element, key: str, default: float = 0.0) -> float:
    """The number that an attribute is.

    Raises:
        InputError: it is something else.
    """
    text = element.get(key, str(default))
    try:
        return float(text)
    except ValueError:
        raise InputError(f"has {key}={text[:40]!r} of <{element.tag}>, which must be a number.") from None


class XmlFiles:
    """Reads the XML files of one robot: together no larger than `MOST_XML`, with no more than `MOST_TAGS`.

    Attributes:
        file: the robot file.
        files: all that were read.
        hash: SHA-256 of their text.
    """

    def __init__(self, file: Path, find: Callable[[str], Path | None]) -> None:
        self.file = file
        self.files: set[Path] = set()
        self.hash = hashlib.sha256()
        self._find, self._left, self._tags, self._drawn = find, MOST_XML, 0, 0.0

    def root(self) -> Element:
        """Root of the robot file itself.

        Raises:
            InputError: it is missing or no XML that can be read.
        """
        if not self.file.exists():
            raise InputError("does not exist: put it there, or name another robot.")
        root = self._parse(self.file)
        if root.tag not in ("mujoco", "robot"):
            raise InputError(f"is neither MJCF (<mujoco>) nor URDF (<robot>): its root is <{root.tag[:40]}>.")
        return root

    def part(self, name: str) -> Element:
        """Root of another file that the robot file includes.

        Raises:
            InputError: it is not in the robot file's folders, no XML that can be read, or was read before.
        """
        path = self._find(name) if name.lower().endswith((".xml", ".mjcf")) else None
        if path is None:
            raise InputError(f"includes {name[:80]!r}, which is no .xml file in its folder or the one above it.")
        if path in self.files:
            raise InputError(f"includes {name[:80]!r} twice; once is allowed.")
        return self._parse(path)

    def _parse(self, file: Path) -> Element:
        try:
            data, _ = read_regular(file, self._left)
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}.") from None
        self._left -= len(data)
        self.files |= {file, file.resolve()}
        self.hash.update(data)
        text = _decoded(data)
        self._tags += text.count("<")
        if self._tags > MOST_TAGS:
            raise InputError(f"has more than {MOST_TAGS:,} XML tags, those of included files among them.")
        if "<xacro:" in text or file.suffix == ".xacro":
            stem = file.name.removesuffix(".xacro").removesuffix(".urdf")
            raise InputError(f"is a xacro file: expand it with `xacro {file.name} > {stem}_expanded.urdf`.")
        root = parse_xml(text)
        self._drawn += sum(map(_drawn, root.iter()))
        if self._drawn > MOST_DRAWN:
            raise InputError(f"asks for textures, height fields and data of more than {MOST_DRAWN:,} numbers together.")
        return root


def _drawn(element: Element) -> float:
    """How many numbers an element stands for by its sizes; `parse_xml` has looked at each of them."""

    def sides(*keys: str) -> float:
        return math.prod(number(element, key) for key in keys) if all(key in element.attrib for key in keys) else 0.0

    if element.tag == "texture" and element.get("type", "cube") != "2d":  # six squares, whatever height is said
        return 6.0 * sides("width") ** 2
    entries = sides("size") if element.tag == "numeric" else 0.0
    return sides("width", "height") + sides("nrow", "ncol") + entries


def _decoded(data: bytes) -> str:
    """The text without comments, line for line: many robot files write `--` inside them, which XML forbids."""
    try:
        text = data.decode("utf-16" if data.startswith(BYTE_ORDERS) else "utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    text, parts, at = text.lstrip("\ufeff \t\r\n"), list[str](), 0
    while (begin := text.find("<!--", at)) >= 0 and (end := text.find("-->", begin + 4)) >= 0:
        parts += [text[at:begin], "\n" * text.count("\n", begin, end)]
        at = end + 3
    return "".join([*parts, text[at:]])
