"""What functions that somebody added give: one that fails is told in a sentence."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from reachlab.settings.validation import InputError


def answer(who: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function of `who` gives of arguments.

    Raises:
        InputError: it fails.
    """
    try:
        return function(*arguments)
    except InputError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        line = traceback.extract_tb(error.__traceback__)[1:2]
        where = "".join(f" at {Path(one.filename).name}:{one.lineno}" for one in line)
        said = str(error).strip().partition("\n")[0].rstrip(".")
        raise InputError(f"{who} fails{where}: {said}.{_hint(error)}") from error


def _hint(error: Exception) -> str:
    if isinstance(error, AttributeError) and (fields := getattr(type(error.obj), "_fields", ())):
        name = type(error.obj).__name__.lower()
        return f" {'An' if name[0] in 'aeiou' else 'A'} {name} has {', '.join(fields)}."
    traced = (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError)
    asks = isinstance(error, traced) or "truth value" in str(error)
    return " Its numbers are arrays of all environments: use jnp.where in place of if, and jnp in place of np." * asks
