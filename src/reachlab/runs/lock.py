"""One trainer for a run directory: a lock that the kernel gives back when its holder dies."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from reachlab.runs.files import MODE, open_plain
from reachlab.settings.validation import InputError

NAME = ".lock"
"""File in the run directory that is locked; it holds the process of whoever locked it last."""

DIGITS = 32
"""At most so much of the file is read [bytes]."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a run directory for this process.

    Raises:
        InputError: another process holds it, or it cannot be locked.
    """
    try:
        descriptor = open_plain(folder / NAME, os.O_RDWR | os.O_CREAT)
    except (OSError, InputError) as error:
        raise InputError(f"run directory '{folder}' cannot be locked: {_reason(error)}.") from None
    try:
        _acquire(descriptor, folder)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def in_turn(folder: Path) -> Iterator[None]:
    """Hold a folder for this thread, after whoever holds it now.

    Raises:
        OSError: it cannot be locked.
    """
    descriptor = os.open(folder / NAME, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, MODE)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def refuse_if_held(folder: Path) -> None:
    """Refuse a run directory that a process trains; nothing is changed.

    Raises:
        InputError: one does.
    """
    try:
        descriptor = open_plain(folder / NAME, os.O_RDWR)
    except (OSError, InputError):
        return
    try:
        _flock(descriptor, folder)
    finally:
        os.close(descriptor)


def _acquire(descriptor: int, folder: Path) -> None:
    _flock(descriptor, folder)
    try:
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
    except OSError:
        return  # a full disk: the lock holds all the same, only nameless


def _flock(descriptor: int, folder: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.pread(descriptor, DIGITS, 0).decode("ascii", "replace").strip()
        who = f"process {holder}" if holder.isdigit() else "another process"
        raise InputError(f"run directory '{folder}' is being trained by {who}: wait for it, or stop it.") from None
    except OSError as error:
        raise InputError(f"run directory '{folder}' cannot be locked: {_reason(error)}.") from None


def _reason(error: Exception) -> str:
    return (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
