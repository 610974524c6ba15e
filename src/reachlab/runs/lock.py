"""One trainer for a run directory, one writer at a time for its reports: the kernel frees what a dead process held."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from filelock import FileLock, Timeout

from reachlab.runs.files import read_bytes
from reachlab.settings.validation import InputError

NAME = ".lock"
"""File that is locked; in a run directory it holds the number of the process that locked it last."""

DIGITS = 32
"""Largest such file that is read [bytes]."""

POLL_S = 0.01
"""Time between two attempts to lock a folder that another holds [s]."""


def locked(folder: Path) -> AbstractContextManager[object]:
    """Hold a run directory for this process, until the context ends.

    Raises:
        InputError: another process holds it, or it cannot be locked.
    """
    return _acquire(folder, _write_holder)


def in_turn(folder: Path) -> AbstractContextManager[object]:
    """Hold a folder for this thread while the context is open, after whoever holds it now.

    Raises:
        OSError: it cannot be locked.
    """
    return FileLock(folder / NAME, poll_interval=POLL_S, preserve_lock_file=True)


def refuse_if_held(folder: Path) -> None:
    """Refuse a run directory that a process trains; nothing is changed.

    Raises:
        InputError: one does.
    """
    if (folder / NAME).is_file():
        with _acquire(folder):
            pass


def _acquire(folder: Path, on_acquired: Callable[[int], None] | None = None) -> AbstractContextManager[object]:
    """The lock of a run directory, held until the context ends."""
    try:
        return FileLock(folder / NAME, blocking=False, preserve_lock_file=True, on_acquired=on_acquired).acquire()
    except Timeout:
        why = f"is being trained by {_holder(folder / NAME)}: wait for it, or stop it"
    except OSError as error:
        why = f"cannot be locked: {error.strerror}"
    raise InputError(f"run directory '{folder}' {why}.")


def _write_holder(descriptor: int) -> None:
    os.ftruncate(descriptor, 0)  # fails if it is not a plain file
    with contextlib.suppress(OSError):  # a full disk: the lock holds all the same, without a name
        os.write(descriptor, f"{os.getpid()}\n".encode())


def _holder(file: Path) -> str:
    """The process that a lock file names."""
    with contextlib.suppress(OSError, InputError):
        holder = read_bytes(file, DIGITS).decode("ascii", "replace").strip()
        if holder.isdigit():
            return f"process {holder}"
    return "another process"
