"""Episodes whose goals take long to find, sampled a few at a time."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jax import Array

from reachlab.control.situation import Goal

if TYPE_CHECKING:
    from reachlab.sims.simulator import Begin

TOGETHER = 8
"""Episodes that are sampled by one call: few, since all of them wait for the one that takes most draws; and always as
many, since the program takes longer to compile than to run."""


def in_parts(
    sample_episode: Callable[[Array, Goal | None, Array | bool], Begin],
    compiled: Callable[[Callable[..., Any]], Callable[..., Any]],
) -> Callable[[Array, Goal | None, np.ndarray, bool], Begin]:
    """Function that samples what episodes of a `mask [B]` begin with; what it gives for the others means nothing.

    Otherwise it is as `sample_episode` is, see `EnvFunctions.sample_episode`. `compiled` compiles a
    function.
    """

    # Keys travel as their bits, which NumPy can hold.
    def sample(bits: Array, goal: Goal | None, held_out: Array) -> Begin:
        begin = sample_episode(jax.random.wrap_key_data(bits), goal, held_out)
        return begin._replace(key=jax.random.key_data(begin.key))

    compiled_sample = compiled(sample)

    def sample_some(keys: Array, goal: Goal | None, mask: np.ndarray, held_out: bool) -> Begin:
        given = jax.tree.map(np.asarray, (jax.random.key_data(keys), goal))
        rows, together = np.flatnonzero(mask), min(TOGETHER, len(keys))
        parts = np.resize(rows, (max(-(-len(rows) // together), 1), together))
        sampled = [compiled_sample(*jax.tree.map(itemgetter(part), given), np.bool_(held_out)) for part in parts]
        place = np.zeros(len(keys), int)
        place[rows] = np.arange(len(rows))
        begin: Begin = jax.tree.map(lambda *x: np.concatenate(x)[place], *sampled)
        return begin._replace(key=jax.random.wrap_key_data(begin.key))

    return sample_some
