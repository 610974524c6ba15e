"""Tables of names whose entries are loaded when they are asked for."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class Lazy:
    """An entry of a table: what it is in a sentence, and where it lies, as `package.module:name`."""

    summary: str
    place: str

    def load(self) -> Any:
        """What lies there; its module is imported now."""
        module, _, name = self.place.partition(":")
        return vars(import_module(module))[name]
