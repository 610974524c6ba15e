"""How JAX compiles here: barriers that hold on the CPU, and a compilation cache on disk."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from jax.stages import Wrapped

CPU_OPTIONS = {
    # Without this XLA's CPU compiler drops optimisation barriers before it fuses (see `lanes.once`).
    "xla_disable_hlo_passes": "cse_barrier_expander",
    # The kernels are simple loops: higher levels take a fifth longer to compile and run no faster.
    "xla_backend_optimization_level": 1,
}
"""Compiler options on the CPU."""


def jit(function: Callable[..., Any], *, donate: tuple[int, ...] = ()) -> Wrapped:
    """`jax.jit` with `CPU_OPTIONS` on the CPU; `donate` names arguments whose memory is reused.

    For the outermost function only: JAX refuses compiler options inside another trace.
    """
    options: dict[str, str | int] | None = CPU_OPTIONS if jax.default_backend() == "cpu" else None
    return jax.jit(function, donate_argnums=donate, compiler_options=options)


def use_compilation_cache() -> None:
    """Keep compiled programs in the user's cache folder, unless `JAX_COMPILATION_CACHE_DIR` says where."""
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(home / "reachlab" / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def dispatch_inline() -> None:
    """Run programs on the thread that calls them; without effect once JAX has started.

    Most programs here are short: handing one to a thread that has to wake up first takes longer than the program
    (one lane of PyBullet: 175 µs a step, and 100 without). `JAX_CPU_ENABLE_ASYNC_DISPATCH` overrides it.
    """
    if "JAX_CPU_ENABLE_ASYNC_DISPATCH" not in os.environ:
        jax.config.update("jax_cpu_enable_async_dispatch", False)
