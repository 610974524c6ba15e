"""What episodes begin with: sampled all at once or, where goals take long to find, a few at a time."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jax import Array

from reachlab.control.situation import Goal
from reachlab.envs.packing import alike

if TYPE_CHECKING:
    from reachlab.sims.simulator import Begin

TOGETHER = 8
"""Episodes that are sampled by one call: few, since all of them wait for the one that takes most draws; and always as
many, since the program takes longer to compile than to run."""

SampleEpisode = Callable[[Array, Goal | None, Array | bool], "Begin"]
"""See `EnvFunctions.sample_episode`."""


class AllAtOnce:
    """What all episodes of a batch begin with, of `EnvFunctions.sample_episode`, compiled or to be traced."""

    def __init__(self, sample_episode: Any) -> None:
        """Sampler by this function."""
        self._sample = sample_episode

    def __call__(self, keys: Array, goal: Goal | None, _mask: Any, held_out: bool) -> Begin:
        """What they begin with, whatever the mask."""
        return self._sample(keys, goal, held_out)

    def ahead(self, keys: Array) -> Begin:
        """Shapes of what they begin with; what samples it is compiled beside."""
        return self._sample.ahead(keys, None, False)


class InParts:
    """What episodes of a `mask [B]` begin with; what it gives for the others means nothing."""

    def __init__(self, sample_episode: SampleEpisode, compiled: Callable[[Callable[..., Any]], Any]) -> None:
        """Sampler by this function, which `compiled` compiles."""

        # Keys travel as their bits, which NumPy can hold.
        def sample(bits: Array, goal: Goal | None, held_out: Array) -> Begin:
            begin = sample_episode(jax.random.wrap_key_data(bits), goal, held_out)
            return begin._replace(key=jax.random.key_data(begin.key))

        self._sample = compiled(sample)

    def __call__(self, keys: Array, goal: Goal | None, mask: Any, held_out: bool) -> Begin:
        """What they begin with."""
        given = jax.tree.map(np.asarray, (jax.random.key_data(keys), goal))
        rows, together = np.flatnonzero(mask), min(TOGETHER, len(keys))
        parts = np.resize(rows, (max(-(-len(rows) // together), 1), together))
        sampled = [self._sample(*jax.tree.map(itemgetter(part), given), np.bool_(held_out)) for part in parts]
        place = np.zeros(len(keys), int)
        place[rows] = np.arange(len(rows))
        begin: Begin = jax.tree.map(lambda *x: np.concatenate(x)[place], *sampled)
        return begin._replace(key=jax.random.wrap_key_data(begin.key))

    def ahead(self, keys: Array) -> Begin:
        """See `AllAtOnce.ahead`."""
        bits = jax.eval_shape(jax.random.key_data, keys)
        part = alike(bits, min(TOGETHER, len(keys)))
        begin: Begin = jax.tree.map(lambda x: alike(x, len(keys)), self._sample.ahead(part, None, np.bool_(False)))
        return begin._replace(key=alike(keys))
