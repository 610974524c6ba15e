"""Memory of a policy: a gated recurrent unit (Cho et al., arXiv:1406.1078)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.agents.layers import orthonormal

LONGEST = 200
"""Steps over which the numbers are kept at the start: from one to so many (Tallec and Ollivier, "Can recurrent neural
networks warp time?", ICLR 2018)."""


class Gate(NamedTuple):
    """Weights of the inputs `[k, M]` and of what is remembered `[M, M]`, and `bias [M]`, of a gate."""

    given: Array
    kept: Array
    bias: Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Cell:
    """A unit that remembers `M` numbers, of inputs `[k]`.

    The gates are arrays of their own: sliced from one they take three times as long in a loop on the CPU.

    Attributes:
        reset: what of that which is remembered counts for what is new.
        keep: what is kept.
        new: what is new.
        kept_bias: of what is remembered, before it counts for what is new `[M]`.
    """

    reset: Gate
    keep: Gate
    new: Gate
    kept_bias: Array

    @classmethod
    def make(cls, key: Array, inputs: int, size: int) -> Cell:
        """Untrained unit."""
        for_given, for_kept, for_keep = jax.random.split(key, 3)
        given = jax.random.normal(for_given, (3, inputs, size)) / math.sqrt(inputs)
        kept = orthonormal([jax.random.normal(one, (size, size)) for one in jax.random.split(for_kept, 3)])
        none, long = jnp.zeros(size), jnp.log(jax.random.uniform(for_keep, (size,), minval=1.0, maxval=LONGEST - 1.0))
        reset, keep, new = map(Gate, given, kept, (none, long, none))
        return cls(reset, keep, new, none)

    @property
    def size(self) -> int:
        """Numbers `M` that are remembered."""
        return self.kept_bias.shape[0]

    def __call__(self, memory: Array, x: Array) -> Array:
        """What is remembered `[..., M]` after inputs `[..., k]`, of what was before."""
        return self._after(memory, self._weighted(x))

    def over(self, memory: Array, x: Array, begins: Array) -> Array:
        """The same after each of the inputs `[T, B, k]`; what was before is forgotten where `begins [T, B]`."""

        def step(memory: Array, now: tuple[list[Array], Array]) -> tuple[Array, Array]:
            weighted, begins = now
            memory = self._after(jnp.where(begins[:, None], 0.0, memory), weighted)
            return memory, memory

        return jax.lax.scan(step, memory, (self._weighted(x), begins))[1]

    def _weighted(self, x: Array) -> list[Array]:
        """Inputs as each gate takes them, three `[..., M]`."""
        return [x @ gate.given + gate.bias for gate in (self.reset, self.keep, self.new)]

    def _after(self, memory: Array, weighted: list[Array]) -> Array:
        reset = jax.nn.sigmoid(weighted[0] + memory @ self.reset.kept)
        keep = jax.nn.sigmoid(weighted[1] + memory @ self.keep.kept)
        new = jnp.tanh(weighted[2] + reset * (memory @ self.new.kept + self.kept_bias))
        return new + keep * (memory - new)
