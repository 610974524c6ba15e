"""Preparation of a verb that uses JAX and MuJoCo."""

from __future__ import annotations

import gc
import os
from importlib import import_module

from reachlab.learn.interrupts import spared
from reachlab.settings.validation import InputError

COLLECTED_AFTER = 50_000
"""New objects after which Python looks for what nobody holds: after 700, as by default, it takes a twentieth of a warm
training, since JAX makes many that stay."""


def prepare() -> None:
    """Compute on the CPU unless `JAX_PLATFORMS` says where, and use the compilation cache.

    Engines step on the CPU, and a GPU beside them is waited for after each of their steps. What it is good for is
    arithmetic in thousands, see docs/scale.md.

    Raises:
        InputError: MuJoCo does not load, as with a `MUJOCO_GL` that it does not know or cannot load.
    """
    gc.set_threshold(COLLECTED_AFTER)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    with spared():
        from reachlab.jax_setup import use_compilation_cache

    use_compilation_cache()
    try:
        with spared():
            import_module("mujoco")
    except Exception as error:
        if "MUJOCO_GL" not in os.environ:
            raise
        wanted = os.environ["MUJOCO_GL"]
        raise InputError(f"MuJoCo does not load with MUJOCO_GL={wanted!r} ({error}): unset it, or set egl.") from None
