"""Files that are complete or absent, and reading that no file can turn into a hang or a flood."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import stat
from pathlib import Path
from typing import Any, NoReturn

from reachlab.settings.validation import InputError

JSON_LIMIT = 2**20
"""Largest JSON file that is read [bytes]; those of a run are a few thousand."""

MODE = 0o666
"""Permissions of a new file, before the user's mask."""


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
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        write_synced(temporary, data)
        os.rename(temporary, path)  # noqa: PTH104 (every step of a save is a call of `os`, which tests interrupt)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)  # noqa: PTH108
        raise
    sync(path.parent)


def read_json(path: Path) -> Any:
    """What a JSON file holds.

    Raises:
        InputError: there is none, it is too large, or no JSON.
    """
    try:
        return json.loads(read_bytes(path, JSON_LIMIT), parse_constant=_refuse)
    except FileNotFoundError:
        raise InputError(f"'{path}' is missing: '{path.parent}' is not a complete run.") from None
    except (OSError, ValueError, RecursionError) as error:
        why = f" ({error})" if isinstance(error, InputError) else ""
        raise InputError(f"'{path}' is not JSON that can be read{why}.") from None


def _refuse(constant: str) -> NoReturn:
    raise InputError(f"it holds {constant}")


def write_synced(path: Path, data: bytes) -> None:
    """Write a file and wait until it is on the disk."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, MODE)
    try:
        write_all(descriptor, data)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_all(descriptor: int, data: bytes) -> None:
    """Write every byte: a single `write` may stop short."""
    left = memoryview(data)
    while left:
        left = left[os.write(descriptor, left) :]


def read_bytes(path: Path, limit: int) -> bytes:
    """A file's content.

    Raises:
        InputError: it is larger than `limit` [bytes], or no plain file.
        OSError: it cannot be read.
    """
    descriptor = open_plain(path, os.O_RDONLY)
    with os.fdopen(descriptor, "rb") as file:
        if (size := os.fstat(descriptor).st_size) > limit:
            raise InputError(f"it has {size:,} bytes, at most {limit:,} are read")
        return file.read(limit)


def open_plain(path: Path, flags: int) -> int:
    """Descriptor of a plain file; links, pipes, devices and directories are refused without waiting for them.

    Raises:
        InputError: it is none.
        OSError: it cannot be opened.
    """
    try:
        descriptor = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, MODE)
    except OSError:
        if path.is_symlink():
            raise InputError("it is a link, not a plain file") from None
        raise
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return descriptor
    os.close(descriptor)
    raise InputError("it is not a plain file")


def sync(folder: Path) -> None:
    """Wait until a folder's entries are on the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove(folder: Path) -> None:
    """Remove a folder of plain files, if it is there."""
    if folder.is_symlink() or folder.is_file():
        os.unlink(folder)  # noqa: PTH108
    elif folder.is_dir():
        for entry in folder.iterdir():
            remove(entry)
        os.rmdir(folder)  # noqa: PTH106
