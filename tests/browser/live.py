"""The page in a headless Chromium: its size, its first picture, its pictures and its time beside the clock's.

`make bench-page` prints the table, `make bench-page RUNS='panda/lift ur5e/track'` that of other policies.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, Page

from browser.driver import PATIENCE, chromium, executable, opened, wait_until
from reachlab.bench.table import Row, row, to_markdown
from reachlab.jax_setup import use_compilation_cache
from reachlab.runs.shipped import shipped
from reachlab.watch.page.page import write_page
from reachlab.watch.page.server import LOCAL
from reachlab.watch.page.shown import load_shown

RUNS = ("panda/precise", "panda/lift", "panda/clutter", "iiwa14/tutorial")
"""Policies whose pages are measured."""

STARTS = 5
"""Starts that are timed, after one that fills the compilation cache; the median counts."""

SECONDS, SETTLING = 5.0, 3.0
"""Time for which pictures and control steps are counted, and before it [s]: a page that is slow draws more simply."""

SIZES = ((1280, 800), (390, 844))
"""Pages of a computer and of a telephone [pixels]."""

DRAGS, REST, STILL = 20, 0.6, 0.002
"""Drags; and the arm rests where its tool has moved by less than this [m] for so long [s]."""

SHOWN = "window.reachlab && reachlab.moment() && reachlab.moment().pictures > 1"
"""Whether an arm is drawn."""

BUSY = "while True: pass"
"""Program that takes all of a core."""


def open_live(page: Page, file: Path) -> None:
    """Open a page from its file and wait until it has drawn an arm."""
    page.goto(file.as_uri())
    page.wait_for_function(SHOWN, timeout=1000 * PATIENCE)


def moment(page: Page) -> dict[str, Any]:
    """What a page shows now."""
    return page.evaluate("reachlab.moment()")


def arrived(page: Page) -> None:
    """Return when the arm that the page shows is at its goal.

    Raises:
        TimeoutError: that takes too long.
    """
    wait_until(lambda: moment(page)["reached"], "the arm's arrival")


def figures(run: str, folder: Path) -> Iterator[Row]:
    """Figures of the page of a policy."""
    file = folder / "page.html"
    yield row(f"page_size/{run}", write_page([load_shown(Path(run))], file) / 1e6, "MB")
    with chromium() as browser:
        yield from _starts(browser, run)
        for window in SIZES:
            with opened(browser, *window) as page:
                yield from _measured(page, file, run + ", telephone" * (window != SIZES[0]), window)
    with _one_core(), chromium() as browser, opened(browser, *SIZES[0]) as page:
        open_live(page, file)
        yield from _paced(page, f"{run}, one core", SIZES[0])


def _starts(browser: Browser, run: str) -> Iterator[Row]:
    """Times of `reachlab view` until it tells its address, and until the page shows the arm."""
    with tempfile.TemporaryDirectory() as cache:
        fresh = [_start(browser, run, os.environ | {"JAX_COMPILATION_CACHE_DIR": f"{cache}/{i}"}) for i in range(3)]
    warm = [_start(browser, run, dict(os.environ)) for _ in range(STARTS + 1)][1:]
    for name, times in (("", warm), ("_fresh_cache", fresh)):
        told, seen = (statistics.median(one) for one in zip(*times, strict=True))
        yield row(f"view_first_picture{name}/{run}", seen, "s", starts=len(times), address=round(told, 2))


def _start(browser: Browser, run: str, environment: dict[str, str]) -> tuple[float, float]:
    """Times from the process's start until it tells its address and until the page shows the arm [s]."""
    words = [sys.executable, "-m", "reachlab", "view", run, "--port", str(free_port())]
    with opened(browser, *SIZES[0]) as page:
        started = time.perf_counter()
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment) as process:
            told = process.stdout.readline() if process.stdout else ""
            served = time.perf_counter() - started
            page.goto(told.split()[1], wait_until="commit")
            page.wait_for_function(SHOWN, timeout=1000 * PATIENCE)
            seen = time.perf_counter() - started
            process.send_signal(signal.SIGINT)
            process.communicate()
    return served, seen


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.create_server((LOCAL, 0)) as listening:
        return int(listening.getsockname()[1])


def _measured(page: Page, file: Path, run: str, window: tuple[int, int]) -> Iterator[Row]:
    seen = []
    for _ in range(STARTS):
        started = time.perf_counter()
        open_live(page, file)
        seen.append(time.perf_counter() - started)
    first = statistics.median(seen)
    yield row(f"page_first_picture/{run}", first, "s", starts=STARTS, worst=round(max(seen), 2), window=window)
    yield from _paced(page, run, window)
    if window == SIZES[0] and not page.evaluate("reachlab.live.shown.facts.objects"):
        yield from _followed(page, run)
    page.get_by_role("button", name="max").click()
    _, steps = _counted(page)
    yield row(f"page_fastest/{run}", steps, "steps/s", window=window)


def _followed(page: Page, run: str) -> Iterator[Row]:
    """Whether the arm comes to rest at a goal that is dragged somewhere and held, in *Endless*."""
    random, resting, begun_again = np.random.default_rng(0), [], 0
    for _ in range(DRAGS):
        now = moment(page)
        x, y = now["x"], now["y"]
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + random.uniform(-150, 150), y + random.uniform(-100, 100), steps=10)
        resting.append(_at_rest(page))
        begun_again += bool(moment(page)["failed"])
        page.mouse.up()
    yield row(f"page_drags_followed/{run}", sum(one is not None for one in resting), "drags", drags=DRAGS)
    yield row(f"page_worst_at_rest/{run}", 1000 * max(one or 0.0 for one in resting), "mm", begun_again=begun_again)


def _at_rest(page: Page) -> float | None:
    """Distance to the goal once the arm is there and has not moved for a while [m]; None where it does not rest."""
    end, before = time.monotonic() + PATIENCE, moment(page)
    while time.monotonic() < end:
        time.sleep(REST)
        now = moment(page)
        still = np.linalg.norm(np.subtract(now["tool"], before["tool"])) < STILL
        if still and now["reached"]:
            return now["distance"]
        before = now
    return None


def _paced(page: Page, run: str, window: tuple[int, int]) -> Iterator[Row]:
    """Pictures in a second and the policy's time beside the clock's, where no episode ends."""
    page.get_by_label("Endless").check()
    pictures, steps = _counted(page)
    period = page.evaluate("reachlab.live.shown.facts.control_period")
    yield row(f"page_pictures_per_second/{run}", pictures, "1/s", window=window, drawn_by="software")
    yield row(f"page_policy_time/{run}", steps * period, "of real time", window=window)


def _counted(page: Page) -> tuple[float, float]:
    """Pictures and control steps in a second [1/s]."""
    time.sleep(SETTLING)
    before = moment(page)
    time.sleep(SECONDS)
    after = moment(page)
    elapsed = (after["time"] - before["time"]) / 1000
    return (after["pictures"] - before["pictures"]) / elapsed, (after["steps"] - before["steps"]) / elapsed


@contextlib.contextmanager
def _one_core() -> Iterator[None]:
    """What is started meanwhile has one core, and all others are busy."""
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, cores[:1])
    busy = [subprocess.Popen(["taskset", "-c", str(core), sys.executable, "-c", BUSY]) for core in cores[1:]]
    try:
        yield
    finally:
        for one in busy:
            one.kill()
            one.wait()
        os.sched_setaffinity(0, cores)


def of_all_arms(task: str, folder: Path) -> Iterator[Row]:
    """Size of a page with the policies of a task on every arm."""
    paths = [policy.path for name, policy in shipped().items() if Path(name).name == task]
    size = write_page(list(map(load_shown, paths)), folder / "arms.html") / 1e6
    yield row(f"page_size/{task}", size, "MB", arms=len(paths))


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m browser.live", description=__doc__)
    parser.add_argument("runs", nargs="*", default=RUNS)
    runs = parser.parse_args(words).runs
    if executable() is None:
        sys.exit("make bench-page needs Chromium: apt install chromium.")
    use_compilation_cache()
    with tempfile.TemporaryDirectory() as folder:
        rows = [*of_all_arms("precise", Path(folder)), *(one for run in runs for one in figures(run, Path(folder)))]
    sys.stdout.write(to_markdown(rows))


if __name__ == "__main__":
    main()
