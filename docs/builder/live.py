"""Pages of the site in which policies that come with it run; see `reachlab view --out`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from reachlab.robots.catalogue import ROBOTS

PAGES = {
    "tutorial": [Path("iiwa14/tutorial")],
    "hands": [Path("panda/lift"), Path("panda/push")],
    "arms": [Path(robot, "precise") for robot in ROBOTS],
}
"""Policies of each page."""


def _frame(name: str) -> str:
    """The page inside another."""
    address = f"live/{name}.html"
    return (
        f'<iframe class="live" src="{address}" title="A policy that runs in this page" loading="lazy"></iframe>\n\n'
        f'<a href="{address}">On a page of its own</a>'
    )


FRAMES: dict[str, Callable[[], str]] = {f"live {name}": partial(_frame, name) for name in PAGES}
"""What stands for a page in Markdown."""


def write_pages(site: Path) -> None:
    """Write the pages into a built site."""
    from reachlab.watch.page.page import write_page
    from reachlab.watch.page.shown import load_shown

    (site / "live").mkdir(exist_ok=True)
    for name, policies in PAGES.items():
        write_page(list(map(load_shown, policies)), site / "live" / f"{name}.html")
