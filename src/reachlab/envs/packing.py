"""How the numbers of a compiled program are handed over: each array by itself, or packed into one array."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.jax_setup import jit

MOST_SMALL, LEAST_LARGE = 16, 4096
"""Environments up to which, but for a single one, and from which on arrays are handed over by themselves.

A call takes 2 to 4 µs for each array that goes in or out, as long in all as the step of some hundred environments. Up
to 16 packing costs more than it saves: all arrays are of 512 bytes or less, and XLA runs such a program in one go,
where it hands others to its threads kernel by kernel. In large batches it is the copying that costs more.
"""


def make_packing(example: Any, num_envs: int) -> Apart | Packed:
    """The faster way to hand over pytrees that are like an example: of arrays, or of their shapes and types."""
    packs = num_envs == 1 or MOST_SMALL < num_envs < LEAST_LARGE
    return Packed(example) if packs else Apart(example)


class Apart:
    """A pytree handed over as it is."""

    def __init__(self, example: Any) -> None:
        """Pytrees that are like an example: of arrays, or of their shapes and types."""
        self._example = example

    def nothing(self) -> Any:
        """A pytree of zeros, packed."""
        return jax.tree.map(_zeros, self._example)

    def pack(self, tree: Any) -> Any:
        """A pytree, packed."""
        return tree

    def unpack(self, packed: Any) -> Any:
        """A packed pytree, in JAX."""
        return packed

    def taken(self, packed: Any, in_numpy: bool) -> Any:
        """A packed pytree outside JAX's traces: as NumPy arrays of its own, or as JAX arrays."""
        return jax.tree.map(np.array, packed) if in_numpy else packed


class Packed:
    """A pytree of arrays with a batch in front as one array `[B, columns]` uint32, the bits of its numbers."""

    def __init__(self, example: Any) -> None:
        """See `Apart`."""
        leaves, self._structure = jax.tree.flatten(example)
        shapes = [jax.eval_shape(_bits, leaf).shape for leaf in leaves]
        widths = [math.prod(shape[1:]) for shape in shapes]
        starts = np.cumsum([0, *widths]).tolist()
        self._shape = (shapes[0][0], starts[-1])
        self._leaves = [
            (slice(start, start + width) if len(shape) > 1 else start, leaf.shape, leaf.dtype)
            for start, width, shape, leaf in zip(starts, widths, shapes, leaves, strict=False)
        ]
        self._in_jax = jit(self.unpack)

    def nothing(self) -> np.ndarray:
        """See `Apart.nothing`."""
        return np.zeros(self._shape, np.uint32)

    def pack(self, tree: Any) -> Array:
        """See `Apart.pack`."""
        leaves = [_bits(leaf) for leaf in jax.tree.leaves(tree)]
        return jnp.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1)

    def unpack(self, packed: Array) -> Any:
        """See `Apart.unpack`."""
        leaves = [_numbers(packed[:, columns], shape, dtype) for columns, shape, dtype in self._leaves]
        return jax.tree.unflatten(self._structure, leaves)

    def taken(self, packed: Any, in_numpy: bool) -> Any:
        """See `Apart.taken`."""
        if not in_numpy:
            return self._in_jax(packed)
        numbers = np.asarray(packed)
        leaves = [_taken(numbers, columns, dtype) for columns, _, dtype in self._leaves]
        return jax.tree.unflatten(self._structure, leaves)


def _zeros(leaf: Any) -> Any:
    """Zeros of the leaf's shape and type; of keys such that nothing is made of them."""
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(jnp.zeros(jax.eval_shape(_bits, leaf).shape, jnp.uint32))
    return np.zeros(leaf.shape, leaf.dtype)


def _bits(leaf: Array) -> Array:
    """Numbers, truths or keys as uint32."""
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.key_data(leaf)
    return leaf.astype(jnp.uint32) if leaf.dtype.kind == "b" else jax.lax.bitcast_convert_type(leaf, jnp.uint32)


def _numbers(columns: Array, shape: tuple[int, ...], dtype: Any) -> Array:
    """The reverse of `_bits`."""
    if jnp.issubdtype(dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(columns)
    columns = columns.reshape(shape)
    return columns != 0 if dtype.kind == "b" else jax.lax.bitcast_convert_type(columns, dtype)


def _taken(packed: np.ndarray, columns: slice | int, dtype: np.dtype) -> np.ndarray:
    """The same in NumPy, of numbers of 32 bits and truths."""
    if dtype.kind == "b":
        return packed[:, columns] != 0
    return packed.view(dtype)[:, columns].copy()
