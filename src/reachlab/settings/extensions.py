"""Extensions: modules of users that enter tasks, robots, controllers and others into the tables."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import json
import sys
from collections.abc import Iterable
from importlib.machinery import ModuleSpec
from importlib.metadata import entry_points
from pathlib import Path

from reachlab.settings.reading import MOST_TEXT, cache_folder, read_regular, write_cached
from reachlab.settings.validation import InputError

GROUP = "reachlab.extensions"
"""Entry points of this name in installed packages are modules that are imported before a command reads its flags."""

IMPORTED: list[str] = []
"""Extensions that were imported by name or file, as new runs remember them."""

INSTALLED: list[str] = []
"""Extensions of installed packages that were imported."""


@functools.cache
def import_installed() -> None:
    """Import the extensions of installed packages.

    Raises:
        InputError: one cannot be imported.
    """
    for entry in entry_points(group=GROUP):
        try:
            entry.load()
            INSTALLED.append(entry.value)
        except (Exception, SystemExit) as error:
            raise InputError(f"extension {entry.value!r} cannot be imported: {_why(error)}.") from error


def extended() -> bool:
    """Whether an extension was imported."""
    return bool(IMPORTED or INSTALLED)


def import_extension(name: str) -> None:
    """Import a module by its name or file; runs that are made from now on remember it.

    Args:
        name: a module, as `mytask`, in this folder or installed, or a file, as `mytask.py`.

    Raises:
        InputError: it is not there, or cannot be imported.
    """
    spec = _found(name)
    _import(spec, name)
    _remember(spec)


def import_remembered(names: tuple[str, ...]) -> None:
    """Import the extensions that a run names; none that was never imported here by name, or has changed since.

    Raises:
        InputError: one is not there, is not known here or cannot be imported.
    """
    for name in names:
        if name in IMPORTED:
            continue
        spec = _found(name)
        if _hash(spec) not in _known():
            raise InputError(
                f"the run needs extension '{name}', which was not imported here before, or has changed since: it runs"
                f" when it is imported. If you trust it, name it with --import {name}."
            )
        _import(spec, name)


def import_of_runs(words: Iterable[str]) -> None:
    """Import the extensions of those words that are run directories: settings of their tasks are flags then.

    Raises:
        InputError: as `import_remembered`.
    """
    for word in words:
        names: list[str] = []
        # What is wrong with it is said where it is read as a run.
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError, RecursionError):
            names = json.loads(read_regular(Path(word) / "config.json", MOST_TEXT)[0])["imports"]
        import_remembered(tuple(names))


def _found(name: str) -> ModuleSpec:
    """Where an extension lies."""
    path, found = Path(name), None
    if path.suffix != ".py":
        _look_in(Path.cwd())  # as `python -m` does
        with contextlib.suppress(ImportError, ValueError):
            found = importlib.util.find_spec(name)
    elif path.is_file():
        _look_in(path.absolute().parent)  # as `python mytask.py` does
        found = importlib.util.spec_from_file_location(path.stem, path.absolute())
    if found is None or found.origin is None or not found.has_location:
        raise InputError(f"extension '{name}' is not there: name a module, or its file, with --import.")
    return found


def _look_in(folder: Path) -> None:
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def _import(spec: ModuleSpec, name: str) -> None:
    taken = vars(sys.modules.get(spec.name, object)).get("__file__", "nowhere" if spec.name in sys.modules else None)
    if taken and Path(taken).resolve() != Path(spec.origin or "").resolve():
        raise InputError(f"extension '{name}' is called as module {spec.name!r} is, which is in use: rename it.")
    if not taken:
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        try:
            if spec.loader:
                spec.loader.exec_module(module)
        except (Exception, SystemExit) as error:
            del sys.modules[spec.name]
            raise InputError(f"extension '{name}' cannot be imported: {_why(error)}.") from error
    path = str(Path(name).absolute()) if name.endswith(".py") else name
    if path not in IMPORTED:
        IMPORTED.append(path)


def _why(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}".rstrip(".")


# --- which are known here -------------------------------------------------------------------------


def _hash(spec: ModuleSpec) -> str:
    return hashlib.sha256(read_regular(Path(spec.origin or ""), MOST_TEXT)[0]).hexdigest()


def _file() -> Path:
    return cache_folder() / "extensions.json"


def _known() -> dict[str, str]:
    """Files by their hash."""
    try:
        return dict(json.loads(read_regular(_file(), MOST_TEXT)[0]))
    except (OSError, ValueError, TypeError):
        return {}


def _remember(spec: ModuleSpec) -> None:
    known = _known() | {_hash(spec): str(spec.origin)}
    write_cached(_file(), json.dumps(known).encode())  # where it is not kept it has to be named again the next time
