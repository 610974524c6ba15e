"""The samples of DAgger: situations, the teacher's actions in them, and their pictures, drawn again when needed."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.situation import Goal
from reachlab.envs.core import Env
from reachlab.envs.functions import EnvState
from reachlab.tasks.schema import SIZE

DRAWN_AT_ONCE = 1024
"""Pictures drawn in one call."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DaggerBuffer:
    """The last `N` samples, the oldest overwritten first.

    Attributes:
        q: joints `[N, n]` [rad or m].
        goal: `[N, 3]` [m].
        tool: position of the tool `[N, 3]` [m].
        key: random key of the episode `[N]`, which decides its view.
        label: the teacher's action `[N, a]`.
        count: samples so far `[]`.
    """

    q: Array
    goal: Array
    tool: Array
    key: Array
    label: Array
    count: Array


def make_buffer(state: EnvState, capacity: int) -> DaggerBuffer:
    """Empty buffer of `capacity` samples of such a state."""

    def empty(like: Array) -> Array:
        return jnp.zeros((capacity, *like.shape[1:]), like.dtype)

    return DaggerBuffer(
        q=empty(state.arm.q),
        goal=empty(state.goal.position),
        tool=empty(state.arm.tool_position),
        key=jnp.broadcast_to(jax.random.key(0), (capacity,)),
        label=empty(state.last_action),
        count=jnp.zeros((), jnp.int32),
    )


def add(buffer: DaggerBuffer, state: EnvState, label: Array) -> DaggerBuffer:
    """Buffer with the situations of a state and their labels `[B, a]` added."""
    num_envs, capacity = label.shape[0], buffer.q.shape[0]
    rows = (buffer.count + jnp.arange(num_envs)) % capacity
    return DaggerBuffer(
        q=buffer.q.at[rows].set(state.arm.q),
        goal=buffer.goal.at[rows].set(state.goal.position),
        tool=buffer.tool.at[rows].set(state.arm.tool_position),
        key=buffer.key.at[rows].set(state.key),
        label=buffer.label.at[rows].set(label),
        count=buffer.count + num_envs,
    )


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
            self._pictures[rows] = self._env.render_situations(
                buffer.q[rows], Goal.at(buffer.goal[rows]), buffer.key[rows]
            )
        self._count = count

    def __getitem__(self, rows: np.ndarray) -> np.ndarray:
        """Pictures `[m, SIZE, SIZE]` of the rows `[m]` of the buffer."""
        return self._pictures[rows]
