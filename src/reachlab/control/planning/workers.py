"""Processes beside this one that plan: Python's own work uses one core, whatever a computer has."""

from __future__ import annotations

import itertools
import os
import pickle
import queue
import signal
import subprocess
import sys
import weakref
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

VARIABLE = "NPROC"
"""Number of cores to use, where it is set in the environment: JAX goes by it too."""

PATIENCE = 5.0
"""Time that a process has to end [s]."""


def cores() -> int:
    """Cores that this process may use."""
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(int(os.environ.get(VARIABLE) or here), here)


class Workers:
    """Computes a function of one argument after the other, of several at once where there are cores for it.

    The processes import what the function is made by, and not the program that runs here. They end with this one.
    """

    def __init__(self, make: Callable[..., Callable[[Any], Any]], *given: Any, most: int) -> None:
        """The function that `make` makes of what is given, here and in each process; all of it can be pickled.

        There are `most` processes at most; with one it is computed here.
        """
        self._function, self._free = make(*given), queue.SimpleQueue[subprocess.Popen[bytes]]()
        self.count = min(cores(), most)
        processes = [_begun(make, given) for _ in range(self.count)] if self.count > 1 else []
        for process in processes:
            self._free.put(process)
        self.close = weakref.finalize(self, _end, processes)

    def map(self, arguments: Iterable[Any]) -> Generator[Any]:
        """The function of each argument, in their order; they may be without end."""
        if self.count <= 1:
            yield from map(self._function, arguments)
            return
        with ThreadPoolExecutor(self.count) as threads:
            rest = iter(arguments)
            begun = deque(threads.submit(self._ask, one) for one in itertools.islice(rest, self.count))
            while begun:
                result = begun.popleft().result()
                begun.extend(threads.submit(self._ask, one) for one in itertools.islice(rest, 1))
                yield result

    def _ask(self, argument: Any) -> Any:
        process = self._free.get()
        try:
            _send(process.stdin, argument)
            result = _receive(process.stdout)
        except (OSError, EOFError):
            raise RuntimeError("a process that planned has ended: is there memory enough?") from None
        finally:
            self._free.put(process)
        if isinstance(result, Exception):
            raise result
        return result


def _begun(make: Callable[..., Any], given: Sequence[Any]) -> subprocess.Popen[bytes]:
    beside = {**os.environ, VARIABLE: "1", "JAX_PLATFORMS": "cpu"}
    words, pipe = [sys.executable, "-m", __name__], subprocess.PIPE
    process = subprocess.Popen(words, stdin=pipe, stdout=pipe, env=beside)  # noqa: S603
    _send(process.stdin, sys.path)
    _send(process.stdin, (make, given))
    return process


def _end(processes: Sequence[subprocess.Popen[bytes]]) -> None:
    for process in processes:
        try:
            process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def _send(pipe: Any, what: Any) -> None:
    pickle.dump(what, pipe)
    pipe.flush()


def _receive(pipe: Any) -> Any:
    return pickle.load(pipe)  # noqa: S301 (of a process of our own)


def _serve() -> None:
    """Answer until there are no more questions. What is printed goes to where errors go."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who began this one ends it
    questions, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    try:
        sys.path[:] = _receive(questions)
        make, given = _receive(questions)
        function = make(*given)
        while True:
            argument = _receive(questions)
            try:
                _send(answers, function(argument))
            except Exception as error:  # it is raised where it was asked
                _send(answers, error)
    except EOFError:
        pass


if __name__ == "__main__":
    _serve()
