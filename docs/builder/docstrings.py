"""What the fields of a class are said to be: below them, or in its docstring."""

from __future__ import annotations

import functools
import inspect
import re

from reachlab.cli import short_help


@functools.cache
def field_docstrings(cls: type) -> dict[str, str]:
    """Text of each field, by its name: what stands below it, or after it among the docstring's `Attributes`."""
    texts: dict[str, str] = {}
    for owner in reversed(cls.__mro__[:-1]):
        texts |= _listed(inspect.cleandoc(owner.__doc__ or ""))
    return texts | short_help.field_docstrings(cls)


def _listed(docstring: str) -> dict[str, str]:
    """Names of the section `Attributes` with their texts; several names may share one."""
    _, _, section = docstring.partition("Attributes:\n")
    section = re.split(r"\n\S", section)[0]
    entries = re.findall(r"^    (\w[\w, ]*): ((?:.|\n(?:     |\n))*)", section, re.MULTILINE)
    return {name: " ".join(text.split()) for names, text in entries for name in names.split(", ")}
