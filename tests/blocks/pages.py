"""Blocks of commands in pages: what they say, and what is said not to be run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]

ORDER = ("start", "tutorial", "own-arm", "precise", "pose", "track", "clutter", "camera", "learners")
"""Pages that come first, after the README: what they train is used by others."""

BLOCK = re.compile(r"((?:^<!-- not run.*? -->\n+)*)^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)

MARK = re.compile(r"<!-- not run(?: \((.+?)\))?: (.+?) -->")

LEFT_OUT = {
    "reachlab bench": "measures for minutes or hours; tests/test_docs.py checks its suite and its flags",
    "make demo": "installs anew; `make test` installs in the same way, and its two commands are run here",
    "--gui": "opens a window; tests/test_sims.py",
}
"""Words of commands that are run nowhere here, and why."""


@dataclass(frozen=True)
class Block:
    """Commands that stand together on a page.

    Attributes:
        page: where.
        commands: what follows the prompts, in order.
        marks: what is said not to be run, as words that its lines hold ("" for all lines), and why.
    """

    page: str
    commands: tuple[str, ...]
    marks: tuple[tuple[str, str], ...]

    def reason(self, command: str) -> str | None:
        """Why a command is not run; None if it is."""
        said = [*self.marks, *LEFT_OUT.items()]
        return next((why for words, why in said if words in command), None)


def pages() -> list[Path]:
    """README and docs, in the order in which their commands are run."""
    docs = sorted((ROOT / "docs").glob("*.md"), key=lambda page: (page.stem not in ORDER, page.stem))
    first = [ROOT / "docs" / f"{name}.md" for name in ORDER]
    return [ROOT / "README.md", *first, *(page for page in docs if page.stem not in ORDER)]


def fenced(text: str, language: str) -> Iterator[tuple[str, tuple[tuple[str, str], ...]]]:
    """Text and marks of each block of a language."""
    for marks, name, body in BLOCK.findall(text):
        if name == language:
            yield body, tuple(MARK.findall(marks))


def blocks(page: str, text: str) -> list[Block]:
    """Blocks of commands on a page."""
    return [
        Block(page, tuple(line[2:] for line in body.splitlines() if line.startswith("$ ")), marks)
        for body, marks in fenced(text, "console")
    ]
