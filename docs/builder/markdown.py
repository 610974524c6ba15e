"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table with a row of headings."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "".join(f"| {' | '.join(map(_cell, line))} |\n" for line in lines)


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())


def code(value: object) -> str:
    """A value as it is typed, in a cell."""
    return f"`{value}`"


def number(value: float) -> str:
    """A number with the digits that matter to a reader."""
    return f"{value:.4g}".replace("-", "−")


def span(low: Iterable[float], high: Iterable[float]) -> str:
    """Bounds of several numbers: the least and the largest."""
    return f"{number(min(low))} to {number(max(high))}"
