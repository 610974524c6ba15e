"""The viewer in a headless Chromium: its first picture, its updates, and whether it keeps real time.

Its policies come with reachlab. `make bench-viewer` prints the table, `make bench-viewer TASKS=pose` that of one task.
"""

from __future__ import annotations

import contextlib
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from playwright.sync_api import Page

from browser.driver import chromium, executable, open_scene, opened, traffic
from browser.follow import follow
from browser.live import live
from reachlab.bench.table import Row, row
from reachlab.cli.console import print_table
from reachlab.envs.core import Env
from reachlab.jax_setup import use_compilation_cache
from reachlab.learn.load import load_policy
from reachlab.runs.directory import RunDirectory
from reachlab.runs.shipped import shipped
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import choose
from reachlab.tasks import TASKS
from reachlab.watch.server import LOCAL
from reachlab.watch.viewer import Viewer

ROBOT = "iiwa14"
"""The arm whose policies are shown."""

STARTS = 5
"""Starts that are timed, after one that fills the compilation cache; the median counts."""

SECONDS = 10.0
"""Time for which updates and control steps are counted [s]."""

SETTLING = 2.0
"""Time before that, in which the browser comes to rest [s]."""

SIZE = (1280, 720)
"""The page [pixels]."""

COUNT_PICTURES = "pictures = 0; (function next() { pictures += 1; requestAnimationFrame(next) })()"
"""Script that counts how often the page is drawn."""

DRAGS, FOLLOWED = 20, 60.0
"""Drags of which each is held until the arm rests, and the time in which more are let go [s]."""


def viewer(tasks: Sequence[str]) -> Iterator[Row]:
    """Time to the first picture, updates in a second, and the policy's time against the clock's.

    And how the policies play in a live page, and follow a target that is dragged.
    """
    policies = shipped()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, chromium() as browser:
        for task in tasks:
            run = policies[f"{ROBOT}/{task}"]
            config = run.read_config()
            for measure in (_starts, _live, _followed):
                with opened(browser, *SIZE) as page:
                    yield from measure(page, run, config)
            if "bodies" not in TASKS[task].load()().gives:
                others = [policy.path for name, policy in policies.items() if Path(name).name == task]
                yield from live(browser, run.path, others, task, Path(folder))


@contextlib.contextmanager
def _shown(run: RunDirectory, config: RunConfig) -> Iterator[Viewer]:
    """A run's trained policy in a viewer that is prepared."""
    env = Env(config, 1)
    load = partial(load_policy, run, env)
    with Viewer(env, run.checkpoint_steps(), load, "trained", LOCAL, free_port()) as shown:
        shown.prepare(seed=1)
        yield shown
    env.close()


def _followed(page: Page, run: RunDirectory, config: RunConfig) -> Iterator[Row]:
    """Figures of a policy whose target is dragged."""
    with _shown(run, config) as shown:
        yield from follow(shown, page, config.task, DRAGS, FOLLOWED)


def _starts(page: Page, run: RunDirectory, config: RunConfig) -> Iterator[Row]:
    """Times of `reachlab view` until the browser can open it, and until it has drawn the arm."""
    task = config.task
    served, seen = zip(*[_start(page, run) for _ in range(STARTS + 1)][1:], strict=True)
    yield row(f"viewer_served/{task}", statistics.median(served), "s", starts=STARTS, worst=max(served))
    yield row(f"viewer_first_picture/{task}", statistics.median(seen), "s", starts=STARTS, worst=max(seen), window=SIZE)


def _start(page: Page, run: RunDirectory) -> tuple[float, float]:
    """Times from the process's start until it tells its address and until the page shows the arm [s]."""
    words = [sys.executable, "-m", "reachlab", "view", str(run.path), "--port", str(free_port())]
    started = time.perf_counter()
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            said = process.stdout.readline() if process.stdout else ""
            served = time.perf_counter() - started
            if not said.startswith("Viewer: "):
                raise RuntimeError(f"the viewer does not start: {said.strip()}")
            open_scene(page, said.split()[1])
            return served, time.perf_counter() - started
        finally:
            page.goto("about:blank")
            process.send_signal(signal.SIGINT)
            process.communicate()


def _live(page: Page, run: RunDirectory, config: RunConfig) -> Iterator[Row]:
    """Figures of a policy that moves the arm from one target to the next, while the page is open."""
    messages = traffic(page).messages
    with _shown(run, config) as shown:
        shown.panel.endless = True
        open_scene(page, shown.url)
        page.evaluate(COUNT_PICTURES)
        shown.run(_after(SETTLING, shown))
        pictures, steps = page.evaluate("pictures"), shown.player.steps
        messages.clear()
        started, used = time.perf_counter(), time.process_time()
        shown.run(_after(SECONDS, shown))
        elapsed, used = time.perf_counter() - started, time.process_time() - used
        steps, pictures = shown.player.steps - steps, page.evaluate("pictures") - pictures
    yield row(f"viewer_updates_per_second/{config.task}", len(messages) / elapsed, "1/s", seconds=SECONDS)
    yield row(f"viewer_pictures_per_second/{config.task}", pictures / elapsed, "1/s", window=SIZE, drawn_by="software")
    speed = steps * config.physics.control_period / elapsed
    yield row(f"viewer_policy_time/{config.task}", speed, "of real time", steps=steps, seconds=SECONDS)
    yield row(f"viewer_processor_time/{config.task}", used / elapsed, "of one core", seconds=SECONDS)


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.create_server((LOCAL, 0)) as listening:
        return int(listening.getsockname()[1])


def _after(seconds: float, shown: Viewer) -> Callable[[], bool]:
    """Whether so much time has passed since now [s]; until then there is a new target as soon as one is reached."""
    end = time.perf_counter() + seconds

    def ended() -> bool:
        if shown.player.moment.reached:
            shown.reset()
        return time.perf_counter() >= end

    return ended


if __name__ == "__main__":
    if executable() is None:
        sys.exit("make bench-viewer needs Chromium: apt install chromium.")
    use_compilation_cache()
    tasks = [choose("task", task, TASKS) for task in sys.argv[1:]] or list(TASKS)
    cells = [(row["name"], f"{row['value']:.4g}", row["unit"], str(row["config"])) for row in viewer(tasks)]
    print_table("viewer", ("measurement", "value", "unit", "configuration"), cells)
