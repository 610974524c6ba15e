"""The example of a trainer written for gymnax; run by `make gymnax`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples" / "rejax_ppo.py"
STEPS = 2 * 128 * 64


def test_rejax_trains_and_its_policy_is_judged_on_held_out_goals() -> None:
    command = [sys.executable, str(EXAMPLE), "--steps", str(STEPS), "--seed", "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert (said["seed"], said["steps"]) == (1, STEPS)
    assert 0 <= said["success_rate"] <= 1
