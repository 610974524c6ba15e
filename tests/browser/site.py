"""The built site: no link leads nowhere, nothing is loaded from the network, and pages fit a phone; see `make docs`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from browser.driver import chromium, executable, opened, traffic
from reachlab.cli.console import say

PHONE = 390, 844
"""Width and height of a phone's screen [pixels]."""

ATTRIBUTES = "href", "src"
"""What names another file or place."""


class Names(HTMLParser):
    """The places of a page, and the links in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.places: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Remember what a tag names."""
        del tag
        given = dict(attrs)
        self.places |= {value for key in ("id", "name") if (value := given.get(key))}
        self.links += [value for key in ATTRIBUTES if (value := given.get(key))]


def broken(site: Path) -> Iterator[str]:
    """Links within a site that lead nowhere, each with its page."""
    pages = {page: Names(page.read_text(encoding="utf-8")) for page in sorted(site.rglob("*.html"))}
    for page, names in pages.items():
        for link in names.links:
            parts = urlsplit(link)
            if parts.scheme:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page.resolve()
            known = pages.get(target)
            if not target.exists() or (parts.fragment and known and unquote(parts.fragment) not in known.places):
                yield f"{page.relative_to(site)}: {link} leads nowhere"


def misfits(site: Path) -> Iterator[str]:
    """Pages that are wider than a phone, or that ask for anything but the site's own files."""
    with chromium() as browser, opened(browser, *PHONE) as page:
        seen = traffic(page)
        for file in sorted(site.rglob("*.html")):
            page.goto(file.resolve().as_uri())
            width = page.evaluate("document.documentElement.scrollWidth")
            if width > PHONE[0]:
                yield f"{file.relative_to(site)} is {width} pixels wide on a phone of {PHONE[0]}"
        outside = {url for url in seen.requests if not url.startswith(("file:", "data:", "blob:"))}
        yield from (f"{url} is loaded from elsewhere" for url in sorted(outside))


def main(site: Path) -> int:
    """Exit status: 1 where something is wrong, which is printed."""
    faults, looked_at = list(broken(site)), "no page is wider than a phone"
    if executable():
        faults += misfits(site)
    elif os.environ.get("CI"):
        faults.append("there is no Chromium to look at the pages with: apt install chromium")
    else:
        looked_at = "not looked at on a phone, since there is no Chromium: apt install chromium"
    say("\n".join(faults) or f"{len(list(site.rglob('*.html')))} pages: no link leads nowhere; {looked_at}.")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
