"""Parts of pages that are made from the package's own tables; also a Sphinx extension, for those that need a site.

What stands between `<!-- made by make tables: NAME -->` and `<!-- end -->` is what `PARTS[NAME]` gives: `make tables`
writes it into the pages, so that they are complete where Markdown is read as it is, and a test says when it is out of
date. Where a page says `<!-- made at the build: NAME -->`, what `ON_SITE[NAME]` gives stands on the site alone.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from builder.commands import COMMANDS
from builder.live import FRAMES, write_pages
from builder.reference import REFERENCE
from builder.tables import TABLES

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PARTS: dict[str, Callable[[], str]] = {**TABLES, **COMMANDS}
"""Functions that give Markdown, by the name under which pages ask for it."""

ON_SITE: dict[str, Callable[[], str]] = {**REFERENCE, **FRAMES}
"""The same, of what needs Sphinx or a page that runs."""

PAGES = {"../CHANGELOG.md": "changelog.md", "../CONTRIBUTING.md": "contributing.md"}
"""Pages of the site that stand for files beside the folder of the docs."""

PART = re.compile(r"^<!-- made by make tables: (.+?) -->\n.*?^<!-- end -->$", re.MULTILINE | re.DOTALL)
MARK = re.compile(r"^<!-- made at the build: (.+?) -->$", re.MULTILINE)


def renewed(text: str) -> str:
    """A page's Markdown with its parts made anew.

    Raises:
        KeyError: it asks for one that there is not.
    """
    return PART.sub(lambda mark: f"<!-- made by make tables: {mark[1]} -->\n\n{PARTS[mark[1]]()}\n<!-- end -->", text)


def filled(text: str) -> str:
    """A page's Markdown with what only the site has, and with links that hold there.

    Raises:
        KeyError: it asks for a part that there is not.
    """
    for file, page in PAGES.items():
        text = text.replace(f"]({file}", f"]({page}")
    return MARK.sub(lambda mark: ON_SITE[mark[1]](), text)


def _fill(_app: Sphinx, _page: str, source: list[str]) -> None:
    source[0] = filled(source[0])


def _skip(_app: Sphinx, _kind: str, _name: str, obj: object, _skipped: bool, _options: object) -> bool | None:
    """Leave out the fields of a NamedTuple, which its docstring tells of; None leaves the choice to autodoc."""
    return True if str(getattr(obj, "__doc__", "")).startswith("Alias for field number") else None


def _finish(app: Sphinx, error: Exception | None) -> None:
    if error is None:
        write_pages(Path(app.outdir))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension."""
    app.connect("source-read", _fill)
    app.connect("autodoc-skip-member", _skip)
    app.connect("build-finished", _finish)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
