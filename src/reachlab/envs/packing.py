"""Batches of numbers packed into one array: a compiled program that takes and gives one is called in half the time."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.jax_setup import jit


class Packing:
    """How a pytree of arrays with a batch in front lies in one array `[B, columns]` uint32, as the bits of its numbers.

    Attributes:
        columns: of the array.
        in_jax: `unpack`, compiled.
    """

    def __init__(self, example: Any) -> None:
        """Packing of pytrees that are like an example: of arrays, or of their shapes and types."""
        leaves, self._structure = jax.tree.flatten(example)
        self._leaves = [(leaf.shape, leaf.dtype) for leaf in leaves]
        widths = [math.prod(jax.eval_shape(_bits, leaf).shape[1:]) for leaf in leaves]
        self._starts = np.cumsum([0, *widths]).tolist()
        self.columns: int = self._starts[-1]
        self.in_jax = jit(self.unpack)

    def pack(self, tree: Any) -> Array:
        """The array of a pytree."""
        leaves = [_bits(leaf) for leaf in jax.tree.leaves(tree)]
        return jnp.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1)

    def unpack(self, packed: Array) -> Any:
        """The pytree of an array, in JAX."""
        return self._unflattened(packed, _numbers)

    def taken(self, packed: Array, in_numpy: bool) -> Any:
        """The pytree of an array outside JAX's traces: as NumPy arrays of its own, or as JAX arrays."""
        return self._unflattened(np.asarray(packed), _numpy_numbers) if in_numpy else self.in_jax(packed)

    def _unflattened(self, packed: Any, numbers: Any) -> Any:
        columns = zip(self._starts, self._starts[1:], self._leaves, strict=False)
        leaves = [numbers(packed[:, start:end], shape, dtype) for start, end, (shape, dtype) in columns]
        return jax.tree.unflatten(self._structure, leaves)


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


def _numpy_numbers(columns: np.ndarray, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """The same in NumPy, of all but keys."""
    return columns.reshape(shape) != 0 if dtype.kind == "b" else columns.copy().view(dtype).reshape(shape)
