"""How JAX is set up here: compiler options, the compilation cache on disk, and the threads it computes with."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
from jax.stages import Wrapped

from reachlab.settings.reading import cache_folder
from reachlab.settings.validation import InputError
from reachlab.traced import keep_in

CPU_OPTIONS: dict[str, str | int] = {
    # Without this XLA's CPU compiler drops optimisation barriers before it fuses (see `scalars.once`).
    "xla_disable_hlo_passes": "cse_barrier_expander",
    # The kernels are simple loops: higher levels take a fifth longer to compile and run no faster.
    "xla_backend_optimization_level": 1,
}
"""Compiler options on the CPU."""

BRIEF_OPTIONS = CPU_OPTIONS | ({"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {})
"""Those of programs that take longer to compile than to run: they compile in half the time. A training would be slower
by up to a third. JAX 0.11 does not know the option any more."""

ONCE_OPTIONS = BRIEF_OPTIONS | {"xla_backend_optimization_level": 0}
"""Those of programs that run once: they compile in half of that time again, and run for three times as long."""


SINGLE = 4
"""Size of a number in single precision [bytes]."""

CACHE = "jax_compilation_cache_dir"
"""JAX's setting of where compiled programs are kept."""


def jit(function: Callable[..., Any], *, brief: bool = False, once: bool = False) -> Wrapped:
    """`jax.jit` with `CPU_OPTIONS` on the CPU, or `BRIEF_OPTIONS`, or `ONCE_OPTIONS`.

    An option that `XLA_FLAGS` names is what it is there. For the outermost function only: JAX refuses compiler options
    inside another trace.
    """
    options = None
    if jax.default_backend() == "cpu":
        flags = os.environ.get("XLA_FLAGS", "")
        asked = ONCE_OPTIONS if once else BRIEF_OPTIONS if brief else CPU_OPTIONS
        options = {name: own for name, own in asked.items() if name not in flags}
    return jax.jit(function, compiler_options=options)


COMPILERS = ThreadPoolExecutor(2)
"""What compiles beside the main thread, in the order of asking: a program takes one core and a half."""


def beside(compile_it: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """What `compile_it` gives, made beside the main thread: who calls it waits until it is there."""
    compiled = COMPILERS.submit(compile_it)

    def run(*arguments: Any) -> Any:
        return compiled.result()(*arguments)

    return run


def use_compilation_cache() -> None:
    """Keep what is compiled and traced in the user's cache folder, unless `JAX_COMPILATION_CACHE_DIR` says where."""
    folder = jax.config.values[CACHE] or str(cache_folder() / "jax")
    jax.config.update(CACHE, folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
    _remove_empty(Path(folder))
    keep_in(Path(folder) / "traced")


def prepare() -> None:
    """Set JAX up for environments in this process.

    Raises:
        InputError: it computes with numbers of 64 bits.
    """
    if jax.dtypes.canonicalize_dtype(float).itemsize != SINGLE:
        raise InputError(
            "environments compute with numbers of 32 bits, and JAX is set to 64: leave jax_enable_x64 out, or make and"
            " use them within `with jax.enable_x64(False):`."
        )
    dispatch_inline()
    keep_compiled()


def keep_compiled() -> None:
    """Keep what is compiled, where nobody has said where and the user's cache folder can be written.

    And not what is traced: who calls from Python may have changed what a kept trace does not know of.
    """
    folder = cache_folder() / "jax"
    if jax.config.values[CACHE] is not None:
        return
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    if folder.is_dir() and os.access(folder, os.W_OK):
        jax.config.update(CACHE, str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
        _remove_empty(folder)


def _remove_empty(folder: Path) -> None:
    """Remove entries that a full disk left empty: JAX neither reads them nor writes them again."""
    with contextlib.suppress(OSError):
        for entry in os.scandir(folder):
            if entry.is_file() and not entry.stat().st_size:
                Path(entry).unlink()


def dispatch_inline() -> None:
    """Run programs on the thread that calls them; without effect once JAX has started.

    Most programs here are short: handing one to a thread that has to wake up first may take longer than the program.
    `JAX_CPU_ENABLE_ASYNC_DISPATCH` overrides it.
    """
    if "JAX_CPU_ENABLE_ASYNC_DISPATCH" not in os.environ:
        jax.config.update("jax_cpu_enable_async_dispatch", False)


# --- threads --------------------------------------------------------------------------------------

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
    jax.devices()
    try:
        names = [(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()]
    except OSError:
        names = []  # not Linux
    return names.count(WORKER) or int(os.environ.get(VARIABLE) or os.cpu_count() or 1)


FORKED: list[int] = []
"""Numbers of this process, and of those that it is a fork of, which were forked after JAX had been started."""


def _note_fork() -> None:
    if _started():
        FORKED.append(os.getpid())


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_note_fork)


def refuse_fork() -> None:
    """Refuse to compute in a fork of a process in which JAX was started: it would wait for ever.

    A fork takes over JAX's state, but not the threads that do its work.

    Raises:
        InputError: this is such a process.
    """
    if FORKED:
        raise InputError(
            "JAX cannot compute in this process, a fork of one that uses it: start it with the context 'spawn' or"
            " 'forkserver' (in gymnasium.make_vec: vector_kwargs={'context': 'spawn'}), or let one process step all"
            " environments with vectorization_mode='vector_entry_point', which is faster."
        )


def _started() -> bool:
    # JAX has no public question for it; asked of what is imported only, so that asking does not start it.
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bridge is not None and bridge.backends_are_initialized()
