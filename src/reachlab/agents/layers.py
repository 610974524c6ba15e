"""Fully connected layers: how they begin, and what they compute."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

Layers = list[tuple[Array, Array]]
"""Layers of a network, each `(weight [i, o], bias [o])`."""


def make_layers(key: Array, widths: Sequence[int], output_gain: float) -> Layers:
    """Layers with orthogonal weights (Saxe et al., arXiv:1312.6120)."""
    gains = [math.sqrt(2)] * (len(widths) - 2) + [output_gain]
    keys, sizes = jax.random.split(key, len(gains)), list(itertools.pairwise(widths))
    sampled = [jax.random.normal(one, (max(size), min(size))) for one, size in zip(keys, sizes, strict=True)]
    weights = zip(gains, sizes, orthonormal(sampled), strict=True)
    return [(gain * (q if i >= o else q.T), jnp.zeros(o)) for gain, (i, o), q in weights]


def orthonormal(matrices: Sequence[Array]) -> list[Array]:
    """Matrices `[m, n]`, n ≤ m, each made orthonormal column by column, from the first on.

    By Gram and Schmidt, twice, which is enough (Giraud et al., 2005), in one loop for all of them. A decomposition of
    JAX's needs LAPACK, for which it imports SciPy: 0.7 s of each training.
    """
    longest, most = (max(matrix.shape[axis] for matrix in matrices) for axis in (0, 1))
    padded = [jnp.pad(x, ((0, longest - x.shape[0]), (0, most - x.shape[1]))) for x in matrices]

    def orthonormalise(i: Any, q: Array) -> Array:
        column, earlier = q[:, :, i], jnp.where(jnp.arange(most) < i, q, 0.0)
        for _ in range(2):
            column -= jnp.einsum("kmn,kn->km", earlier, jnp.einsum("kmn,km->kn", earlier, column))
        length = jnp.linalg.norm(column, axis=1, keepdims=True)
        return q.at[:, :, i].set(column / jnp.maximum(length, jnp.finfo(q.dtype).tiny))  # what was padded is zero

    done = jax.lax.fori_loop(0, most, orthonormalise, jnp.stack(padded))
    return [q[: x.shape[0], : x.shape[1]] for q, x in zip(done, matrices, strict=True)]


def forward(layers: Layers, x: Array) -> Array:
    """Output `[..., o]` of layers with tanh between them, of inputs `[..., i]`."""
    for weight, bias in layers[:-1]:
        x = jnp.tanh(x @ weight + bias)
    weight, bias = layers[-1]
    return x @ weight + bias
