"""How many threads XLA computes with on the CPU: results repeat bit for bit only with the same number."""

from __future__ import annotations

import functools
import os
from pathlib import Path

from reachlab.checks import InputError

VARIABLE = "NPROC"
"""XLA reads the number from here when JAX starts its backend; otherwise it takes the cores that it may use.

On fewer cores than threads the results stay the same: the work is divided by this number and by nothing else.
"""

WORKER = "tf_XLAEigen"
"""Name of XLA's compute threads, one for each."""


def set_threads(count: int) -> None:
    """Make JAX compute with `count` threads.

    Raises:
        InputError: JAX runs already, with another number.
    """
    if _started():
        if (running := threads()) != count:
            raise InputError(
                f"this run needs JAX to compute with {count} thread{'s'[: count > 1]}, and it runs already with"
                f" {running}: set {VARIABLE}={count} in the environment before Python starts."
            )
    elif (said := os.environ.get(VARIABLE, str(count))) != str(count):
        raise InputError(
            f"this run needs JAX to compute with {count} thread{'s'[: count > 1]}, and the environment says"
            f" {VARIABLE}={said}: leave {VARIABLE} out or set it to {count}."
        )
    else:
        os.environ[VARIABLE] = str(count)


def threads() -> int:
    """Threads that JAX computes with; JAX is started if it has not been."""
    import jax

    jax.devices()
    try:
        names = [(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()]
    except OSError:
        names = []  # not Linux
    return names.count(WORKER) or int(os.environ.get(VARIABLE) or os.cpu_count() or 1)


@functools.cache
def first_process() -> int:
    """Number of the process in which this was first asked for; forks of it are told the same."""
    return os.getpid()


def refuse_fork() -> None:
    """Refuse to compute in a fork of the process in which JAX was started: it would wait for ever.

    A fork takes over JAX's state, but not the threads that do its work.

    Raises:
        InputError: this is such a process.
    """
    if first_process() != os.getpid():
        raise InputError(
            "JAX cannot compute in this process, a fork of one that uses it: start it with the context 'spawn' or"
            " 'forkserver' (in gymnasium.make_vec: vector_kwargs={'context': 'spawn'}), or let one process step all"
            " environments with vectorization_mode='vector_entry_point', which is faster."
        )


def _started() -> bool:
    # JAX has no public question for it; asked of what is imported only, so that asking does not start it.
    import sys

    bridge = sys.modules.get("jax._src.xla_bridge")
    return bridge is not None and bridge.backends_are_initialized()
