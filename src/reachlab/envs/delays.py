"""Measurements that come late, at uneven times, or not at all."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.envs.random_streams import delay_keys
from reachlab.sims.simulator import SimState

JITTER = 0.01
"""By how much more than a control period a measurement is old at most [s]; never by more than another period."""

LOST = 0.05
"""Share of the measurements that do not come: then the one before is all that is known."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sensed:
    """Joints as far as they are known, and what they did a control period ago, `[B, n]` each."""

    q: Array
    qd: Array
    past_q: Array
    past_qd: Array


def sense(before: Sensed, arm: SimState, keys: Array, clock: Array, period: float) -> Sensed:
    """Joints as known after a step `[B]` of the episodes with `keys [B]`, before which the arms were as `arm` says.

    A measurement is a control period old, and up to `JITTER` more.
    """
    random = jax.vmap(lambda key: jax.random.uniform(key, (2,)))(delay_keys(keys, clock))
    older = random[:, :1] * min(JITTER / period, 1.0)
    lost = random[:, 1:] < LOST
    q = jnp.where(lost, before.q, arm.q + older * (before.past_q - arm.q))
    qd = jnp.where(lost, before.qd, arm.qd + older * (before.past_qd - arm.qd))
    return Sensed(q, qd, arm.q, arm.qd)
