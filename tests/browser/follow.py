"""Whether the viewer's arm follows a target that is dragged in the page of a headless Chromium, and rests there."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from playwright.sync_api import Page
from scipy.spatial.transform import Rotation

from browser.driver import open_scene, wait_until
from reachlab.bench.table import Row, row
from reachlab.watch import stage
from reachlab.watch.viewer import Viewer

REST, STILL = 0.6, 0.002
"""The arm rests where its tool has moved by less than this [m] for so long [s]; noisy sensors move it by 1 mm."""

PATIENCE = 30.0
"""Time that a drag has to end in rest [s]."""

POLL = 0.05
"""Time between two checks whether the arm rests [s]."""

BETWEEN = 5.0
"""Time from one drag to the next in *Endless* [s]."""

SHORTEST, LONGEST = 0.08, 0.35
"""How far a drag goes [m]."""

MOUSE_STEPS = 10
"""Movements of the mouse in a drag."""

GRIP = 2.0
"""Time after a drag in which the target has to move, else the mouse has missed its handle [s]."""

ARC = 0.65
"""Radius of the arcs by which a target is turned, as a share of the handle's size."""

ACROSS = 0.7
"""Least sine of the angle between the line of sight and an arrow that is taken."""

ATTEMPTS = 8
"""Times that the mouse tries to move a target: it may miss the handle, or ask for what the arm cannot reach."""

CATCH_UP = 0.5
"""Time in which the page shows a target that has just stopped [s]."""


def follow(shown: Viewer, page: Page, task: str, drags: int, seconds: float) -> Iterator[Row]:
    """Figures of so many drags, each held until the arm rests, and of so many seconds with more of them, in *Endless*.

    The viewer is prepared; its page is opened here. The page belongs to this thread, so the viewer plays in another.

    Raises:
        TimeoutError: the page is not drawn, or the arm does not rest.
        LookupError: the mouse misses the target's handle again and again.
    """
    shown.panel.endless = True
    ended = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        playing = pool.submit(_play, shown, ended.is_set)
        try:
            hand = Hand(shown, page)
            hand.drag_and_hold(drags)
            hand.drag_and_let_go(seconds)
        finally:
            ended.set()
            restarts = playing.result()
    yield row(f"viewer_drags_followed/{task}", hand.arrived, "drags", drags=hand.drags, seconds=seconds)
    yield row(f"viewer_worst_at_rest/{task}", 1000 * max(hand.resting), "mm", rests=len(hand.resting))
    yield row(f"viewer_new_starts/{task}", restarts, "times", drags=hand.drags)


def _play(shown: Viewer, ended: Callable[[], bool]) -> int:
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
        open_scene(page, shown.url)

    def drag_and_hold(self, drags: int) -> None:
        """Drag so often, and hold the target until the arm rests."""
        for _ in range(drags):
            self._grab()
            self._wait_for_rest()
            self._page.mouse.up()

    def drag_and_let_go(self, seconds: float) -> None:
        """Drag from time to time, and let go at once."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._grab()
            self._page.mouse.up()
            rested = time.monotonic() + BETWEEN
            self._wait_for_rest()
            time.sleep(max(0.0, min(rested, end) - time.monotonic()))

    def _grab(self) -> None:
        """Drag the target along an axis that is free, and hold it. One that moves is taken while all is paused."""
        for _ in range(ATTEMPTS):
            self._shown.paused = self._shown.player.on_path
            if self._shown.paused:
                time.sleep(CATCH_UP)
            before = self._shown.player.moment.target.copy()
            self._drag(before)
            with contextlib.suppress(TimeoutError):
                wait_until(partial(self._has_moved, before), "a movement of the target", GRIP)
                self.drags += 1
                self._shown.paused = False
                return
            self._page.mouse.up()
            open_scene(self._page, self._shown.url)
        raise LookupError("the mouse does not find the target's handle")

    def _has_moved(self, before: np.ndarray) -> bool:
        """Whether the hand has moved the target, which may take one more step on its path before all is paused."""
        player = self._shown.player
        return not player.on_path and not np.allclose(player.moment.target, before, atol=1e-3)

    def _drag(self, target: np.ndarray) -> None:
        low, high = self._shown.stage.goals
        axes, sight = self._axes(), target - stage.VIEW_FROM
        # An arrow along the line of sight is short in the page, and behind others.
        across = np.linalg.norm(np.cross(axes, sight / np.linalg.norm(sight)), axis=1)
        direction = axes[self._random.choice(np.flatnonzero((high > low) & (across > ACROSS)))]
        side = 1.0 if direction @ ((low + high) / 2 - target) > 0 else -1.0
        grip = target + stage.HANDLE_SIZE / 2 * direction
        self._pull(grip, grip + side * self._random.uniform(SHORTEST, LONGEST) * direction)

    def turn(self) -> None:
        """Turn the target by the arc between its first and its second axis, and let go."""
        x, y, _ = self._axes()
        radius, target = ARC * stage.HANDLE_SIZE, self._shown.player.moment.target
        self._pull(target + radius * (x + y) / np.sqrt(2), target + radius * (x + 0.2 * y))
        self._page.mouse.up()

    def _axes(self) -> np.ndarray:
        """Directions of the handle's arrows, a row each `[3, 3]`."""
        return Rotation.from_quat(self._shown.handle.wxyz, scalar_first=True).as_matrix().T

    def _pull(self, grip: np.ndarray, away: np.ndarray) -> None:
        """Take the handle at a point `[3]` and pull it to another [m]."""
        size, mouse = self._page.viewport_size, self._page.mouse
        assert size is not None
        mouse.move(*pixel(grip, **size))
        mouse.down()
        mouse.move(*pixel(away, **size), steps=MOUSE_STEPS)

    def _posed(self) -> np.ndarray:
        """Where the tool is, and how wide the hand is open: it closes and opens while the tool stands still."""
        return np.concatenate([self._shown.player.moment.tool, np.asarray(self._shown.player.state.arm.opening)[0]])

    def _wait_for_rest(self) -> None:
        """Wait until the arm rests, and note where.

        Raises:
            TimeoutError: it does not.
        """
        player, end = self._shown.player, time.monotonic() + PATIENCE
        place, since = self._posed(), time.monotonic()
        while time.monotonic() - since < REST or player.over:
            time.sleep(POLL)
            posed = self._posed()
            if np.linalg.norm(posed - place) > STILL or player.failed:
                place, since = posed, time.monotonic()
            if time.monotonic() > end:
                raise TimeoutError(f"the arm does not rest within {PATIENCE:g} s after a drag")
        self.resting.append(player.moment.distance)
        self.arrived += player.moment.reached


def pixel(point: np.ndarray, width: float, height: float) -> tuple[float, float]:
    """Where the first camera shows a point `[3]` [m] in a page."""
    position, look_at = np.array(stage.VIEW_FROM), np.array(stage.VIEW_TO)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
    depth = (point - position) @ forward
    focus = height / 2 / np.tan(stage.FIELD_OF_VIEW / 2) / depth
    x, y = (point - position) @ right, (point - position) @ np.cross(right, forward)
    return float(width / 2 + focus * x), float(height / 2 - focus * y)
