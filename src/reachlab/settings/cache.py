"""What is derived of an arm once, kept in the user's cache."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from reachlab.settings.reading import cache_folder, write_cached

Record = TypeVar("Record")

SHIPPED = Path(__file__).parents[1] / "robots" / "assets" / "derived.json"
"""What was derived of the catalogue's arms: with it their first environment is made seconds earlier."""


@functools.cache
def package() -> tuple[tuple[str, int, int], ...]:
    """Sources and records of this package, with their sizes and times of change: what a change of it changes."""
    files = sorted(path for path in Path(__file__).parents[1].rglob("*") if path.suffix in (".py", ".json"))
    return tuple((str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in files)


def kept(
    folder: str,
    asked: tuple[object, ...],
    find: Callable[[], Record],
    make: Callable[..., Record],
    fields: Callable[[Record], Mapping[str, Any]],
) -> Record:
    """What `find` gives for what is `asked`; from a folder of the cache if it was found before.

    `make` makes such a record of its `fields`, which are mappings, tuples, texts and numbers. What cannot be kept is
    found again the next time. That of the catalogue's arms comes with the package.
    """
    name = hashlib.sha256(repr(asked).encode()).hexdigest()[:32]
    file = cache_folder() / folder / f"{name}.json"
    with contextlib.suppress(OSError, ValueError, TypeError, AttributeError):
        known = _shipped().get(f"{folder}/{name}") or json.loads(file.read_text())
        return make(**{name: _tuples(value) for name, value in known.items()})
    found = find()
    write_cached(file, json.dumps(dict(fields(found))).encode())
    return found


@functools.cache
def _shipped() -> dict[str, dict[str, Any]]:
    """Fields by folder and name, as `benchmarks.derived` writes them; nothing where they are not to be had."""
    try:
        return json.loads(SHIPPED.read_text())
    except (OSError, ValueError):
        return {}


def _tuples(value: object) -> object:
    """What was kept, its lists tuples again."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
