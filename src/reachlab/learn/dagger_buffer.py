"""The samples of DAgger: situations, the teacher's actions in them, and their pictures, drawn again when needed."""

from __future__ import annotations

import operator
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.agents.policy import Memory
from reachlab.control.situation import Goal
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.settings.config import DaggerConfig
from reachlab.sims.simulator import SimState
from reachlab.tasks.schema import SIZE

DRAWN_AT_ONCE = 1024
"""Pictures drawn in one call."""

SEQUENCE = 16
"""Samples in a row from which a student that remembers learns at once."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DaggerBuffer:
    """The last `N` samples, the oldest overwritten first.

    Attributes:
        arm: arms and what is beside them `[N, ...]`, without what an engine keeps.
        goal: what was asked for `[N, ...]`.
        key: random key of the episode `[N]`, which decides its view.
        vector: what was observed beside the picture `[N, k]`.
        label: the teacher's action `[N, a]`.
        count: samples so far `[]`.
        clock: its step in its episode `[N]`; None where a picture is learnt from whenever it was drawn.
        memory: what the student remembered before it `[N, M]`; None of one without memory.
    """

    arm: SimState
    goal: Goal
    key: Array
    vector: Array
    label: Array
    count: Array
    clock: Array | None = None
    memory: Memory = None


def make_buffer(state: EnvState, vector_size: int, capacity: int, *, dated: bool) -> DaggerBuffer:
    """Empty buffer of `capacity` samples of such a state, and of so many numbers beside the picture.

    With the clock where they are `dated`.
    """

    def empty(like: Array) -> Array:
        if jnp.issubdtype(like.dtype, jax.dtypes.prng_key):
            return jnp.broadcast_to(jax.random.key(0), (capacity,))
        return jnp.zeros((capacity, *like.shape[1:]), like.dtype)

    vector = jnp.zeros((1, vector_size))
    parts = state.apart.arm, state.goal, state.key, vector, state.last_action
    clock, memory = jax.tree.map(empty, (state.clock if dated else None, state.memory))
    return DaggerBuffer(*jax.tree.map(empty, parts), count=jnp.zeros((), jnp.int32), clock=clock, memory=memory)


def add(buffer: DaggerBuffer, state: EnvState, vector: Array, label: Array) -> DaggerBuffer:
    """Buffer with the situations of a state, the vectors `[B, k]` observed in them and labels `[B, a]` added."""
    num_envs, capacity = label.shape[0], buffer.label.shape[0]
    rows = (buffer.count + jnp.arange(num_envs)) % capacity
    clock = None if buffer.clock is None else state.clock
    new = DaggerBuffer(state.apart.arm, state.goal, state.key, vector, label, buffer.count, clock, state.memory)
    return jax.tree.map(lambda old, one: old.at[rows].set(one) if old.ndim else old + num_envs, buffer, new)


def sequences(key: Array, count: int, known: int, num_envs: int, settings: DaggerConfig) -> np.ndarray:
    """Rows `[updates, L, b]` of a buffer: sequences of samples of one environment each, of random ones."""
    length = min(SEQUENCE, known // num_envs)
    size = (settings.updates, 1, max(settings.batch // length, 1))
    first = jax.random.randint(key, size, count - known, count - (length - 1) * num_envs)
    return (np.asarray(first) + num_envs * np.arange(length)[:, None]) % settings.capacity


class Pictures:
    """The pictures of a buffer: a thousand times larger, so checkpoints leave them out, and they are drawn again."""

    def __init__(self, env: Env, capacity: int) -> None:
        """Room for `capacity` pictures."""
        self._env = env
        self._pictures = np.zeros((capacity, SIZE, SIZE), np.uint8)
        self._count = 0

    def add(self, pictures: np.ndarray) -> None:
        """Put in the pictures `[B, SIZE, SIZE]` of what is added next."""
        self._pictures[(self._count + np.arange(len(pictures))) % len(self._pictures)] = pictures
        self._count += len(pictures)

    def complete(self, buffer: DaggerBuffer) -> None:
        """Draw what the buffer holds and is missing here: all, after a run is resumed."""
        if self._count == (count := int(buffer.count)):
            return
        for first in range(0, min(count, len(self._pictures)), DRAWN_AT_ONCE):
            rows = slice(first, min(first + DRAWN_AT_ONCE, count, len(self._pictures)))
            parts = buffer.arm, buffer.goal, buffer.key, buffer.clock
            arm, goal, key, clock = jax.tree.map(operator.itemgetter(rows), parts)
            seen = np.flatnonzero(self._env.goal_seen(key, clock))
            self._pictures[rows][seen] = self._env.render_situations(arm, goal, key, seen)
        self._count = count

    def __getitem__(self, rows: np.ndarray) -> np.ndarray:
        """Pictures `[m, SIZE, SIZE]` of the rows `[m]` of the buffer."""
        return self._pictures[rows]
