"""Help that shows a command's flags in a sentence each, and only those that have an effect with what was chosen."""

from __future__ import annotations

import ast
import dataclasses
import functools
import itertools
import re
import sys
import typing
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any

import tyro

from reachlab.settings.validation import hints


@functools.cache
def _classes(file: str) -> dict[str, ast.ClassDef]:
    """Classes of a file of source by name."""
    source = ast.parse(Path(file).read_text(encoding="utf-8"))
    return {node.name: node for node in ast.walk(source) if isinstance(node, ast.ClassDef)}


@functools.cache
def field_docstrings(cls: type) -> dict[str, str]:
    """Text of each field of a dataclass by its name: the string that stands below it, there or in a class above."""
    texts: dict[str, str] = {}
    for owner in reversed(cls.__mro__[:-1]):
        file = vars(sys.modules.get(owner.__module__, object)).get("__file__")
        node = _classes(file).get(owner.__name__) if file else None  # none of a class that a function made
        for field, text in itertools.pairwise(node.body if node else []):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(text, ast.Expr):
                texts[field.target.id] = " ".join(str(ast.literal_eval(text.value)).split())
    return texts


def short(flags: Any, hidden: Collection[str]) -> tuple[type, Any]:
    """Class and values of flags for help: without those that are `hidden`, and with the first sentence of each."""
    fields, values = [], {}
    for entry in dataclasses.fields(flags):
        hint, value = hints(type(flags))[entry.name], getattr(flags, entry.name)
        if dataclasses.is_dataclass(value) and not hasattr(hint, "__metadata__"):
            hint, value = short(value, hidden)
        elif dataclasses.is_dataclass(value):
            inner, value = short(value, hidden)
            hint = Annotated[inner, *vars(hint)["__metadata__"]]
        elif text := field_docstrings(type(flags)).get(entry.name):
            hint = Annotated[hint, _shown(hint, value, text)]
        fields.append((entry.name, Annotated[hint, tyro.conf.Suppress] if entry.name in hidden else hint))
        values[entry.name] = value
    # Without a file, so that tyro looks for no texts in it.
    nowhere = {"__module__": "builtins", "__doc__": " "}
    made = dataclasses.make_dataclass(type(flags).__name__, fields, frozen=True, namespace=nowhere)
    return made, made(**values)


METAVARS = {int: "N", float: "X", str: "NAME"}
"""How values are called, by their type; all flags are so short that they stand beside their texts."""


def _shown(hint: Any, value: Any, text: str) -> Any:
    """Help of a flag: the first sentence of its text, its default, and how its value is called."""
    usual = " ".join(f"{one:.6g}" if isinstance(one, float) else str(one) for one in _listed(value))
    called = METAVARS.get(_inner(hint), "PATH") + " ..." * isinstance(value, tuple)
    hint = f"[{usual}]" if usual else ""
    return tyro.conf.arg(
        help=first_sentence(text), help_behavior_hint=hint, metavar=None if isinstance(value, bool) else called
    )


def first_sentence(text: str) -> str:
    """The first sentence of a text, or the first part of it."""
    return re.split(r"(?<=[.;])\s", text)[0].rstrip(";.") + "."


def _listed(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else () if value is None else (value,)


def _inner(hint: Any) -> Any:
    """The first plain type in an annotation."""
    while inner := typing.get_args(hint):
        hint = inner[0]
    return hint
