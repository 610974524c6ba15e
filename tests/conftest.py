"""Settings of the test session."""

from __future__ import annotations

import os
import time

import pytest

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

from reachlab.jax_setup import use_compilation_cache

use_compilation_cache()

DEADLINE = float(os.environ.get("TEST_DEADLINE", "inf"))
"""Time, in seconds since 1970, from which on tests are skipped: a check may have a limit, and a machine be slow."""


def pytest_runtest_setup() -> None:
    """Skip what would begin too late."""
    if time.time() > DEADLINE:
        pytest.skip("the time for tests is used up")
