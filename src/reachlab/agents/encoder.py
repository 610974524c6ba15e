"""From a picture to features: a small network of matrix products, which XLA computes well on the CPU."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
from jax import Array

PATCH = 6
"""Side of the squares into which a picture is cut [pixels]. Cut, not convolved: on the CPU the gradient of one strided
convolution takes four times as long as this whole network's."""

CHANNELS, WIDTH, FEATURES = 24, 128, 32
"""Numbers that are kept of a square, width of the layer over all squares, and features that come out."""

WHITE = 255.0
"""Value of a white pixel."""

Layers = list[tuple[Array, Array]]
"""Layers of a network, each `(weight [i, o], bias [o])`."""


def make_encoder(key: Array, size: int) -> Layers:
    """Untrained encoder of pictures of `size` × `size` pixels; `size` is a multiple of `PATCH`."""
    squares = (size // PATCH) ** 2
    shapes = ((PATCH**2, CHANNELS), (squares * CHANNELS, WIDTH), (WIDTH, FEATURES))
    gains = (math.sqrt(2), math.sqrt(2), 1.0)  # He et al., arXiv:1502.01852, for rectified layers
    return [
        (gain / math.sqrt(shape[0]) * jax.random.normal(one, shape), jnp.zeros(shape[1]))
        for one, gain, shape in zip(jax.random.split(key, len(shapes)), gains, shapes, strict=True)
    ]


def encode(layers: Layers, picture: Array) -> Array:
    """Features `[..., FEATURES]` of pictures `[..., SIZE, SIZE]` uint8."""
    (patches, bias), (gather, bias_2), (output, bias_3) = layers
    *batch, height, width = picture.shape
    x = picture.reshape(-1, height // PATCH, PATCH, width // PATCH, PATCH).transpose(0, 1, 3, 2, 4)
    x = x.reshape(-1, PATCH**2).astype(jnp.float32) / WHITE - 0.5
    x = jax.nn.relu(x @ patches + bias).reshape(-1, gather.shape[0])
    x = jax.nn.relu(x @ gather + bias_2)
    return (x @ output + bias_3).reshape(*batch, -1)
