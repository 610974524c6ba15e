"""Measurements that come late, at uneven times, or not at all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.control.bodies import Bodies, turned
from reachlab.envs import random_streams as streams
from reachlab.sims.simulator import SimState

JITTER = 0.01
"""By how much more than a control period a measurement is old at most [s]; never by more than another period."""

LOST = 0.05
"""Share of the measurements that do not come: then the one before is all that is known."""

LATEST, UNSEEN = 3, 0.1
"""By how many steps a sight of bodies is late at most, and what share of them do not come."""

KEPT = 8
"""Steps for which bodies are kept: so many sights in a row are hardly ever lost."""

OBJECT_ERROR = (0.005, 0.005, 0.005, 0.087)
"""Largest errors of a measured object, where objects vary: in x, y, z [m] and yaw [rad], 5 mm and 5 degrees."""

WRENCH_NOISE = (0.1, 0.1, 0.1, 0.005, 0.005, 0.003)
"""Standard deviations of a measured wrench, where dynamics vary [N, Nm]: about those of Robotiq's sensor FT 300."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sensed:
    """Joints as far as they are known, and what they did a control period ago, `[B, n]` each."""

    q: Array
    qd: Array
    past_q: Array
    past_qd: Array


def age(period: float) -> float:
    """Mean age of a measurement of the joints [s], where it comes late."""
    return period + min(JITTER, period) / 2


def sense(before: Sensed, arm: SimState, keys: Array, clock: Array, period: float) -> Sensed:
    """Joints as known after a step `[B]` of the episodes with `keys [B]`, before which the arms were as `arm` says.

    A measurement is a control period old, and up to `JITTER` more.
    """
    random = jax.vmap(lambda key: jax.random.uniform(key, (2,)))(streams.step_keys(keys, clock, streams.DELAY_STREAM))
    older = random[:, :1] * min(JITTER / period, 1.0)
    lost = random[:, 1:] < LOST
    q = jnp.where(lost, before.q, arm.q + older * (before.past_q - arm.q))
    qd = jnp.where(lost, before.qd, arm.qd + older * (before.past_qd - arm.qd))
    return Sensed(q, qd, arm.q, arm.qd)


def goal_seen(rules: Any, keys: Array, clock: Array) -> Array:
    """Whether the goal is seen at the steps `clock [...]` of the episodes with `keys [...]`."""
    sampled = jax.vmap(jax.random.uniform)(streams.step_keys(keys.ravel(), clock.ravel(), streams.GOAL_STREAM))
    lost = sampled.reshape(clock.shape) < rules.goal_lost
    return ~lost if rules.goal_steps is None else ~lost & (clock < rules.goal_steps)


def felt(wrench: Array, keys: Array, clock: Array) -> Array:
    """Wrenches `[B, 6]` as they are measured at the steps `clock [B]` of the episodes with `keys [B]`."""
    of_step = streams.step_keys(keys, clock, streams.WRENCH_STREAM)
    noise = jax.vmap(lambda key: jax.random.normal(key, wrench.shape[1:]))(of_step)
    return wrench + jnp.array(WRENCH_NOISE) * noise


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sight:
    """What is beside the arms as it was in the last steps `[B, KEPT, K]`, the latest first; which is known `[B]`."""

    past: Bodies
    age: Array

    @classmethod
    def of(cls, bodies: Bodies) -> Sight:
        """Sight of bodies `[B, K]` that have been at rest."""
        past = jax.tree.map(lambda x: jnp.repeat(x[:, None], KEPT, axis=1), bodies)
        return cls(past, jnp.zeros(len(bodies.kind), jnp.int32))

    def after(self, bodies: Bodies, keys: Array, clock: Array) -> Sight:
        """Sight after a step `[B]` of the episodes with `keys [B]` that brought bodies `[B, K]` to where they are.

        One is late by one to `LATEST` steps. Of what comes out of turn the latest is known.
        """
        of_step = streams.step_keys(keys, clock, streams.SIGHT_STREAM)
        random = jax.vmap(lambda key: jax.random.uniform(key, (2,)))(of_step)
        late = 1 + (LATEST * random[:, 0]).astype(jnp.int32)
        age = jnp.where(random[:, 1] < UNSEEN, self.age + 1, jnp.minimum(self.age + 1, late))
        past = jax.tree.map(lambda x, old: jnp.concatenate([x[:, None], old[:, :-1]], axis=1), bodies, self.past)
        return Sight(past, jnp.minimum(age, KEPT - 1))

    @property
    def known(self) -> Bodies:
        """Bodies `[B, K]` as far as they are known."""
        return jax.tree.map(lambda x: jax.vmap(lambda rows, age: rows[age])(x, self.age), self.past)


def misplaced(key: Array, bodies: Bodies) -> Bodies:
    """Bodies `[K]` as a camera might measure them: `OBJECT_ERROR` off in place and yaw, the same for all an episode."""
    sampled = jax.random.uniform(jax.random.fold_in(key, streams.PLACE_STREAM), (len(bodies.kind), 4), minval=-1.0)
    off = sampled * jnp.array(OBJECT_ERROR)
    return replace(bodies, position=bodies.position + off[:, :3], quaternion=turned(bodies.quaternion, off[:, 3]))
