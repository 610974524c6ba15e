"""The policy: two networks, a Gaussian head and the observation normaliser, as one pytree."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.agents.encoder import FEATURES, Layers, encode, make_encoder
from reachlab.tasks.reach import Observed

OBSERVATION_CLIP = 10.0
"""Normalised observations beyond this many standard deviations are clipped."""

SMALLEST_STD = 1e-4
"""Added to an observation's standard deviation, so that a constant one divides by no zero."""

ACTOR_OUTPUT_GAIN = 0.01
"""Scale of the actor's last layer at the start: first actions are near the centre of their box (Andrychowicz
et al., "What matters in on-policy reinforcement learning?", 2021)."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Parameters:
    """What is trained: layers of actor and critic, `log_std [a]`, and the encoder where there are pictures to see."""

    actor: Layers
    critic: Layers
    log_std: Array
    encoder: Layers | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Normaliser:
    """Running mean `[k]` and variance `[k]` of `count` observations; of their vectors, pictures stay as they are."""

    mean: Array
    variance: Array
    count: Array

    def __call__(self, observation: Observed) -> Observed:
        """Observation whose vector `[..., k]` has mean 0 and variance 1, clipped."""
        return _with_vector(observation, self._scaled)

    def _scaled(self, vector: Array) -> Array:
        scaled = (vector - self.mean) / (jnp.sqrt(self.variance) + SMALLEST_STD)
        return jnp.clip(scaled, -OBSERVATION_CLIP, OBSERVATION_CLIP)

    def update(self, observed: Observed) -> Normaliser:
        """Normaliser that has also seen vectors `[N, k]`.

        Merging of moments: Chan, Golub, LeVeque, "Updating formulae and a pairwise algorithm for computing
        sample variances", 1979.
        """
        picture, observations = parts(observed)
        if observations is None:
            return replace(self, count=self.count + len(picture))
        n = observations.shape[0]
        mean, variance = observations.mean(0), observations.var(0)
        count = self.count + n
        shift = mean - self.mean
        moment = self.variance * self.count + variance * n + shift**2 * (self.count * n / count)
        return Normaliser(self.mean + shift * (n / count), moment / count, count)


class Gaussian(NamedTuple):
    """A diagonal Gaussian: `mean [..., a]`, `log_std [a]`."""

    mean: Array
    log_std: Array

    def sample(self, key: Array) -> Array:
        """A draw `[..., a]`."""
        return self.mean + jnp.exp(self.log_std) * jax.random.normal(key, self.mean.shape)

    def log_prob(self, value: Array) -> Array:
        """Log density `[...]` of `value [..., a]`."""
        scaled = (value - self.mean) * jnp.exp(-self.log_std)
        terms = -0.5 * scaled**2 - self.log_std - 0.5 * math.log(2 * math.pi)
        return terms.sum(-1)

    def entropy(self) -> Array:
        """Differential entropy `[]`."""
        return (self.log_std + 0.5 * math.log(2 * math.pi * math.e)).sum()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Policy:
    """Actor and critic with all they need to be used.

    Networks work on normalised observations and on actions in halves of their box: the action is
    `centre + half · output`.
    """

    parameters: Parameters
    normaliser: Normaliser
    centre: Array
    half: Array

    def act(self, observation: Observed, key: Array | None = None) -> Array:
        """Action `[..., a]` for `observation [..., k]`: the mean without a key, a draw with one."""
        head = distribution(self.parameters, self.normaliser(observation))
        return self.action(head.mean if key is None else head.sample(key))

    def action(self, output: Array) -> Array:
        """Action `[..., a]` in the environment's units of a network output."""
        return self.centre + self.half * output


def parts(observation: Any) -> tuple[Any, Any]:
    """Picture and vector of an observation, each None if it has none."""
    leaves = jax.tree.leaves(observation)
    picture = next((leaf for leaf in leaves if leaf.dtype == jnp.uint8), None)
    return picture, next((leaf for leaf in leaves if leaf.dtype != jnp.uint8), None)


def _with_vector(observation: Observed, change: Callable[[Array], Array]) -> Observed:
    return jax.tree.map(lambda leaf: leaf if leaf.dtype == jnp.uint8 else change(leaf), observation)


def features(parameters: Parameters, normalised: Observed) -> Array:
    """What actor and critic are given `[..., f]`: the vector, and what the encoder makes of the picture."""
    picture, vector = parts(normalised)
    if parameters.encoder is None:
        return vector
    seen = encode(parameters.encoder, picture)
    return seen if vector is None else jnp.concatenate([seen, vector], axis=-1)


def distribution(parameters: Parameters, normalised: Observed) -> Gaussian:
    """Distribution of network outputs at normalised observations `[..., k]`."""
    return Gaussian(_forward(parameters.actor, features(parameters, normalised)), parameters.log_std)


def value(parameters: Parameters, normalised: Observed) -> Array:
    """Expected return `[...]` at normalised observations `[..., k]`."""
    return _forward(parameters.critic, features(parameters, normalised))[..., 0]


def make_policy(
    key: Array,
    observation_bounds: tuple[Any, Any],
    action_bounds: tuple[np.ndarray, np.ndarray],
    hidden: Sequence[int],
    initial_std: float,
) -> Policy:
    """Untrained policy for observations and actions with these lower and upper bounds, trees of `[k]` and `[a]`.

    Where the observation holds a picture, which its bounds tell by their type, the policy has an encoder.
    """
    low, high = (jnp.asarray(bound) for bound in action_bounds)
    picture, vector = parts(observation_bounds[0])
    k, a = 0 if vector is None else len(vector), len(low)
    inputs = k + (0 if picture is None else FEATURES)
    for_actor, for_critic, for_encoder = jax.random.split(key, 3)
    parameters = Parameters(
        actor=_layers(for_actor, (inputs, *hidden, a), ACTOR_OUTPUT_GAIN),
        critic=_layers(for_critic, (inputs, *hidden, 1), 1.0),
        log_std=jnp.full(a, math.log(initial_std), jnp.float32),
        encoder=None if picture is None else make_encoder(for_encoder, len(picture)),
    )
    normaliser = Normaliser(jnp.zeros(k), jnp.ones(k), jnp.zeros(()))
    return Policy(parameters, normaliser, (low + high) / 2, (high - low) / 2)


def _layers(key: Array, widths: Sequence[int], output_gain: float) -> Layers:
    gains = [math.sqrt(2)] * (len(widths) - 2) + [output_gain]
    keys = jax.random.split(key, len(gains))
    return [
        (jax.nn.initializers.orthogonal(gain)(one, (i, o)), jnp.zeros(o))
        for one, gain, i, o in zip(keys, gains, widths[:-1], widths[1:], strict=True)
    ]


def _forward(layers: Layers, x: Array) -> Array:
    for weight, bias in layers[:-1]:
        x = jnp.tanh(x @ weight + bias)
    weight, bias = layers[-1]
    return x @ weight + bias
