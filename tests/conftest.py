"""Settings of the test session."""

from __future__ import annotations

import os

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

from reachlab.jax_setup import use_compilation_cache

use_compilation_cache()

pytest_plugins = ["cost"]
