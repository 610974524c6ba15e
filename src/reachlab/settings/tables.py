"""Entries of tables whose modules are too heavy to be imported before they are needed."""

from __future__ import annotations

from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any


@dataclass(frozen=True)
class Lazy:
    """An entry of a table that is loaded when it is asked for: what it is in a sentence, and where it lies.

    Attributes:
        summary: one sentence for the command line's help and for `reachlab list`.
        place: `package.module:name`.
    """

    summary: str
    place: str

    def load(self) -> Any:
        """The object itself; its module is imported the first time.

        Raises:
            ImportError: the module does not load, for example where an extra is not installed.
            AttributeError: the module has no such name.
        """
        return resolve_name(self.place)
