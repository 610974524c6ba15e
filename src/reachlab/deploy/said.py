"""What a node says is wrong: when that begins and when it ends, and some things once."""

from __future__ import annotations

import re
from collections.abc import Callable

NUMBER = re.compile(r"(?<![\w.])[\d.]+(e[-+]\d+)?")
"""One that is measured, and no part of a name."""

LASTS = 25
"""Control steps in a row after which something is told for which an arm need not brake; and after which something for
which it brakes is told again, where two take turns."""


class Said:
    """What has been told.

    Attributes:
        state: the last thing that was wrong; empty where all was well.
    """

    def __init__(self, warn: Callable[[str], object], state: Callable[[str], object]) -> None:
        """Nothing yet; `warn` tells a sentence, and `state` what is wrong now, or nothing."""
        self.state, self._warn, self._tell = "", warn, state
        self._once, self._kind, self._steps, self._lasting = set[str](), "", 0, ""
        self._before, self._since = "", 0

    def once(self, about: str, what: str) -> None:
        """Tell something, of what nothing was told before."""
        if about not in self._once:
            self._once.add(about)
            self._warn(what)

    def step(self, problem: str, *, at_once: bool = True) -> None:
        """Tell what is wrong in a control step, where it is not what was told, but for its numbers."""
        kind = NUMBER.sub("#", problem)
        self._steps, self._kind = self._steps + 1 if kind == self._kind else 1, kind
        self._since += 1
        if not problem:
            self._lasting = ""
        elif not at_once:  # what lasts goes on while anything else is wrong for moments
            problem = self._lasting = problem if self._steps >= LASTS else self._lasting
        elif kind == self._before and self._since < LASTS:
            return
        told = NUMBER.sub("#", self.state)
        if NUMBER.sub("#", problem) != told:
            self._warn(problem or "all is well again")
            self._tell(problem)
            self._before, self._since = told, 0
        self.state = problem
