"""A headless Chromium of the system, driven by Playwright."""

from __future__ import annotations

import contextlib
import io
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, WebSocket, sync_playwright

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

COLOURS = 100
"""Something is drawn where there are more colours than this."""


@dataclass(frozen=True)
class Traffic:
    """What a page and its workers exchange with servers.

    Attributes:
        requests: every address that they asked for.
        messages: sizes of the messages that came through their web sockets, in characters or bytes.
    """

    requests: list[str] = field(default_factory=list)
    messages: list[int] = field(default_factory=list)


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

    def listen(socket: WebSocket) -> None:
        seen.requests.append(socket.url)
        socket.on("framereceived", lambda payload: seen.messages.append(len(payload)))

    page.on("request", lambda request: seen.requests.append(request.url))
    page.on("websocket", listen)
    return seen


def picture(page: Page) -> np.ndarray:
    """What a page shows, `[height, width, 3]` uint8."""
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))


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


def open_scene(page: Page, url: str) -> None:
    """Open an address and wait until a scene is drawn."""
    page.goto(url)
    wait_until(lambda: drawn(picture(page)), "a picture")


def drawn(picture: np.ndarray) -> bool:
    """Whether something is drawn in the middle: many colours, not one."""
    height, width, _ = picture.shape
    middle = picture[height // 4 : -height // 4, width // 4 : -width // 4].reshape(-1, 3)
    # As single numbers: unique rows take 0.17 s, in which the browser would draw.
    return len(np.unique(middle @ np.array([1, 256, 256**2]))) > COLOURS
