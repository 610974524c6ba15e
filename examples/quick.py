"""A reward of one's own.

reachlab train --import quick.py --reward quick --out runs/quick
"""

from __future__ import annotations

from typing import Any

from jax import Array

from reachlab.tasks.judging import Outcome
from reachlab.tasks.rewards import REWARDS


def quick(rules: Any, outcome: Outcome) -> dict[str, Array]:
    """Coming closer pays, arriving pays, and each step costs."""
    return {
        "approach": rules.approach_weight * (outcome.gap_before - outcome.gap),
        "reach": 1.0 * outcome.gained,
        "time": -0.001 * ~outcome.near,
    }


REWARDS["quick"] = quick
