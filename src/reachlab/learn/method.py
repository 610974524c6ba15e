"""What a way of learning is to the loop: a first state, and iterations that are judged by their numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.envs.core import Env
from reachlab.learn.rollout import Collect
from reachlab.settings.config import RunConfig


class Finite(NamedTuple):
    """For each kind of number whether all of them are finite `[]`, causes before what they lead to."""

    observation: Array
    action: Array
    reward: Array
    environment: Array
    gradient: Array
    loss: Array
    parameter: Array

    def missing(self) -> list[str]:
        """Kinds of which one number or more is not finite."""
        return [kind for kind, finite in self._asdict().items() if not finite]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Watched:
    """What an iteration is judged by.

    Attributes:
        metrics: scalars of the rollout and of its update.
        finite: whether all numbers are finite.
        rollout: the experience as a pytree, to be looked into where they are not.
    """

    metrics: dict[str, Array]
    finite: Finite
    rollout: object

    @property
    def sound(self) -> Array:
        """Whether every number is finite."""
        return jnp.stack(self.finite).all()


class Method(NamedTuple):
    """A way of learning.

    Attributes:
        load: what it learns from beside the environment, of the configuration and whether a run is resumed.
        initial_state: a pytree with a `Learner` as `learner` and an `EnvState` as `env`, of the environment, the
            configuration, the seed and what was loaded.
        compile_iteration: the function that gives the next state and what it is judged by, of the environment, the
            configuration, a state, or its shapes, and how experience is collected, by default in this process. If a
            number is not finite the state is the one before. It may use up the state that it is given.
        shares: whether its experience can be collected elsewhere, by a `rollout.Collect`.
    """

    load: Callable[[RunConfig, bool], Any]
    initial_state: Callable[[Env, RunConfig, int | Array, Any], Any]
    compile_iteration: Callable[[Env, RunConfig, Any, Collect | None], Callable[[Any], tuple[Any, Watched]]]
    shares: bool = False


def all_finite(tree: object) -> Array:
    """Whether every number in a pytree is finite `[]`."""
    floats = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return jnp.array([jnp.isfinite(leaf).all() for leaf in floats], bool).all()
