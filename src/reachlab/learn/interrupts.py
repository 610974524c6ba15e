"""Signals that ask training to end: it saves and leaves, and at the second one it leaves at once."""

from __future__ import annotations

import os
import signal
import threading
from types import FrameType, TracebackType
from typing import Any, Self

ASKING = (signal.SIGINT, signal.SIGTERM)
"""Signals that ask a process to end."""

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


class Interrupts:
    """While it is entered the first signal is only noted, in `received`, and the second ends the process at once.

    Outside of the main thread, where Python sets no handlers, it notes nothing.
    """

    def __init__(self) -> None:
        """Nothing noted yet."""
        self.received: int | None = None
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        """Begin to note signals."""
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._note) for number in ASKING}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Put the handlers back that were there."""
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        del frame
        if self.received is not None:
            os._exit(EXIT_BASE + number)
        self.received = number


def raise_on_termination() -> None:
    """Let SIGTERM raise `Interrupted` from here on, as Ctrl-C raises `KeyboardInterrupt`."""

    def end(number: int, frame: FrameType | None) -> None:
        del frame
        raise Interrupted(number)

    signal.signal(signal.SIGTERM, end)
