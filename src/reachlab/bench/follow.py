"""Whether the viewer's arm follows a target that is dragged in the page of a headless Chromium, and rests there."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from reachlab.bench.chromium import ChromiumError, drawn, wait_until
from reachlab.bench.table import Row, row
from reachlab.watch import stage
from reachlab.watch.viewer import Viewer

if TYPE_CHECKING:
    from reachlab.bench.chromium import Page

REST, STILL = 0.6, 0.0005
"""The arm rests where its tool has moved by less than this [m] for so long [s]."""

PATIENCE = 30.0
"""Time that a drag has to end in rest [s]."""

GLANCE = 0.05
"""Time between two looks at the arm [s]."""

BETWEEN = 5.0
"""Time from one drag to the next in *Endless* [s]."""

SHORTEST, LONGEST = 0.08, 0.35
"""How far a drag goes [m]."""

ATTEMPTS = 3
"""Times that the mouse reaches for a handle that it misses."""


def follow(shown: Viewer, page: Page, task: str, drags: int, seconds: float) -> Iterator[Row]:
    """Figures of so many drags, each held until the arm rests, and of so many seconds with more of them, in *Endless*.

    The viewer is prepared; its page is opened here.

    Raises:
        ChromiumError: the page is not drawn, or the mouse misses the target's handle again and again.
    """
    hand, failed = Hand(shown, page), []

    def work() -> None:
        try:
            shown.panel.endless = True
            hand.drag_and_hold(drags)
            hand.drag_and_let_go(seconds)
        except (ChromiumError, TimeoutError) as error:
            failed.append(error)

    worker = threading.Thread(target=work)
    worker.start()
    restarts = _run(shown, lambda: not worker.is_alive())
    worker.join()
    if failed:
        raise failed[0]
    yield row(f"viewer_drags_followed/{task}", hand.arrived, "drags", drags=hand.drags, seconds=seconds)
    yield row(f"viewer_worst_at_rest/{task}", 1000 * max(hand.resting), "mm", rests=len(hand.resting))
    yield row(f"viewer_new_starts/{task}", restarts, "times", drags=hand.drags)


def _run(shown: Viewer, ended: Callable[[], bool]) -> int:
    """Play until it has ended, and count the failures to follow."""
    restarts, was = 0, ""

    def ask() -> bool:
        nonlocal restarts, was
        failed = shown.player.failed
        restarts, was = restarts + (bool(failed) and not was), failed
        return ended()

    shown.run(ask)
    return restarts


class Hand:
    """A hand at the mouse of a viewer's page.

    Attributes:
        drags: those that it made.
        arrived: those after which the arm rested at the target.
        resting: distances from tool to target at rest [m].
    """

    def __init__(self, shown: Viewer, page: Page) -> None:
        """Hand that opens the page."""
        self._shown, self._page, self._random = shown, page, np.random.default_rng(0)
        self.drags = self.arrived = 0
        self.resting: list[float] = []
        self._open()

    def drag_and_hold(self, drags: int) -> None:
        """Drag so often, and hold the target until the arm rests."""
        for _ in range(drags):
            end = self._grab()
            self._wait_for_rest()
            self._page.let_go(end)

    def drag_and_let_go(self, seconds: float) -> None:
        """Drag from time to time, and let go at once."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._page.let_go(self._grab())
            rested = time.monotonic() + BETWEEN
            self._wait_for_rest()
            time.sleep(max(0.0, min(rested, end) - time.monotonic()))

    def _open(self) -> None:
        self._page.open(self._shown.url)
        wait_until(lambda: drawn(self._page.picture()), "a picture")

    def _grab(self) -> tuple[float, float]:
        """Where the mouse holds the target after a drag along an axis that is free."""
        for _ in range(ATTEMPTS):
            before = self._shown.player.moment.target.copy()
            end = self._reach_for(before)
            time.sleep(0.2)
            if not np.allclose(self._shown.player.moment.target, before, atol=1e-3):
                self.drags += 1
                return end
            self._page.let_go(end)
            self._open()
        raise ChromiumError("the mouse does not find the target's handle")

    def _reach_for(self, target: np.ndarray) -> tuple[float, float]:
        low, high = self._shown.box
        axis = int(self._random.choice(np.flatnonzero(high > low)))
        side = 1.0 if target[axis] < (low + high)[axis] / 2 else -1.0
        direction = np.eye(3)[axis]
        grip = target + stage.HANDLE_SIZE / 2 * direction
        away = side * self._random.uniform(SHORTEST, LONGEST) * direction
        height, width, _ = self._page.picture().shape
        end = pixel(grip + away, width, height)
        self._page.grab(pixel(grip, width, height), end)
        return end

    def _wait_for_rest(self) -> None:
        """Wait until the arm rests, and note where.

        Raises:
            TimeoutError: it does not.
        """
        player, end = self._shown.player, time.monotonic() + PATIENCE
        place, since = player.moment.tool, time.monotonic()
        while time.monotonic() - since < REST or player.over:
            time.sleep(GLANCE)
            moment = player.moment
            if np.linalg.norm(moment.tool - place) > STILL or player.failed:
                place, since = moment.tool, time.monotonic()
            if time.monotonic() > end:
                raise TimeoutError(f"the arm does not rest within {PATIENCE:g} s after a drag")
        self.resting.append(player.moment.distance)
        self.arrived += player.moment.reached


def pixel(point: np.ndarray, width: float, height: float) -> tuple[float, float]:
    """Where the first camera sees a point `[3]` [m] in a page."""
    position, look_at = np.array(stage.VIEW_FROM), np.array(stage.VIEW_TO)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
    depth = (point - position) @ forward
    focus = height / 2 / np.tan(stage.FIELD_OF_VIEW / 2) / depth
    x, y = (point - position) @ right, (point - position) @ np.cross(right, forward)
    return width / 2 + focus * x, height / 2 - focus * y
