"""Settings of the test session."""

from __future__ import annotations

import gc
import importlib.util
import itertools
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import jax

from reachlab import jax_setup
from reachlab.settings.validation import InputError

# Tests change constants and functions that a kept trace does not know of.
jax_setup.keep_in = lambda _: None
jax_setup.use_compilation_cache()

pytest_plugins = ["cost"]

PYBULLET = importlib.util.find_spec("pybullet") is not None
"""Its wheels end at Python 3.11; with newer ones the tests that need it skip."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Iterator[Any]:
    return (yield from _skipping())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[Any]:
    return (yield from _skipping())


def _skipping() -> Iterator[Any]:
    try:
        return (yield)
    except (InputError, ModuleNotFoundError) as error:
        if PYBULLET or "pybullet" not in str(error):
            raise
        pytest.skip("needs PyBullet")


MOST_MAPS, TESTS = 30_000, itertools.count(1)
"""Pieces of memory of a process with which its programs are let go: Linux gives it 65,530, and JAX ends a process that
compiles or reads one more."""


def pytest_runtest_teardown() -> None:
    """Programs of thousands of tests do not fill a process."""
    maps = Path("/proc/self/maps")
    if next(TESTS) % 20 == 0 and maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


@pytest.fixture
def entered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The examples of own tasks and rewards are imported, and their entries go again."""
    from reachlab.control import CONTROLLERS
    from reachlab.tasks import TASKS
    from reachlab.tasks.actions import ACTIONS
    from reachlab.tasks.observations import OBSERVATIONS
    from reachlab.tasks.rewards import REWARDS

    tables: tuple[dict[str, Any], ...] = (TASKS, CONTROLLERS, OBSERVATIONS, ACTIONS, REWARDS)
    before = [set(table) for table in tables]
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "examples"))
    for name in ("rail", "cue", "quick"):
        monkeypatch.delitem(sys.modules, name, raising=False)
        importlib.import_module(name)
    yield
    for table, names in zip(tables, before, strict=True):
        for name in set(table) - names:
            del table[name]


@pytest.fixture(scope="module")
def few_scenes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Banks of a few scenes, in a cache of their own."""
    from reachlab.tasks.scenes import bank

    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bank, "TRAINING", 8)
        patch.setattr(bank, "HELD_OUT", 8)
        patch.setattr(bank, "cache_folder", lambda: folder)
        yield
