"""Pictures of the page for README and docs: `PYTHONPATH=tests python -m browser.pictures`."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page

from browser.driver import chromium, opened
from browser.live import open_live
from reachlab.jax_setup import use_compilation_cache
from reachlab.watch.page.page import write_page
from reachlab.watch.page.shown import load_shown

IMAGES = Path(__file__).parents[2] / "docs" / "images"

SIZE, FILM_SIZE = (1280, 960), (1000, 640)
"""Of the page [pixels]."""

FILMED, STRIDE, SLOWER = 150, 3, 1.5
"""Control steps of a film, steps between two of its pictures, and how much slower than real time it is."""

QUALITY = 70
"""Of the film, of 100."""


def shown(page: Page, runs: Sequence[str], at_once: str) -> None:
    """Open a page of policies that come with reachlab, at rest at the begin of an episode."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "page.html"
        write_page([load_shown(Path(run)) for run in runs], file)
        open_live(page, file)
    page.get_by_label("At once").select_option(at_once)
    page.get_by_role("button", name="Pause").click()
    page.evaluate("document.getElementById('hint').hidden = true")


def advance(page: Page, steps: int) -> None:
    """Take so many control steps, and wait until they are drawn."""
    page.evaluate(
        """async (steps) => {
            for (let i = 0; i < steps; i++) reachlab.live.single();
            for (let i = 0; i < 3; i++) await new Promise(requestAnimationFrame);
        }""",
        steps,
    )


def film(page: Page) -> Iterator[Image.Image]:
    """Pictures of what a page plays."""
    for _ in range(0, FILMED, STRIDE):
        advance(page, STRIDE)
        yield Image.open(io.BytesIO(page.screenshot())).convert("RGB")


def main() -> None:
    """Write the pictures."""
    use_compilation_cache()
    with chromium() as browser:
        with opened(browser, *FILM_SIZE) as page:
            shown(page, ["panda/lift"], "four episodes")
            first, *others = film(page)
            milliseconds = round(1000 * SLOWER * STRIDE * page.evaluate("reachlab.live.shown.facts.control_period"))
            settings = {"duration": milliseconds, "loop": 0, "quality": QUALITY, "method": 6}
            first.save(IMAGES / "page.webp", save_all=True, append_images=others, **settings)
        with opened(browser, *SIZE) as page:
            shown(page, ["panda/pose"], "policy and baseline")
            advance(page, 60)
            page.wait_for_timeout(300)
            page.screenshot(path=IMAGES / "page-pose.png")
        with opened(browser, *SIZE) as page:
            shown(page, ["panda/push", "panda/lift"], "one episode")
            page.get_by_text("Joints", exact=True).click()
            page.evaluate("document.querySelector('aside').scrollTop = 0")
            advance(page, 40)
            page.wait_for_timeout(300)
            page.screenshot(path=IMAGES / "page.png")


if __name__ == "__main__":
    main()
