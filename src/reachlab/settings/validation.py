"""Input that is refused in one sentence: names of tables, and dataclasses that check their fields."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import functools
import math
import operator
import reprlib
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from typeguard import TypeCheckError, check_type


class InputError(ValueError):
    """Input that is refused, in one sentence: what, got, allowed, how to mend."""


MANY = 30
"""Names of which only the nearest are told."""


def choose(kind: str, name: str, names: Iterable[str], titles: Mapping[str, str] | None = None) -> str:
    """The name itself if it is one of `names`, some of which have titles, under which they may be known.

    Raises:
        InputError: it is not; the sentence lists the names and the nearest one, or of many the nearest alone.
    """
    allowed = sorted(names)
    if name in allowed:
        return name
    if not isinstance(name, str):
        raise InputError(f"{kind} must be one of {', '.join(allowed)}, got {reprlib.repr(name)}.")
    near = [known for known in allowed if known.startswith(str(name).rstrip("s") or " ")]
    words = {known: known.split("_") for known in allowed if "_" in known}
    near = near or [known for known, parts in words.items() if "".join(part[:1] for part in parts) == name]
    near = near or difflib.get_close_matches(str(name), allowed, n=3)
    if near and len(allowed) > MANY:
        raise InputError(f"{kind} {name!r} does not exist. Did you mean {' or '.join(map(repr, near))}?")
    near += [known for known, title in (titles or {}).items() if str(name).lower() in title.lower().split()]
    hint = f" Did you mean {near[0]!r}?" if near else ""
    raise InputError(f"{kind} {name!r} is not one of: {', '.join(allowed)}.{hint}")


def installing(extra: str) -> str:
    """The command that installs an extra in the way in which reachlab was installed: an editable one stays editable."""
    import json
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import unquote, urlsplit

    try:
        origin = json.loads(distribution("reachlab").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        origin = {}
    folder = origin.get("dir_info")
    place = "reachlab" if folder is None else unquote(urlsplit(origin["url"]).path)
    return f"pip install {'-e ' * bool(folder and folder.get('editable'))}'{place}[{extra}]'"


@contextlib.contextmanager
def needing(sentence: str, extra: str, missing: type[ImportError] = ModuleNotFoundError) -> Iterator[None]:
    """Refuse where a package is missing inside: a sentence, its `{}` the command that installs an extra.

    Raises:
        InputError: one is.
    """
    try:
        yield
    except missing:
        raise InputError(sentence.format(installing(extra))) from None


LARGEST = 1e12
"""Largest number of any setting: also its cube is a number in single precision, with which is computed."""


@dataclass(frozen=True)
class Range:
    """Allowed values of a number; infinite and undefined ones never are, nor any beyond `LARGEST`."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False

    def __contains__(self, value: float) -> bool:
        """Whether the value is inside."""
        above = value > self.low if self.open_low else value >= self.low
        return abs(value) <= LARGEST and above and value <= self.high

    def __str__(self) -> str:
        """The range in words."""
        low = "" if math.isinf(self.low) else f"{'above' if self.open_low else 'at least'} {self.low:.12g}"
        high = "" if math.isinf(self.high) else f"at most {self.high:.12g}"
        return " and ".join(part for part in (low, high) if part)


def whole_number(name: str, value: Any, low: int, high: int) -> int:
    """A whole number within limits, of Python or NumPy.

    Raises:
        InputError: it is something else.
    """
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or not low <= number <= high:
        raise InputError(f"{name} must be a whole number from {low} to {high}, got {reprlib.repr(value)}.")
    return number


@dataclass(frozen=True)
class Length:
    """Allowed lengths of a list."""

    most: int

    def __contains__(self, value: Any) -> bool:
        """Whether the list is not too long."""
        return len(value) <= self.most

    def __str__(self) -> str:
        """The length in words."""
        return f"a list of at most {self.most}"


@dataclass(frozen=True)
class InProportion:
    """A number that follows from an arm's workspace where it is left out.

    Attributes:
        usual: its value on the tutorial's arm, whose workspace has the size 1.
        inverse: it is the smaller the larger the workspace.
        from_floor: it is a height above the workspace's floor.
    """

    usual: float
    inverse: bool = False
    from_floor: bool = False

    def on_arm(self, scale: float, floor: float) -> float:
        """Its value on an arm whose workspace has a size and a floor [m]."""
        return self.usual / scale if self.inverse else floor * self.from_floor + self.usual * scale


BY_ARM: Any = None
"""Default of settings in proportion to the arm's workspace, until they are settled on an arm."""

UNIONS = (typing.Union, types.UnionType)
"""Origins of annotations with several kinds of values."""

Count = Annotated[int, Range(1, 2**31 - 1)]
Steps = Annotated[int, Range(1, 10**12 - 1)]
"""Environment steps of a whole training; a checkpoint's name has twelve digits."""
NonNegativeInt = Annotated[int, Range(0, 2**31 - 1)]
Positive = Annotated[float, Range(0.0, open_low=True)]
NonNegative = Annotated[float, Range(0.0)]
Fraction = Annotated[float, Range(0.0, 1.0)]
Coordinate = Annotated[float, Range(-1000.0, 1000.0)]
"""Along an axis [m]."""
Point = tuple[Coordinate, Coordinate, Coordinate]
LAST_SEED = 2**32 - 1
"""Largest seed of an evaluation or an environment; the first ones come after it."""
Seed = Annotated[int, Range(0, 2**31 - 1)]


class Checked:
    """Checks every field of a dataclass against its annotation when it is built."""

    def __post_init__(self) -> None:
        for name, hint in hints(type(self)).items():
            given: Any = getattr(self, name)
            value = given.tolist() if hasattr(given, "tolist") else given  # a number or an array of NumPy or JAX
            value = tuple(value) if isinstance(value, list) else value
            if value is not given:
                object.__setattr__(self, name, value)
            _check(name, value, hint)


@functools.cache
def hints(cls: type) -> dict[str, Any]:
    """Annotations of a dataclass's fields, by name."""
    annotations = typing.get_type_hints(cls, include_extras=True)
    return {entry.name: annotations[entry.name] for entry in dataclasses.fields(cls)}


def _check(name: str, value: Any, hint: Any) -> None:
    base, limits = (hint.__origin__, hint.__metadata__) if hasattr(hint, "__metadata__") else (hint, ())
    if typing.get_origin(base) in UNIONS:
        kinds = [kind for kind in typing.get_args(base) if kind is not type(None)]
        if len(kinds) == 1:
            if value is not None:
                _check(name, value, kinds[0])
            return
    if value is BY_ARM and any(isinstance(limit, InProportion) for limit in limits):
        return
    _check_type(name, value, base)
    for limit in limits:
        if isinstance(limit, Range | Length) and value not in limit:
            raise InputError(f"{name} must be {_passed(limit, value)}, got {reprlib.repr(value)}.")
    if isinstance(value, tuple):
        for item in value:
            _check(f"each entry of {name}", item, typing.get_args(base)[0])


def _check_type(name: str, value: Any, base: Any) -> None:
    try:
        if isinstance(value, bool) and base is not bool:
            raise TypeCheckError("a truth value is no number")
        check_type(value, base)
    except TypeCheckError:
        raise InputError(f"{name} must be {_type_name(base)}, got {reprlib.repr(value)}.") from None


def _passed(limit: Range | Length, value: Any) -> Range | Length:
    """The limit, with that of every number where it is this one that a value passes."""
    if isinstance(limit, Length) or not abs(value) > LARGEST:
        return limit
    return dataclasses.replace(limit, high=min(limit.high, LARGEST))


def _type_name(hint: Any) -> str:
    names = {int: "a whole number", float: "a number", str: "a name", bool: "true or false"}
    kind, parts = typing.get_origin(hint), typing.get_args(hint)
    if kind in UNIONS:
        return " or ".join(_type_name(arg) for arg in parts if arg is not type(None))
    if kind is tuple:
        return f"a list{'' if parts[-1] is Ellipsis else f' of {len(parts)}'}, each entry {_type_name(parts[0])}"
    return _type_name(parts[0]) if hasattr(hint, "__metadata__") else names.get(hint, str(hint))
