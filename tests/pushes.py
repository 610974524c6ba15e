"""Actions for comparisons of two environments."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def pushes(num_envs: int, steps: int) -> Iterator[np.ndarray]:
    """Actions that keep their direction long enough to leave the workspace or to reach the target."""
    random, actions = np.random.default_rng(1), np.zeros((num_envs, 3), np.float32)
    for step in range(steps):
        if step % 20 == 0:
            actions = random.uniform((-1.5, -1.5, -3.0), (1.5, 1.5, 0.8), (num_envs, 3)).astype(np.float32)
        yield actions
