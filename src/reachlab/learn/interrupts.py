"""Signals that ask a command to end: training saves and leaves, and at the second one it leaves at once."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from types import FrameType
from typing import Any, Self

HANGUP = getattr(signal, "SIGHUP", None)
"""Signal of a terminal that was closed; None where the system has none."""

ASKING = (signal.SIGINT, signal.SIGTERM, *([HANGUP] if HANGUP else []))
"""Signals that ask a process to end."""

PATIENCE = 2.0
"""Time in which a process that has nothing to save ends after a signal, whatever keeps it from hearing of it [s]."""

EXIT_BASE = 128
"""A process that a signal ended has this exit status and the signal's number."""


class Interrupted(KeyboardInterrupt):
    """A signal asked the process to end.

    Attributes:
        status: the exit status that says so.
    """

    def __init__(self, number: int, message: str = "interrupted.") -> None:
        """Interruption by the signal of that number."""
        super().__init__(message)
        self.status = EXIT_BASE + number


asked: list[int] = []
"""Signals that have raised `Interrupted`; a library that is being imported may turn that into an error of its own."""

_lost_counts: list[bool] = []
"""Holds something in a process that is one command's own: there what a signal raised, and was lost, is raised again."""

_spared: list[bool] = []
"""Holds something while a library is imported."""

_said: list[bool] = []
"""Holds something once a command has said that it was interrupted: then it only has to end."""

_entered: list[Interrupts] = []
"""Those that are entered, and those that had something to save: what follows them, as closing a log, is spared too."""


class Interrupts:
    """While it is entered the first signal is only noted, in `received`, and the second ends the process at once.

    A closed terminal may send SIGHUP twice, by the shell and by the system, so that one ends nothing at once. Outside
    of the main thread, where Python sets no handlers, nothing is noted.

    Attributes:
        received: the signal that came.
        at_once: the first signal raises `Interrupted`, as nothing would be lost.
    """

    def __init__(self) -> None:
        """Nothing noted yet."""
        self.received: int | None = None
        self.at_once = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        """Begin to note signals.

        Raises:
            Interrupted: one came, and what it raised was lost in a callback of a library.
        """
        if _lost_counts and asked:
            raise Interrupted(asked[0])
        self._before = {number: signal.signal(number, self._note) for number in _heard()}
        _entered.append(self)
        return self

    def __exit__(self, *raised: object) -> None:
        """Put the handlers back that were there; a terminal that was closed is heard once."""
        if self.at_once:
            _entered.remove(self)
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_IGN if number == HANGUP == self.received else handler)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if self.received is None:
            self.received = number
            if self.at_once:
                raise Interrupted(number)
        elif number != HANGUP:
            os._exit(EXIT_BASE + number)


def raise_on_termination() -> None:
    """Let SIGTERM and SIGHUP raise `Interrupted` from here on, as Ctrl-C raises `KeyboardInterrupt`."""
    for number in _heard():
        if number != signal.SIGINT:
            signal.signal(number, _raise)


def _raise(number: int, _frame: FrameType | None) -> None:
    asked.append(number)
    if number == HANGUP:
        signal.signal(number, signal.SIG_IGN)  # the second one must not interrupt what is being put away
    if not _spared:
        raise Interrupted(number)


def end_at_once() -> None:
    """Let the system end this process from here on, without a word: what it had to do is done."""
    for number in _heard():
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


def hear() -> None:
    """What was raised has come to where it is said."""
    asked.clear()
    _said.append(True)


@contextlib.contextmanager
def spared() -> Iterator[None]:
    """While libraries are imported a signal is only noted, and raises after that: half imported they may crash."""
    before = len(asked)
    _spared.append(True)
    try:
        yield
    finally:
        _spared.clear()
    if noted := asked[before:]:
        raise Interrupted(noted[0])


def end_if_deaf() -> None:
    """Let a signal end this process after `PATIENCE`, or where `Interrupts` are entered, but for what they save.

    Python runs no handler while a program compiles, which takes seconds, and what a handler raises is lost where it
    runs inside a callback. A thread hears of signals at once (`signal.set_wakeup_fd`).
    """
    if threading.current_thread() is threading.main_thread():
        _lost_counts.append(True)
        if signal.getsignal(signal.SIGINT) == signal.default_int_handler:  # in the background it may be ignored
            signal.signal(signal.SIGINT, _raise)
        hearing, told = socket.socketpair()
        told.setblocking(False)
        signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=_end_later, args=(hearing, told), daemon=True).start()


def _end_later(hearing: socket.socket, _told: socket.socket) -> None:  # which is held open
    while number := hearing.recv(1)[0]:
        if number in ASKING:
            time.sleep(PATIENCE)
            if all(one.at_once for one in _entered):
                if not _said:
                    os.write(2, b"reachlab: interrupted.\n")
                os._exit(EXIT_BASE + number)


def _heard() -> list[int]:
    """Signals that ask for an end here: none outside of the main thread, and no SIGHUP below `nohup`."""
    if threading.current_thread() is not threading.main_thread():
        return []
    return [number for number in ASKING if number != HANGUP or signal.getsignal(number) != signal.SIG_IGN]
