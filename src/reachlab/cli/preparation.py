"""Preparation of a verb that uses JAX and MuJoCo."""

from __future__ import annotations

import os
from importlib import import_module

from reachlab.settings.validation import InputError


def prepare() -> None:
    """Compute on the CPU unless `JAX_PLATFORMS` says where, and use the compilation cache.

    Engines step on the CPU, and a GPU beside them is waited for after each of their steps. What it is good for is
    arithmetic in thousands, see docs/scale.md.

    Raises:
        InputError: MuJoCo does not load, as with a `MUJOCO_GL` that it does not know or cannot load.
    """
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    from reachlab.jax_setup import use_compilation_cache

    use_compilation_cache()
    try:
        import_module("mujoco")
    except Exception as error:
        if "MUJOCO_GL" not in os.environ:
            raise
        wanted = os.environ["MUJOCO_GL"]
        raise InputError(f"MuJoCo does not load with MUJOCO_GL={wanted!r} ({error}): unset it, or set egl.") from None
