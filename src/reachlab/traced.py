"""Traced functions kept in the compilation cache: a later process reads them instead of tracing them again."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import itertools
import json
import platform
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax import export

from reachlab.settings.cache import package
from reachlab.settings.extensions import extended
from reachlab.settings.reading import write_cached

_folder: list[Path] = []

DIGEST = 32
"""Length of the checksum in front of an entry [bytes]: what is damaged would crash XLA's reader."""

MOST = 200
"""Entries that are kept, of about 50 kB each; the oldest go."""

MOST_LEAVES = 10_000
"""More than any pytree here has."""


def keep_in(folder: Path | None) -> None:
    """Keep what is traced from here on in this folder, or nothing."""
    _folder[:] = [folder] if folder else []


def kept(function: Callable[..., Any], name: str, *settings: object, like: Any = None) -> Callable[..., Any]:
    """A function to be compiled, which is traced once and read from the cache in later processes.

    Its entry is found by its name, by `settings`, whose `repr` tells all that the function depends on beside its
    arguments, and by what every trace depends on. Where nothing is kept, or an extension was imported, whose functions
    may be any, it is the function itself. What is static in what it gives is the same in its arguments or in what it is
    `like`.
    """

    def read(*arguments: Any) -> Any:
        if not _folder or extended():
            return function(*arguments)
        leaves, tree = jax.tree.flatten(arguments)
        kinds = [(x.shape, x.dtype) for x in map(jax.typeof, leaves)]
        asked = repr((name, settings, str(tree), kinds, _surroundings()))
        if " at 0x" in asked:  # it names an object that another process does not have
            return function(*arguments)
        file = _folder[0] / f"{hashlib.sha256(asked.encode()).hexdigest()[:40]}.traced"
        found = _read(file, (arguments, like))
        if found is None:
            try:
                found = _trace(function, tree, leaves)
            except NotImplementedError:  # it calls a function of this process
                return function(*arguments)
            _write(file, *found)
        program, form = found
        return _built(form, [*leaves, *program.call(*leaves)], (arguments, like))

    read.__name__ = name.replace(" ", "_")
    return read


def _trace(function: Callable[..., Any], tree: Any, leaves: list[Any]) -> tuple[export.Exported, Any]:
    """A function of leaves, exported, and the form of what it gives: of those leaves and of what is computed."""
    forms = []

    def flat(*leaves: Any) -> list[Any]:
        given, structure = jax.tree.flatten(function(*jax.tree.unflatten(tree, leaves)))
        places, further = {id(leaf): place for place, leaf in enumerate(leaves)}, itertools.count(len(leaves))
        numbers = [places[id(leaf)] if id(leaf) in places else next(further) for leaf in given]
        forms.append(_form(jax.tree.unflatten(structure, numbers)))
        return [leaf for leaf in given if id(leaf) not in places]

    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in map(jax.typeof, leaves)]
    return export.export(jax.jit(flat))(*shapes), forms[-1]


# --- what a function gives -------------------------------------------------------------------------


def _form(value: Any) -> Any:
    """A pytree whose leaves are numbers as JSON.

    Raises:
        TypeError: a node that is no dataclass, tuple, list or dictionary.
    """
    if value is None or isinstance(value, int):
        return value
    if dataclasses.is_dataclass(value):
        parts = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return _named(value, {name: _form(part) for name, part in parts.items() if name not in _static(type(value))})
    if isinstance(value, tuple) and (fields := getattr(value, "_fields", None)) is not None:
        return _named(value, {name: _form(part) for name, part in zip(fields, value, strict=True)})
    if isinstance(value, dict):
        return {"dict": {name: _form(part) for name, part in value.items()}}
    if isinstance(value, list | tuple):
        return {type(value).__name__: [_form(part) for part in value]}
    raise TypeError(f"{type(value)} is no node of a pytree that can be kept")


def _named(value: Any, parts: dict[str, Any]) -> dict[str, Any]:
    return {"type": [type(value).__module__, type(value).__qualname__], "parts": parts}


def _built(form: Any, leaves: Sequence[Any], arguments: Any) -> Any:
    """The pytree of a form; what is static in it is that of a node of the same type among the arguments."""
    if form is None:
        return None
    if isinstance(form, int):
        return leaves[form]
    (kind, content), *more = form.items()
    if kind == "dict":
        return {name: _built(part, leaves, arguments) for name, part in content.items()}
    if kind in ("list", "tuple"):
        parts = [_built(part, leaves, arguments) for part in content]
        return parts if kind == "list" else tuple(parts)
    made = getattr(sys.modules[content[0]], content[1])
    parts = {name: _built(part, leaves, arguments) for name, part in more[0][1].items()}
    if static := _static(made):
        found = jax.tree.leaves(arguments, is_leaf=lambda value: isinstance(value, made))
        given = next(one for one in found if isinstance(one, made))
        parts |= {name: getattr(given, name) for name in static}
    return made(**parts)


def _static(kind: type) -> list[str]:
    fields = dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ()
    return [field.name for field in fields if field.metadata.get("static")]


# --- entries --------------------------------------------------------------------------------------


def _read(file: Path, arguments: Any) -> tuple[export.Exported, Any] | None:
    """An entry; None where there is none that is whole."""
    with contextlib.suppress(Exception):  # whatever is wrong with an entry, it is made anew
        content = file.read_bytes()
        if hashlib.sha256(content[DIGEST:]).digest() != content[:DIGEST]:
            return None
        head, _, program = content[DIGEST:].partition(b"\n")
        form = json.loads(head)
        _built(form, range(MOST_LEAVES), arguments)
        return export.deserialize(bytearray(program)), form
    return None


def _write(file: Path, program: export.Exported, form: Any) -> None:
    """Keep an entry, if the disk allows it."""
    content = json.dumps(form).encode() + b"\n" + bytes(program.serialize())
    write_cached(file, hashlib.sha256(content).digest() + content)
    with contextlib.suppress(OSError):
        for old in sorted(file.parent.glob("*.traced"), key=lambda entry: -entry.stat().st_mtime_ns)[MOST:]:
            old.unlink(missing_ok=True)


@functools.cache
def _surroundings() -> tuple[object, ...]:
    """All that every trace depends on: this package, the libraries, how JAX is set, and the machine."""
    options = sorted((name, repr(value)) for name, value in jax.config.values.items() if "cache" not in name)
    versions = jax.default_backend(), jax.__version__, version("optax"), np.__version__, sys.version, platform.machine()
    return *package(), *options, *versions


def digest(arrays: Any) -> str:
    """Digest of a pytree of arrays."""
    return hashlib.sha256(b"".join(np.asarray(x).tobytes() for x in jax.tree.leaves(arrays))).hexdigest()
