"""Blocks of commands in pages: what they say, and what is said not to be run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]

LANES = (
    ("README.md", "docs/results.md", "docs/precise.md", "docs/clutter.md", "docs/camera.md", "docs/deploy.md"),
    ("docs/start.md", "docs/tutorial.md", "docs/own-arm.md", "docs/pose.md", "docs/track.md", "docs/learners.md"),
)
"""Pages that are run one after the other in a folder of their own, because they use the same runs; lanes are run at the
same time. Pages that are not named use their own runs or that of each lane's first page: the free lane takes one."""

BLOCK = re.compile(r"((?:^<!-- not run.*? -->\n+)*)^```([\w{}-]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)

MARK = re.compile(r"<!-- not run(?: \((.+?)\))?: (.+?) -->")

LEFT_OUT = {
    "reachlab bench": "measures for minutes; tests/test_docs.py checks its suite and its flags",
    "python -m benchmarks": "measures for minutes or hours; tests/test_docs.py checks its suite",
    "make demo": "installs anew; `make test` installs in the same way, and its two commands are run here",
    "pybullet --gui": "opens a window; tests/test_sims.py",
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


def lanes() -> list[list[Path]]:
    """Pages of each lane, in the order in which their commands are run."""
    return [[ROOT / name for name in lane] for lane in LANES]


def others() -> list[Path]:
    """Pages of no lane."""
    named = {page for lane in lanes() for page in lane}
    return sorted(page for page in (ROOT / "docs").glob("*.md") if page not in named)


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
