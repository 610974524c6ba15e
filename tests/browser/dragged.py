"""The live page under a restless hand: what it says on its console, and how much more memory it takes.

`PYTHONPATH=tests python -m browser.dragged [ROBOT/TASK ...] [--minutes M]` drags the goal and bodies at random, turns
the view, pauses, resets, changes speed, agent, sliders and the window's size, for M minutes on each policy.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from playwright.sync_api import Page

from browser.driver import chromium, opened
from browser.live import SIZES, moment, open_live
from browser.played import RUNS
from reachlab.bench.table import Row, row, to_markdown
from reachlab.jax_setup import use_compilation_cache
from reachlab.watch.page.page import write_page
from reachlab.watch.page.shown import load_shown

SETTLING = 60.0
"""Time after which memory is measured first [s], or half of all where that is shorter."""


LOOKS, APART = 5, 700.0
"""How often memory is looked at, and how long apart [ms]: what is being computed is a tenth, and comes and goes."""


def heap(page: Page) -> float:
    """Memory of the page's scripts where it shows one arm, after what is not used is gone, at its least [bytes]."""
    page.locator("#once").select_option(index=0)
    browser, used = page.context.new_cdp_session(page), list[float]()
    for _ in range(LOOKS):
        page.wait_for_timeout(APART)
        browser.send("HeapProfiler.collectGarbage")
        used.append(browser.send("Runtime.getHeapUsage")["usedSize"])
    browser.detach()
    return min(used)


def drag(page: Page, random: np.random.Generator) -> None:
    """Take the goal, its axes, a body or the view somewhere."""
    now = moment(page)
    places = [(now["x"], now["y"]), *(one[3:5] for one in now["bodies"] + now["knobs"]), (60.0, 60.0)]
    x, y = places[random.integers(len(places))]
    page.mouse.move(x, y)
    page.mouse.down()
    for _ in range(random.integers(1, 6)):
        x, y = x + random.normal(0, 80), y + random.normal(0, 60)
        page.mouse.move(x, y, steps=3)
    page.mouse.up()


def press(page: Page, random: np.random.Generator) -> None:
    """Press any button."""
    buttons = page.locator("aside button")
    buttons.nth(int(random.integers(buttons.count()))).click()


def slide(page: Page, random: np.random.Generator) -> None:
    """Move any slider to its end."""
    page.evaluate("document.getElementById('joints').open = true")
    sliders = [one for one in page.locator("input[type=range]").all() if one.is_visible()]
    if sliders:
        one = sliders[random.integers(len(sliders))]
        one.fill(one.get_attribute("min" if random.random() < 0.5 else "max") or "0")


def choose(page: Page, random: np.random.Generator) -> None:
    """Show another number of arms, or tick a box."""
    if random.random() < 0.5:
        page.locator("#once").select_option(index=int(random.integers(4)))
    else:
        boxes = page.locator("input[type=checkbox]:visible")
        boxes.nth(int(random.integers(boxes.count()))).click()


def resize(page: Page, random: np.random.Generator) -> None:
    """Give the window another size."""
    width, height = SIZES[random.integers(len(SIZES))]
    page.set_viewport_size({"width": width, "height": height})


DEEDS: dict[Callable[[Page, np.random.Generator], None], float] = {
    drag: 0.68,
    press: 0.2,
    slide: 0.05,
    choose: 0.02,
    resize: 0.05,
}
"""What the hand does, and how often."""


def figures(page: Page, run: str, minutes: float, seed: int) -> list[Row]:
    """What is said, and how memory grows from the first minute to the end."""
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    with tempfile.TemporaryDirectory() as folder:
        write_page([load_shown(Path(run))], Path(folder) / "page.html")
        open_live(page, Path(folder) / "page.html")
        random, deeds, began, early = np.random.default_rng(seed), 0, time.monotonic(), None
        while (passed := time.monotonic() - began) < 60 * minutes:
            if early is None and passed > min(SETTLING, 30 * minutes):
                early = heap(page)
            chosen = random.choice(len(DEEDS), p=list(DEEDS.values()))
            list(DEEDS)[chosen](page, random)
            deeds += 1
        late, pictures = heap(page), moment(page)["pictures"]
    for sentence in said[:5]:
        sys.stderr.write(f"{run}: {sentence}\n")
    told = {"minutes": minutes, "seed": seed}
    return [
        row(f"console/{run}", len(said), "messages", **told),
        row(f"heap_growth/{run}", late / (early or late) - 1, "share", **told),
        row(f"deeds/{run}", deeds, "count", **told),
        row(f"pictures/{run}", pictures / (60 * minutes), "1/s", **told),
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m browser.dragged", description=__doc__)
    parser.add_argument("runs", nargs="*", default=RUNS)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    words = parser.parse_args()
    use_compilation_cache()
    rows: list[Row] = []
    with chromium() as browser:
        for run in words.runs:
            with opened(browser, *SIZES[0]) as page:
                rows += figures(page, run, words.minutes, words.seed)
    sys.stdout.write(to_markdown(rows))


if __name__ == "__main__":
    main()
