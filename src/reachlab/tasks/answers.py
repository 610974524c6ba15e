"""What functions that somebody added give: one that fails is told in a sentence."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from reachlab.settings.validation import InputError

KINDS = {"b": "bool", "i": "int", "u": "int", "f": "float"}
"""What arrays are made of, by the letter of NumPy's `dtype.kind`."""


def answer(who: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function of `who` gives of arguments.

    Raises:
        InputError: it fails.
    """
    try:
        return function(*arguments)
    except InputError:
        raise
    except Exception as error:
        line = traceback.extract_tb(error.__traceback__)[1:2]
        where = "".join(f" at {Path(one.filename).name}:{one.lineno}" for one in line)
        said = str(error).strip().partition("\n")[0].rstrip(".") or type(error).__name__
        raise InputError(f"{who} fails{where}: {said}.{_hint(error)}") from error


def _hint(error: Exception) -> str:
    if isinstance(error, AttributeError) and (fields := getattr(type(error.obj), "_fields", ())):
        name = type(error.obj).__name__.lower()
        return f" {'An' if name[0] in 'aeiou' else 'A'} {name} has {', '.join(fields)}."
    traced = (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError)
    asks = isinstance(error, traced) or "truth value" in str(error)
    return " Its numbers are arrays of all environments: use jnp.where in place of if, and jnp in place of np." * asks


def form(value: Any) -> str:
    """What a pytree is made of, as `Goal(position=float[3], …)`."""
    return str(jax.tree.map(_kind, value)).replace("'", "")


def _kind(value: Any) -> str:
    """What an array is made of and its shape, as `float[2, 3]`."""
    if isinstance(value, str):
        return type(value).__name__
    try:
        return KINDS[jnp.result_type(value).kind] + str([*jnp.shape(value)])
    except (KeyError, TypeError):
        return type(value).__name__
