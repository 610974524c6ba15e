"""Reading of files that a user names: none can turn it into a hang or a flood. And the user's own folder."""

from __future__ import annotations

import contextlib
import os
import stat
from pathlib import Path

MOST_TEXT = 2**20
"""Largest file of settings that is read [bytes]."""

MOST_MODEL = 2**30
"""Largest file of a policy that is read [bytes]."""


def cache_folder() -> Path:
    """The user's folder for what can be computed again; a relative `XDG_CACHE_HOME` is none, as its rules say."""
    chosen = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (chosen if chosen.is_absolute() else Path.home() / ".cache") / "reachlab"


def write_cached(file: Path, content: bytes) -> None:
    """Keep a file in the user's folder, as a whole; where that cannot be, as on a full disk, it is not kept."""
    part = file.with_suffix(f".{os.getpid()}.part")
    with contextlib.suppress(OSError), contextlib.ExitStack() as put_away:
        put_away.callback(part.unlink, missing_ok=True)
        file.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(content)
        part.replace(file)


def read_regular(file: Path, most: int, head: int | None = None) -> tuple[bytes, int]:
    """The bytes of a regular file (or its first `head`), and its size; never waits for a pipe or a device.

    Raises:
        OSError: it cannot be read, is not a regular file or is larger than `most` bytes.
    """
    handle = os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(handle, "rb") as opened:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise OSError("not a regular file")
        if status.st_size > most:
            raise OSError(f"larger than {most / 2**20:.0f} MB")
        return opened.read(most if head is None else head), status.st_size
