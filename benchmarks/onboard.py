"""Suite `onboard`: the controller of an exported policy with its planner, in scenes in which avoiding matters."""

from __future__ import annotations

import os
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.ways import ROBOTS, SCENES
from reachlab.bench.table import Row, row
from reachlab.deploy.check import load_controller, settings_of
from reachlab.deploy.export import export
from reachlab.deploy.plant import Plant
from reachlab.evaluation.report import FRESH_SEED

EPISODES = int(os.environ.get("EPISODES", "200"))
"""Held-out episodes of each scene."""


def onboard() -> Iterator[Row]:
    """The rows of suite `onboard`: measurement/robot scene."""
    for robot in ROBOTS:
        for scene in SCENES:
            with tempfile.TemporaryDirectory() as place:
                folder = export(f"{robot}/clutter", Path(place) / "policy", scene=(scene,)).folder
                yield from _played(folder, f"{robot} {scene}")


def _played(folder: Path, name: str) -> Iterator[Row]:
    """A simulated arm is driven as fast as it computes, and in real time while the planner is waited for."""
    plant, controller = Plant(settings_of(folder, None), FRESH_SEED), load_controller(folder).Controller(folder)
    took, counts, waits = defaultdict[str, list[float]](list), Counter[str](), list[float]()
    for number in range(EPISODES):
        plant.begin(number)
        controller.reset(plant.q)
        waited, modes, done, success, step = 0, set[str](), False, False, 0
        for step in range(plant.steps):
            measured = plant.measure()
            known = controller.goal_joints is not None
            begun = time.perf_counter()
            given = measured.q, measured.qd, measured.goal, step * plant.period
            command = controller.step(*given, **measured.beside)
            mode = controller._way._mode
            took[mode if known else "search"].append(time.perf_counter() - begun)
            modes.add(mode)
            waited += controller.waits
            time.sleep(plant.period * controller.waits)
            done, success = plant.step(command)
            if done:
                break
        waits.append(waited * plant.period)
        touched = done and not success and step + 1 < plant.steps
        counts.update(held=success, contact=touched, policy="follow" not in modes)
    plant.close()
    controller.close()
    for what, count in {"held without contact": "held", "with contact": "contact", "policy alone": "policy"}.items():
        yield row(f"{what}/{name}", counts[count] / EPISODES, "rate", episodes=EPISODES)
    for share in (50, 99):
        yield row(f"waits for the planner, {share} %/{name}", 1000 * float(np.percentile(waits, share)), "ms")
    for mode in ("policy", "follow"):
        for share in (50, 99) if took[mode] else ():
            yield row(f"control step, {mode}, {share} %/{name}", 1e6 * float(np.percentile(took[mode], share)), "µs")
