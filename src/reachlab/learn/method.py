"""What a way of learning is to the loop: a first state, and iterations that are judged by their numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.envs.core import Env
from reachlab.learn.rollout import Collect
from reachlab.settings.config import RunConfig


class Finite(NamedTuple):
    """For each kind of number whether all of them are finite, causes before what they lead to."""

    observation: bool
    action: bool
    reward: bool
    environment: bool
    gradient: bool
    loss: bool
    parameter: bool

    def missing(self) -> list[str]:
        """Kinds of which one number or more is not finite."""
        return [kind for kind, finite in self._asdict().items() if not finite]


class Watched(NamedTuple):
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
    def sound(self) -> bool:
        """Whether every number is finite."""
        return all(self.finite)


class Method(NamedTuple):
    """A way of learning.

    Attributes:
        load: what it learns from beside the environment, of the configuration and whether a run is resumed.
        initial_state: a pytree with a `Learner` as `learner` and an `EnvState` as `env`, of the environment, the
            configuration, the seed and what was loaded.
        compile_iteration: the function that gives the next state and what it is judged by, of the environment, the
            configuration, a state, or its shapes, and how experience is collected, by default in this process. If a
            number is not finite the state is the one before.
        shares: whether its experience can be collected elsewhere, by a `rollout.Collect`.
    """

    load: Callable[[RunConfig, bool], Any]
    initial_state: Callable[[Env, RunConfig, int | Array, Any], Any]
    compile_iteration: Callable[[Env, RunConfig, Any, Collect | None], Callable[[Any], tuple[Any, Watched]]]
    shares: bool = False


def all_finite(tree: object) -> bool:
    """Whether every number in a pytree is finite: on the host, as in a program it is a fifth of what is compiled."""
    floats = [leaf for leaf in jax.tree.leaves(tree) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    return all(bool(np.isfinite(leaf).all()) for leaf in floats)
