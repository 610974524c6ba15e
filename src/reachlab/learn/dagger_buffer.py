"""What a student remembers: situations, what its teacher said of them, and the pictures, drawn again when needed."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.envs.core import Env, EnvState
from reachlab.tasks.reach import SIZE

DRAWN_AT_ONCE = 1024
"""Pictures drawn in one call."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Memory:
    """The last `N` situations seen, the oldest overwritten first.

    Attributes:
        q: joints `[N, n]` [rad or m].
        target: `[N, 3]` [m].
        tool: position of the tool `[N, 3]` [m].
        key: random key of the episode `[N]`, which decides its view.
        label: the teacher's action `[N, a]`.
        count: situations seen so far `[]`.
    """

    q: Array
    target: Array
    tool: Array
    key: Array
    label: Array
    count: Array


def make_memory(state: EnvState, capacity: int) -> Memory:
    """Empty memory of `capacity` situations of such a state."""

    def empty(like: Array) -> Array:
        return jnp.zeros((capacity, *like.shape[1:]), like.dtype)

    return Memory(
        q=empty(state.arm.q),
        target=empty(state.target),
        tool=empty(state.arm.tool_position),
        key=jnp.broadcast_to(jax.random.key(0), (capacity,)),
        label=empty(state.last_action),
        count=jnp.zeros((), jnp.int32),
    )


def remember(memory: Memory, state: EnvState, label: Array) -> Memory:
    """Memory that also holds the situations of a state's lanes and their labels `[B, a]`."""
    lanes, capacity = label.shape[0], memory.q.shape[0]
    rows = (memory.count + jnp.arange(lanes)) % capacity
    return Memory(
        q=memory.q.at[rows].set(state.arm.q),
        target=memory.target.at[rows].set(state.target),
        tool=memory.tool.at[rows].set(state.arm.tool_position),
        key=memory.key.at[rows].set(state.key),
        label=memory.label.at[rows].set(label),
        count=memory.count + lanes,
    )


class Album:
    """The pictures of a memory: a thousand times larger, so checkpoints leave them out, and they are drawn again."""

    def __init__(self, env: Env, capacity: int) -> None:
        """Empty album of `capacity` pictures."""
        self._env = env
        self._pictures = np.zeros((capacity, SIZE, SIZE), np.uint8)
        self._count = 0

    def add(self, pictures: np.ndarray) -> None:
        """Put in the pictures `[B, SIZE, SIZE]` of what is remembered next."""
        self._pictures[(self._count + np.arange(len(pictures))) % len(self._pictures)] = pictures
        self._count += len(pictures)

    def complete(self, memory: Memory) -> None:
        """Draw what the memory holds and the album lacks: all, after a run is gone on with."""
        if self._count == (count := int(memory.count)):
            return
        for first in range(0, min(count, len(self._pictures)), DRAWN_AT_ONCE):
            rows = slice(first, min(first + DRAWN_AT_ONCE, count, len(self._pictures)))
            self._pictures[rows] = self._env.draw(memory.q[rows], memory.target[rows], memory.key[rows])
        self._count = count

    def __getitem__(self, rows: np.ndarray) -> np.ndarray:
        """Pictures `[m, SIZE, SIZE]` of the rows `[m]` of the memory."""
        return self._pictures[rows]
