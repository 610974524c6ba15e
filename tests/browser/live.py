"""The live page in a headless Chromium: its size, its first picture, and its pictures and control steps in a second."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page

from browser.driver import PATIENCE, opened, wait_until
from reachlab.bench.table import Row, row
from reachlab.watch.page.page import write_page
from reachlab.watch.page.shown import load_shown

STARTS = 5
"""Starts that are timed; the median counts."""

SECONDS, SETTLING = 5.0, 3.0
"""Time for which pictures and control steps are counted, and before it [s]: a page that is slow draws more simply."""

SIZES = ((1280, 800), (390, 844))
"""Pages of a computer and of a telephone [pixels]."""


def open_live(page: Page, file: Path) -> None:
    """Open a live page and wait until it has drawn an arm."""
    page.goto(file.as_uri())
    page.wait_for_function("window.reachlab && reachlab.moment().pictures > 1", timeout=1000 * PATIENCE)


def moment(page: Page) -> dict[str, Any]:
    """What a live page shows now."""
    return page.evaluate("reachlab.moment()")


def arrived(page: Page) -> None:
    """Return when the arm that the page shows is at its goal.

    Raises:
        TimeoutError: that takes too long.
    """
    wait_until(lambda: moment(page)["reached"], "the arm's arrival")


def live(browser: Browser, run: Path, others: Sequence[Path], task: str, folder: Path) -> Iterator[Row]:
    """Figures of a page of a run of a task, and the size of one of several."""
    file = folder / f"{task}.html"
    for runs in (others, [run]):
        yield row(f"live_page_size/{task}", write_page(list(map(load_shown, runs)), file) / 1e6, "MB", runs=len(runs))
    for width, height in SIZES:
        with opened(browser, width, height) as page:
            yield from _measured(page, file, task, (width, height))


def _measured(page: Page, file: Path, task: str, window: tuple[int, int]) -> Iterator[Row]:
    seen = []
    for _ in range(STARTS):
        started = time.perf_counter()
        open_live(page, file)
        seen.append(time.perf_counter() - started)
    first = statistics.median(seen)
    yield row(f"live_page_first_picture/{task}", first, "s", starts=STARTS, worst=max(seen), window=window)
    pictures, steps = _counted(page)
    period = page.evaluate("reachlab.live.player.run.facts.control_period")
    yield row(f"live_page_pictures_per_second/{task}", pictures, "1/s", window=window, drawn_by="software")
    page.get_by_label("Endless").check()
    _, steps = _counted(page)
    yield row(f"live_page_policy_time/{task}", steps * period, "of real time", window=window)
    page.get_by_role("button", name="max").click()
    _, steps = _counted(page)
    yield row(f"live_page_fastest/{task}", steps, "steps/s", window=window)


def _counted(page: Page) -> tuple[float, float]:
    """Pictures and control steps in a second [1/s]."""
    time.sleep(SETTLING)
    before, started = moment(page), time.perf_counter()
    time.sleep(SECONDS)
    after, elapsed = moment(page), time.perf_counter() - started
    return (after["pictures"] - before["pictures"]) / elapsed, (after["steps"] - before["steps"]) / elapsed
