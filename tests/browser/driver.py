"""A headless Chromium of the system, driven by Playwright."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from playwright.sync_api import Browser, Page, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome")

FLAGS = (
    "--disable-background-networking",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
"""WebGL is computed in software: the pictures need no graphics card."""

PATIENCE = 60.0
"""Time in which anything awaited has to happen [s]."""


@dataclass(frozen=True)
class Traffic:
    """What a page and its workers exchange with servers.

    Attributes:
        requests: every address that they asked for.
    """

    requests: list[str] = field(default_factory=list)


def executable() -> str | None:
    """Chromium's path, if there is one."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    """A new Chromium; it and its pages belong to the thread that opened it."""
    with sync_playwright() as playwright:
        # Playwright's own Chromium would be a download of 150 MB.
        browser = playwright.chromium.launch(
            executable_path=executable(), args=FLAGS, chromium_sandbox=False, timeout=1000 * PATIENCE
        )
        yield browser
        browser.close()


@contextlib.contextmanager
def opened(browser: Browser, width: int, height: int) -> Iterator[Page]:
    """An empty page; closed at the end, because drawing without a graphics card takes the time of all others."""
    page = browser.new_page(viewport={"width": width, "height": height})
    page.set_default_timeout(1000 * PATIENCE)
    yield page
    page.close()


def traffic(page: Page) -> Traffic:
    """Traffic of a page from now on."""
    seen = Traffic()
    page.on("request", lambda request: seen.requests.append(request.url))
    page.on("websocket", lambda socket: seen.requests.append(socket.url))
    return seen


def wait_until(happened: Callable[[], bool], what: str, patience: float = PATIENCE) -> None:
    """Return when it has happened.

    Raises:
        TimeoutError: that takes longer than `patience` [s].
    """
    end = time.monotonic() + patience
    while not happened():
        if time.monotonic() > end:
            raise TimeoutError(f"{what} did not happen within {patience:g} s")
        time.sleep(0.05)
