"""Random keys: which of them is for what, so that none is used twice.

A seed has streams, and a stream has a key for each of its episodes. In JAX `split(key, n)[i]` is `fold_in(key, i)`: an
episode's key is split into `PARTS` keys when the episode is sampled, and what varies within the episode is folded in
with numbers that no split reaches.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np
from jax import Array

from reachlab.settings.validation import InputError

TRAINING_STREAM, REPORT_STREAM, VALIDATION_STREAM, LEARNER_STREAM, GYMNASIUM_STREAM, RECORD_STREAM = range(6)
"""Streams of a seed: episodes of training, reports and validations; what the learner samples; Gymnasium's episodes, and
those that are recorded."""

PARTS = 4
"""Keys that an episode's key is split into: the next episode's, its target's, its start's and its arm's."""

VIEW_STREAM, NOISE_STREAM, AGENT_STREAM, CHAIN_STREAM, SCENE_STREAM, DELAY_STREAM, OBJECT_STREAM, PLACE_STREAM = (
    2**32 - 1 - i for i in range(8)
)
SIGHT_STREAM, GOAL_STREAM, WRENCH_STREAM, LAG_STREAM = (2**32 - 9 - i for i in range(4))
"""Streams of an episode's key beside these parts: its view, the noise of its measurements, what its agent samples,
where the next episode begins, its bodies, how late its measurements are, which objects it has, where they are
measured and how late, when its goal is seen, the noise of the wrench at its wrist, and its arm's lag."""


def checked_keys(keys: Any) -> Array:
    """Keys `[B]` as they are, typed or of old kind.

    Raises:
        InputError: they are none.
    """
    typed = jax.numpy.issubdtype(getattr(keys, "dtype", object), jax.dtypes.prng_key)
    if len(getattr(keys, "shape", ())) != 2 - typed:
        raise InputError(
            "environments begin by a key each, as jax.random.split(jax.random.key(0), env.num_envs), got"
            f" {type(keys).__name__} of shape {getattr(keys, 'shape', ())}."
        )
    return keys


def stream_key(seed: int | Array, stream: int) -> Array:
    """Key of one of a seed's streams."""
    return jax.random.fold_in(jax.random.key(seed), stream)


def episode_keys(seed: int | Array, stream: int, first: int, count: int) -> Array:
    """Keys of the episodes `first ... first + count - 1` of a seed's stream; they depend on nothing else."""
    return _episode_keys(np.uint32(seed) if isinstance(seed, int) else seed, stream, first, count)


@functools.partial(jax.jit, static_argnames="count")
def _episode_keys(seed: Array, stream: int, first: int, count: int) -> Array:
    return jax.vmap(jax.random.fold_in, (None, 0))(stream_key(seed, stream), first + jax.numpy.arange(count))


def env_keys(seed: int, num_envs: int) -> Array:
    """Keys `[B]` of Gymnasium's episodes: environment i of seed s has the key of the first one of seed s + i."""
    return gymnasium_keys(np.arange(num_envs, dtype=np.uint32) + np.uint32(seed))


@jax.jit
def gymnasium_keys(seeds: np.ndarray | Array) -> Array:
    """Keys `[B]` of the first episodes of seeds `[B]` uint32."""
    return jax.vmap(lambda seed: stream_key(seed, GYMNASIUM_STREAM))(seeds)


@jax.jit
def keys_of_seeded(seeds: np.ndarray | Array, seeded: np.ndarray | Array, keys: Array) -> Array:
    """Keys `[B]` of the next episodes: the first ones of their seeds where `seeded [B]`, or those of `keys [B]`."""
    return jax.numpy.where(seeded, gymnasium_keys(seeds), keys)


def step_keys(keys: Array, clock: Array, stream: int) -> Array:
    """Keys `[B]` of one of these streams at the steps `clock [B]` of the episodes with `keys [B]`."""
    return jax.vmap(lambda key, step: jax.random.fold_in(jax.random.fold_in(key, stream), step))(keys, clock)
