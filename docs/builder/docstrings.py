"""What the fields of a class are said to be: below them, or in its docstring."""

from __future__ import annotations

import ast
import functools
import inspect
import itertools
import re
import textwrap


@functools.cache
def field_docstrings(cls: type) -> dict[str, str]:
    """Text of each field, by its name: what stands below it, or after it among the docstring's `Attributes`."""
    texts: dict[str, str] = {}
    for owner in reversed(cls.__mro__[:-1]):
        texts |= _below(owner) | _listed(inspect.cleandoc(owner.__doc__ or ""))
    return texts


def _below(cls: type) -> dict[str, str]:
    """Strings that stand below annotated names."""
    try:
        source = textwrap.dedent(inspect.getsource(cls))
    except (OSError, TypeError):  # made by a function, or compiled
        return {}
    definition = ast.parse(source).body[0]
    body = definition.body if isinstance(definition, ast.ClassDef) else []
    return {
        field.target.id: " ".join(text.value.value.split())
        for field, text in itertools.pairwise(body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }


def _listed(docstring: str) -> dict[str, str]:
    """Names of the section `Attributes` with their texts; several names may share one."""
    _, _, section = docstring.partition("Attributes:\n")
    section = re.split(r"\n\S", section)[0]
    entries = re.findall(r"^    (\w[\w, ]*): ((?:.|\n(?:     |\n))*)", section, re.MULTILINE)
    return {name: " ".join(text.split()) for names, text in entries for name in names.split(", ")}
