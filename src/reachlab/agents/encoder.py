"""From a picture or bodies to features: small networks of matrix products, which XLA computes well on the CPU."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.agents.layers import Layers

WHITE = 255.0
"""Value of a white pixel."""

PATCH, CHANNELS, WIDTH, FEATURES = 6, 24, 128, 32
"""Of `Squares`: side of a square [pixels], numbers that are kept of one, width of the layer over all of them, and
features that come out. Cut, not convolved: on the CPU the gradient of one strided convolution takes four times as long
as this whole network's."""

CELL, KEPT, SEEN = 4, 16, 32
"""Of `Keypoints`: side of a cell [pixels], numbers that are kept of one, and of one and those around it."""

OF_ROWS, DEEP = 128, 384
"""Of `Pooled`: numbers that are kept of all rows, and widths of the layers after them."""

SHARPNESS = 2.0
"""By what scores are multiplied where the place of a point is read from them."""

SPREAD = 3.0
"""How far from a point a cell may be that is taught to see it [pixels]."""

OFFSET_WEIGHT, PLACE_WEIGHT = 0.5, 1.0
"""Weights of how far from a point its cells place it, and of how far from it all cells together do [cells], beside that
of choosing the cell."""


class Layered:
    """What encoders share."""

    def __init__(self, layers: Layers) -> None:
        """Encoder of these layers."""
        self.layers = layers


class Squares(Layered):
    """Features of a whole picture: of each of its squares, then of all of them together."""

    @classmethod
    def make(cls, key: Array, size: int) -> Squares:
        """Untrained encoder of pictures of `size` × `size` pixels; `size` is a multiple of `PATCH`."""
        squares = (size // PATCH) ** 2
        return cls(_layers(key, ((PATCH**2, CHANNELS), (squares * CHANNELS, WIDTH), (WIDTH, FEATURES))))

    @property
    def features(self) -> int:
        """Numbers that come out."""
        return FEATURES

    def __call__(self, picture: Array) -> Array:
        """Features `[..., FEATURES]` of pictures `[..., SIZE, SIZE]` uint8."""
        (patches, bias), (gather, bias_2), (output, bias_3) = self.layers
        x = jax.nn.relu(_cut(picture, PATCH) @ patches + bias).reshape(-1, gather.shape[0])
        x = jax.nn.relu(x @ gather + bias_2)
        return (x @ output + bias_3).reshape(*picture.shape[:-2], -1)


class Keypoints(Layered):
    """Where points are in a picture: each cell says how surely it sees one, and how far from its middle.

    Scores and offsets of cells: Redmon et al., "You only look once", CVPR 2016; the expectation over cells: Levine et
    al., "End-to-end training of deep visuomotor policies", JMLR 2016.
    """

    @classmethod
    def make(cls, key: Array, points: int) -> Keypoints:
        """Untrained encoder that finds so many points."""
        return cls(_layers(key, ((CELL**2, KEPT), (9 * KEPT, SEEN), (9 * SEEN, SEEN), (SEEN, 3 * points))))

    @property
    def features(self) -> int:
        """Numbers that come out."""
        return self.layers[-1][1].shape[0] // 3 * 2

    def __call__(self, picture: Array) -> Array:
        """Points `[..., 2 P]` to the right and up in pictures `[..., SIZE, SIZE]` uint8, ±1 at the edges."""
        return _expected(*self._seen(picture)).reshape(*picture.shape[:-2], -1)

    def loss(self, picture: Array, points: Array) -> Array:
        """Loss `[]` of pictures `[m, SIZE, SIZE]` in which points `[m, 2 P]` are seen.

        It is the cross-entropy of the scores, where cells near a point are right, how far off these place it, and how
        far off all together do.
        """
        scores, places = self._seen(picture)
        half, points = picture.shape[-1] / 2, points.reshape(len(points), 1, -1, 2)
        near = jnp.square((middles(picture.shape[-1])[:, None] - points) * half).sum(axis=-1)
        wanted = jax.nn.softmax(-near / (2 * SPREAD**2), axis=-2)
        entropy = -(wanted * jax.nn.log_softmax(scores, axis=-2)).sum(axis=-2).mean()
        off = (wanted[..., None] * jnp.abs(places - points)).sum(axis=-3).mean()
        missed = jnp.abs(_expected(scores, places) - points[:, 0]).mean()
        return entropy + (OFFSET_WEIGHT * off + PLACE_WEIGHT * missed) * half / CELL

    def _seen(self, picture: Array) -> tuple[Array, Array]:
        """Scores `[m, cells, P]` and places `[m, cells, P, 2]` of the points, of each cell."""
        (cells, bias), *around, (output, bias_out) = self.layers
        size = picture.shape[-1]
        side = size // CELL
        x = jax.nn.relu(_cut(picture, CELL) @ cells + bias).reshape(-1, side, side, KEPT)
        for weight, bias in around:
            x = jax.nn.relu(_with_neighbours(x) @ weight + bias)
        out = (x @ output + bias_out).reshape(len(x), side**2, -1, 3)
        return out[..., 0], middles(size)[:, None] + out[..., 1:] * (2 * CELL / size)


def _expected(scores: Array, places: Array) -> Array:
    """Points `[m, P, 2]` of the scores `[m, cells, P]` and places `[m, cells, P, 2]` of cells."""
    return (jax.nn.softmax(SHARPNESS * scores, axis=-2)[..., None] * places).sum(axis=-3)


class Pooled(Layered):
    """Features of a vector and of rows whose order and number mean nothing, such as bodies.

    Of each row beside the vector, by two layers, the largest of each number over all rows, and of these beside the
    vector, by those after them: Zaheer et al., "Deep sets", NeurIPS 2017; Qi et al., "PointNet", CVPR 2017.
    """

    @classmethod
    def make(cls, key: Array, vector: int, row: int) -> Pooled:
        """Untrained encoder of a vector of so many numbers and rows of so many."""
        after = ((vector + OF_ROWS, DEEP), (DEEP, DEEP), (DEEP, DEEP))
        return cls(_layers(key, ((row + vector, OF_ROWS), (OF_ROWS, OF_ROWS), *after)))

    @property
    def features(self) -> int:
        """Numbers that come out."""
        return DEEP

    def __call__(self, vector: Array, rows: Array) -> Array:
        """Features `[..., DEEP]` of a vector `[..., k]` and rows `[..., K, row]`."""
        (first, bias), (second, bias_2), *after = self.layers
        row = rows.shape[-1]
        beside = vector @ first[row:] + bias
        each = jax.nn.relu(rows @ first[:row] + beside[..., None, :]) @ second + bias_2
        x = jnp.concatenate([vector, jnp.tanh(each.max(axis=-2))], axis=-1)
        for weight, bias in after:
            x = jax.nn.relu(x @ weight + bias)
        return x


Encoder = Squares | Keypoints | Pooled


def _with_keys(encoder: Encoder) -> tuple[list[tuple[Any, Any]], None]:
    return [(jax.tree_util.SequenceKey(i), layer) for i, layer in enumerate(encoder.layers)], None


for _kind in (Squares, Keypoints, Pooled):  # their arrays are named as those of a list of layers
    jax.tree_util.register_pytree_with_keys(
        _kind, _with_keys, lambda _, layers, kind=_kind: kind(list(layers)), lambda encoder: (encoder.layers, None)
    )


def _layers(key: Array, shapes: Sequence[tuple[int, int]]) -> Layers:
    gains = [math.sqrt(2)] * (len(shapes) - 1) + [1.0]  # He et al., arXiv:1502.01852, for rectified layers
    return [
        (gain / math.sqrt(shape[0]) * jax.random.normal(one, shape), jnp.zeros(shape[1]))
        for one, gain, shape in zip(jax.random.split(key, len(shapes)), gains, shapes, strict=True)
    ]


def _cut(picture: Array, side: int) -> Array:
    """Squares `[n, side²]` of pictures `[..., SIZE, SIZE]` uint8, in ±0.5."""
    height, width = picture.shape[-2:]
    x = picture.reshape(-1, height // side, side, width // side, side).transpose(0, 1, 3, 2, 4)
    return x.reshape(-1, side**2).astype(jnp.float32) / WHITE - 0.5


def _with_neighbours(x: Array) -> Array:
    """Of each cell `[m, n, n, c]` its numbers and those of the eight around it `[m, n, n, 9 c]`, 0 beyond the edge."""
    n, padded = x.shape[1], x
    for axis in (1, 2):
        edge = jnp.zeros_like(jax.lax.slice_in_dim(padded, 0, 1, axis=axis))
        padded = jnp.concatenate([edge, padded, edge], axis=axis)
    return jnp.concatenate([padded[:, i : i + n, j : j + n] for i in range(3) for j in range(3)], axis=-1)


def middles(size: int) -> Array:
    """Middles of the cells of a picture `[cells, 2]`, from the top, to the right and up."""
    middle = (jnp.arange(size // CELL) + 0.5) * (2 * CELL / size) - 1
    up, right = jnp.meshgrid(-middle, middle, indexing="ij")
    return jnp.stack([right, up], axis=-1).reshape(-1, 2)
