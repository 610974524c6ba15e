"""The examples run as they stand, with a small budget."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
APART = "rejax_ppo.py"
"""Runs in an environment of its own; see `make gymnax`."""


@pytest.mark.parametrize(
    "path", sorted(path for path in EXAMPLES.glob("*.py") if path.name != APART), ids=lambda path: path.name
)
def test_an_example_prints_its_result_as_json(path: Path) -> None:
    words = [sys.executable, str(path), "--steps", "1200", "--seed", "3"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    low, high = result["interval"]
    assert 0 <= low <= result["success"] <= high <= 1
    assert result["steps"] >= 1200
    assert result["seed"] == 3
    assert result["wall_s"] > 0
