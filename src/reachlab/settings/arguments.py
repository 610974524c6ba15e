"""What callers from Python give to this package's functions: an argument of another type is refused in a sentence."""

from __future__ import annotations

import collections.abc
import functools
import os
import reprlib
import types
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from reachlab.settings.validation import InputError

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

MADE = {
    "RunConfig": "reachlab.configure('tutorial')",
    "DistilRunConfig": "reachlab.distillation(teacher, config)",
    "SweepConfig": "reachlab.SweepConfig(space={'learning_rate': [1e-3, 3e-3]})",
    "RecordConfig": "reachlab.RecordConfig(episodes=10)",
    "Env": "reachlab.Env(reachlab.configure('tutorial'), num_envs=4)",
    "Policy": "reachlab.load('panda/lift').policy",
    "Chain": "reachlab.load_robot('panda').chain",
}
"""How things of these types come about."""

AGENT = (
    " (of a policy 'trained', with the policy beside it; of a model of Stable-Baselines3"
    " lambda seen: model.predict(seen, deterministic=True)[0])"
)
"""What may act."""


def typed(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """The function, which refuses arguments that are not the path, function or object of this package that is due.

    Numbers and arrays are left to the function.
    """

    @functools.wraps(function)
    def call(*arguments: Parameters.args, **named: Parameters.kwargs) -> Result:
        names = function.__code__.co_varnames[: function.__code__.co_argcount]
        for name, value in (*zip(names, arguments, strict=False), *named.items()):
            if (kinds := _kinds(function, name)) and not isinstance(value, kinds):
                raise InputError(f"{function.__name__} needs {_told(kinds)} as {name}, got {_got(value, kinds)}.")
        return function(*arguments, **named)

    return call


@functools.cache
def _kinds(function: Callable[..., Any], name: str) -> tuple[Any, ...]:
    """Of what types an argument may be; none where that is not looked at."""
    try:
        hint = eval(function.__annotations__.get(name, "object"), function.__globals__)  # noqa: S307 (our own source)
    except NameError:  # imported for type checkers alone
        return ()
    parts = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    kinds = tuple(os.PathLike if part is Path else typing.get_origin(part) or part for part in parts)
    known = (str, os.PathLike, types.NoneType, collections.abc.Callable)
    ours = [kind in known or getattr(kind, "__module__", "").startswith("reachlab.") for kind in kinds]
    return kinds if all(ours) and all(isinstance(kind, type) for kind in kinds) else ()


def _told(kinds: tuple[Any, ...]) -> str:
    """What is needed, and how it comes about."""
    names = {str: "a name", collections.abc.Callable: "a function", os.PathLike: "a path"}
    shown = [kind for kind in kinds if kind is not types.NoneType and not (kind is str and os.PathLike in kinds)]
    told = [names.get(kind) or f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}" for kind in shown]
    made = [f", as {MADE[kind.__name__]}," for kind in shown if kind.__name__ in MADE]
    if str in kinds and collections.abc.Callable in kinds:
        made = [AGENT]
    return " or ".join(told) + "".join(made)


def _got(value: object, kinds: tuple[Any, ...]) -> str:
    """What was given; and which part of it is what is needed."""
    plain = isinstance(value, str | int | float | os.PathLike) or value is None
    parts = [name for name in ("policy", "env", "config", "chain") if name in dir(value)]
    parts = [name for name in parts if isinstance(getattr(value, name), kinds)]
    return (reprlib.repr(value) if plain else type(value).__name__) + "".join(f": give its `{name}`" for name in parts)
