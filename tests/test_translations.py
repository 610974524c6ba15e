"""Pages in Chinese say what those in English say: the same commands, figures, code and links."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
CHINESE = (ROOT / "README.zh-CN.md").read_text(encoding="utf-8")
ENGLISH = (ROOT / "README.md").read_text(encoding="utf-8")

LONGEST = 150
"""Lines of a README."""

FENCED = re.compile(r"^```\w*\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(text: str) -> list[str]:
    """Blocks of commands, output and code, without their comments."""
    return [re.sub(r"\s*#.*", "", block) for block in FENCED.findall(text)]


def prose(text: str) -> str:
    """What stands between the blocks, without the places that links lead to."""
    return re.sub(r"\]\([^)]*\)", "]", FENCED.sub("", text))


def figures(text: str) -> Counter[str]:
    """Numbers in digits."""
    return Counter(re.findall(r"\d[\d,.]*\d|\d", prose(text)))


def links(text: str) -> Counter[str]:
    """Where links lead, in whichever language."""
    ends = re.findall(r"\]\(([^)]*)\)", text)
    return Counter(end.replace(".zh-CN.md", ".md") for end in ends)


def commands(text: str) -> Counter[str]:
    """Code inside lines."""
    return Counter(re.findall(r"`([^`\n]+)`", prose(text)))


@pytest.mark.parametrize("part", [blocks, links, commands], ids=lambda part: part.__name__)
def test_both_readmes_have_the_same(part: object) -> None:
    assert callable(part)
    assert part(CHINESE) == part(ENGLISH)


def test_both_readmes_have_the_same_figures() -> None:
    # In Chinese a number of seeds is written in digits where English has a word.
    english, chinese = figures(ENGLISH), figures(CHINESE)
    assert {n for n in english | chinese if len(n) > 1 and english[n] != chinese[n]} == set()
    assert all(english[n] <= chinese[n] for n in english)


@pytest.mark.parametrize("text", [CHINESE, ENGLISH])
def test_a_readme_is_short(text: str) -> None:
    assert len(text.splitlines()) <= LONGEST
