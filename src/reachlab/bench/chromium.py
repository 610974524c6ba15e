"""A headless Chromium, driven over its DevTools protocol."""

from __future__ import annotations

import base64
import contextlib
import io
import itertools
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from websockets.sync.client import connect
from websockets.sync.connection import Connection

NAMES = ("chromium", "chromium-browser", "google-chrome")

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--remote-debugging-port=0",
)

PATIENCE = 60.0
"""Time in which anything awaited has to happen [s]."""

COLOURS = 100
"""Something is drawn where there are more colours than this."""


def executable() -> str | None:
    """Chromium's path, if there is one."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class ChromiumError(Exception):
    """What a page does not do."""


class Page:
    """An open page.

    Attributes:
        requests: every address that it and its workers asked for.
        arrivals: when a message came through one of their web sockets, on the browser's clock [s].
    """

    def __init__(self, connection: Connection) -> None:
        """A new page of the browser at the other end of a connection."""
        self._connection, self._numbers = connection, itertools.count()
        self._session: str | None = None
        self.requests: list[str] = []
        self.arrivals: list[float] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.call("Network.enable")
        self.call("Page.enable")
        self.call("Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=True, flatten=True)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Answer to a command of the DevTools protocol.

        Raises:
            ChromiumError: it was refused.
        """
        number = self._send(self._session, method, parameters)
        while True:
            answer = self._receive()
            if answer.get("id") == number:
                if "error" in answer:
                    raise ChromiumError(answer["error"])
                return answer["result"]

    def open(self, url: str) -> None:
        """Open an address and wait until the page is loaded."""
        self.call("Page.navigate", url=url)
        while self._receive().get("method") != "Page.loadEventFired":
            pass

    def evaluate(self, script: str) -> Any:
        """Value of a piece of JavaScript."""
        return self.call("Runtime.evaluate", expression=script, returnByValue=True)["result"].get("value")

    def text(self) -> str:
        """Text that it shows."""
        return str(self.evaluate("document.body.innerText"))

    def picture(self) -> np.ndarray:
        """What it shows, `[height, width, 3]` uint8."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 10) -> None:
        """Move the mouse from one point to another with its button down."""
        self.grab(start, end, steps)
        self.let_go(end)

    def grab(self, start: tuple[float, float], end: tuple[float, float], steps: int = 10) -> None:
        """As `drag`, with the button still down at the end."""
        self._mouse("mouseMoved", *start, held=False)
        self._mouse("mousePressed", *start)
        for x, y in np.linspace(start, end, steps):
            self._mouse("mouseMoved", x, y)

    def let_go(self, end: tuple[float, float]) -> None:
        """Release the button."""
        self._mouse("mouseReleased", *end)

    def _send(self, session: str | None, method: str, parameters: dict[str, Any]) -> int:
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        self._connection.send(json.dumps(message | ({"sessionId": session} if session else {})))
        return number

    def _receive(self) -> dict[str, Any]:
        message = json.loads(self._connection.recv(timeout=PATIENCE))
        said = message.get("params", {})
        if message.get("method") == "Target.attachedToTarget" and self._session:
            # A worker, which waits until its requests are watched too.
            for method in ("Network.enable", "Runtime.runIfWaitingForDebugger"):
                self._send(said["sessionId"], method, {})
        if message.get("method") == "Network.requestWillBeSent":
            self.requests.append(said["request"]["url"])
        elif message.get("method") == "Network.webSocketCreated":
            self.requests.append(said["url"])
        elif message.get("method") == "Network.webSocketFrameReceived":
            self.arrivals.append(said["timestamp"])
        return message

    def _mouse(self, kind: str, x: float, y: float, *, held: bool = True) -> None:
        button = {"button": "left", "buttons": 1, "clickCount": 1} if held else {}
        self.call("Input.dispatchMouseEvent", type=kind, x=float(x), y=float(y), **button)


@contextlib.contextmanager
def browser(profile: Path, width: int = 900, height: int = 600) -> Iterator[Page]:
    """A page of a new Chromium whose settings lie in the folder `profile`."""
    words = [str(executable()), *FLAGS, f"--window-size={width},{height}", f"--user-data-dir={profile}", "about:blank"]
    port = profile / "DevToolsActivePort"
    with subprocess.Popen(words, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as process:  # noqa: S603
        try:
            wait_until(lambda: port.is_file() and len(port.read_text().split()) > 1, "Chromium's start")
            number, path = port.read_text().split()
            with connect(
                f"ws://127.0.0.1:{number}{path}", max_size=None, max_queue=None, ping_interval=None
            ) as connection:
                yield Page(connection)
        finally:
            process.terminate()


def wait_until(happened: Callable[[], bool], what: str) -> None:
    """Return when it has happened.

    Raises:
        ChromiumError: that takes longer than `PATIENCE`.
    """
    end = time.monotonic() + PATIENCE
    while not happened():
        if time.monotonic() > end:
            raise ChromiumError(f"{what} did not happen within {PATIENCE:g} s")
        time.sleep(0.05)


def drawn(picture: np.ndarray) -> bool:
    """Whether something is drawn in the middle: many colours, not one."""
    height, width, _ = picture.shape
    middle = picture[height // 4 : -height // 4, width // 4 : -width // 4].reshape(-1, 3)
    return len(np.unique(middle, axis=0)) > COLOURS
