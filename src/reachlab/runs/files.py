"""Files that are complete or absent, and reading that no file can turn into a hang or a flood."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shutil
import stat
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NoReturn

from safetensors import SafetensorError

from reachlab.settings.validation import InputError

JSON_LIMIT = 2**20
"""Largest JSON file that is read [bytes]; those of a run are a few thousand."""

MODE = 0o666
"""Permissions of a new file, before the user's mask."""

CAREFULLY = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Flags with which a file is opened, of those that the system has: follow no link, wait for no pipe, keep bytes."""

UNREADABLE = (OSError, SafetensorError, LookupError, TypeError, ValueError, AttributeError, RecursionError)
"""What reading a damaged file raises; `InputError` is one of them."""


def write_json(path: Path, data: object) -> None:
    """Write JSON so that the file is the old one or the new one, never half of it.

    Raises:
        OSError: it cannot be written; the old file is as it was.
    """
    write_whole(path, (json.dumps(data, indent=2) + "\n").encode())


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that it is the old one or the new one, never half of it, however many write it at once.

    Raises:
        OSError: it cannot be written; the old file is as it was.
    """
    with whole(path) as temporary:
        write_synced(temporary, data)
    sync(path.parent)


@contextlib.contextmanager
def whole(path: Path, ending: str = "") -> Iterator[Path]:
    """A file beside another, there and empty, that takes its place when all is written; its name has an `ending`.

    Raises:
        OSError: it cannot be written; the old file is as it was.
    """
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp{ending}")
    try:
        temporary.touch(MODE)
        yield temporary
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise


@contextlib.contextmanager
def written(what: str, path: Path) -> Iterator[Path]:
    """The same for what is named by its ending: the picture, the video.

    Raises:
        InputError: it cannot be written.
    """
    try:
        with whole(path, path.suffix) as part:
            yield part
    except OSError as error:
        raise InputError(f"{what} cannot be written to '{path}': {error.strerror or error}.") from None


def check_place(what: str, path: Path, endings: Collection[str]) -> None:
    """Make sure, before it is made, that what is named by its ending can be written.

    Raises:
        InputError: it has none of these endings, or its folder is not there.
    """
    if path.suffix.lower() not in endings:
        raise InputError(f"{what} cannot be written to '{path}': name a file that ends in {' or '.join(endings)}.")
    if not path.parent.is_dir():
        raise InputError(f"{what} cannot be written to '{path}': there is no folder '{path.parent}'.")


def write_synced(path: Path, data: bytes) -> None:
    """Write a file and wait until it is on the disk.

    Raises:
        OSError: it cannot be written.
    """
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | CAREFULLY, MODE)
    try:
        left = memoryview(data)
        while left:  # a single `write` may stop short
            left = left[os.write(descriptor, left) :]
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync(folder: Path) -> None:
    """Wait until a folder's entries are on the disk."""
    if os.name == "nt":  # a folder cannot be opened there
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove(path: Path) -> None:
    """Remove a file, or a folder and what is in it, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def read_json(path: Path) -> Any:
    """What a JSON file holds.

    Raises:
        InputError: it is missing, too large, or not JSON.
    """
    try:
        return json.loads(read_bytes(path, JSON_LIMIT), parse_constant=_refuse, object_pairs_hook=_named_once)
    except FileNotFoundError:
        raise InputError(
            f"'{path}' is missing: '{path.parent}' is no complete run; name a folder that `reachlab train` wrote."
        ) from None
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror or error}.") from None
    except (ValueError, RecursionError) as error:
        why = f" ({error})" if isinstance(error, InputError) else ""
        raise InputError(f"'{path}' is not JSON that can be read{why}.") from None


def _named_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    named = dict(pairs)
    if len(named) < len(pairs):
        twice = next(name for name in named if [one for one, _ in pairs].count(name) > 1)
        raise InputError(f"it holds {twice!r} twice")
    return named


def _refuse(constant: str) -> NoReturn:
    raise InputError(f"it holds {constant}")


def read_bytes(path: Path, limit: int) -> bytes:
    """A file's content.

    Raises:
        InputError: it is larger than `limit` [bytes], or not a plain file.
        OSError: it cannot be read.
    """
    with os.fdopen(open_plain(path, os.O_RDONLY), "rb") as file:
        if (size := os.fstat(file.fileno()).st_size) > limit:
            raise InputError(f"it has {size:,} bytes, at most {limit:,} are read")
        return file.read(limit)


def open_plain(path: Path, flags: int) -> int:
    """Descriptor of a plain file; links, pipes, devices and directories are refused without waiting for them.

    Raises:
        InputError: it is not a plain file.
        OSError: it cannot be opened.
    """
    if path.is_symlink():
        raise InputError("it is a link, not a plain file")
    # A link that is put there in between is not followed either.
    descriptor = os.open(path, flags | CAREFULLY, MODE)
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return descriptor
    os.close(descriptor)
    raise InputError("it is not a plain file")
