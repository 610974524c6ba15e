"""Tables of what has a name, and entries whose modules are too heavy to be imported before they are needed."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, TypeVar

from reachlab.settings.validation import InputError

Entry = TypeVar("Entry")


class Table(dict[str, Entry]):
    """Entries by name. Others can be added, and exchanged; those that it begins with stay what they are."""

    def __init__(self, own: Mapping[str, Entry]) -> None:
        super().__init__(own)
        self._own = frozenset(own)

    def __setitem__(self, name: str, entry: Entry) -> None:
        """Enter what is called by a name.

        Raises:
            InputError: reachlab has one of that name.
        """
        if name in self._own and entry is not self[name]:
            raise InputError(f"{name!r} is an entry of reachlab's own, which stays: choose another name for yours.")
        super().__setitem__(name, entry)


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
            InputError: there is no such module, or it has no such name.
        """
        module, _, name = self.place.partition(":")
        try:
            return resolve_name(self.place)
        except ModuleNotFoundError as error:
            if error.name is None or not f"{module}.".startswith(f"{error.name}."):
                raise
            why = f"there is no module {module!r}: it has the name of its file, without .py; a notebook's is __main__"
        except AttributeError:
            if hasattr(sys.modules.get(module), name):
                raise
            why = f"module {module!r} has no {name!r}"
        raise InputError(f"the table's entry {self.place!r} cannot be loaded: {why}.")
