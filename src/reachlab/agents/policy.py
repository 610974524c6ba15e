"""The policy: two networks, a Gaussian head and the observation normaliser, as one pytree."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.agents.encoder import Encoder, Keypoints, Layers, Squares
from reachlab.robots.kinematics.forward import added
from reachlab.settings.validation import InputError
from reachlab.tasks.schema import SIZE, Observed, Schema
from reachlab.tasks.task import Bounds

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
    """Layers of actor and critic, `log_std [a]`, and the encoder where observations hold a picture."""

    actor: Layers
    critic: Layers
    log_std: Array
    encoder: Encoder | None = None


class Inputs(NamedTuple):
    """Inputs of the networks: a picture `[..., SIZE, SIZE]` uint8 and a normalised vector `[..., k]`, or one."""

    picture: Array | None
    vector: Array | None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Normaliser:
    """Running mean `[k]` and variance `[k]` of the vectors in `count` observations; pictures stay as they are."""

    mean: Array
    variance: Array
    count: Array

    def __call__(self, vector: Array) -> Array:
        """Vector `[..., k]` of mean 0 and variance 1, clipped."""
        scaled = (vector - self.mean) / (jnp.sqrt(self.variance) + SMALLEST_STD)
        return jnp.clip(scaled, -OBSERVATION_CLIP, OBSERVATION_CLIP)

    def update(self, vectors: Array | None, n: int) -> Normaliser:
        """Normaliser of `n` more observations, with vectors `[n, k]` in them if they have any.

        Merging of moments: Chan, Golub, LeVeque, "Updating formulae and a pairwise algorithm for computing
        sample variances", 1979.
        """
        if vectors is None:
            return replace(self, count=self.count + n)
        mean, variance = vectors.mean(0), vectors.var(0)
        count = self.count + n
        shift = mean - self.mean
        moment = self.variance * self.count + variance * n + shift**2 * (self.count * n / count)
        return Normaliser(self.mean + shift * (n / count), moment / count, count)


class Gaussian(NamedTuple):
    """A diagonal Gaussian: `mean [..., a]`, `log_std [a]`."""

    mean: Array
    log_std: Array

    def sample(self, key: Array) -> Array:
        """A sample `[..., a]`."""
        return self.moved(jax.random.normal(key, self.mean.shape))

    def moved(self, noise: Array) -> Array:
        """The mean and so many standard deviations `[..., a]`."""
        return self.mean + jnp.exp(self.log_std) * noise

    def log_prob(self, value: Array) -> Array:
        """Log density `[...]` of `value [..., a]`."""
        scaled = (value - self.mean) * jnp.exp(-self.log_std)
        terms = -0.5 * scaled**2 - self.log_std - 0.5 * math.log(2 * math.pi)
        return added(terms)

    def entropy(self) -> Array:
        """Differential entropy `[]`."""
        return (self.log_std + 0.5 * math.log(2 * math.pi * math.e)).sum()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Policy:
    """Actor and critic with all they need to be used.

    Networks work on normalised observations and on actions in halves of their box: the action is
    `centre + half · output`. The schema says what an observation is made of.

    Attributes:
        parameters: what is trained, of actor and critic.
        normaliser: mean and variance of the observations.
        centre: middle of the action's box `[a]`.
        half: half of its width `[a]`.
        schema: what an observation is made of.
    """

    parameters: Parameters
    normaliser: Normaliser
    centre: Array
    half: Array
    schema: Schema = field(metadata={"static": True})

    def act(self, observation: Observed, key: Array | None = None) -> Array:
        """Action `[..., a]` for an observation: the mean without a key, a sample with one."""
        head = distribution(self.parameters, self.inputs(observation))
        return self.action(head.mean if key is None else head.sample(key))

    def inputs(self, observation: Observed) -> Inputs:
        """Inputs of the networks, of an observation."""
        picture, vector = self.schema.split(observation)
        if vector is not None and jnp.shape(vector)[-1:] != (self.schema.vector_size,):
            names = ", ".join(field.name for field in self.schema.vectors)
            raise InputError(
                f"the policy observes {names}, {self.schema.vector_size} numbers, and got an array of shape"
                f" {jnp.shape(vector)}: give the environment the run's `observation`."
            )
        return Inputs(picture, None if vector is None else self.normaliser(vector))

    def observed(self, observation: Observed) -> Policy:
        """Policy whose normaliser knows a batch `[n, ...]` of observations more."""
        picture, vector = self.schema.split(observation)
        count = len(vector) if picture is None else len(picture)
        return replace(self, normaliser=self.normaliser.update(vector, count))

    def action(self, output: Array) -> Array:
        """Action `[..., a]` in the environment's units of a network output."""
        return self.centre + self.half * output


def features(parameters: Parameters, inputs: Inputs) -> Array:
    """Inputs of actor and critic `[..., f]`: the vector, and what the encoder makes of the picture."""
    picture, vector = inputs
    if picture is None or parameters.encoder is None:
        return cast("Array", vector)  # an observation has a picture or a vector
    encoded = parameters.encoder(picture)
    return encoded if vector is None else jnp.concatenate([encoded, vector], axis=-1)


def distribution(parameters: Parameters, inputs: Inputs) -> Gaussian:
    """Distribution of network outputs."""
    return Gaussian(_forward(parameters.actor, features(parameters, inputs)), parameters.log_std)


def value(parameters: Parameters, inputs: Inputs) -> Array:
    """Expected return `[...]`."""
    return _forward(parameters.critic, features(parameters, inputs))[..., 0]


def make_policy(
    key: Array,
    schema: Schema,
    action_bounds: Bounds,
    hidden: Sequence[int],
    initial_std: float,
    *,
    points: int = 0,
) -> Policy:
    """Untrained policy for observations of a schema and actions with these lower and upper bounds `[a]`.

    Where the observation holds a picture the policy has an encoder, which finds so many `points` in it or, with 0, sees
    it as a whole.
    """
    low, high = (jnp.asarray(bound) for bound in action_bounds)
    k, a, encoder = schema.vector_size, len(low), None
    for_actor, for_critic, for_encoder = jax.random.split(key, 3)
    if schema.pictures:
        encoder = Keypoints.make(for_encoder, points) if points else Squares.make(for_encoder, SIZE)
    inputs = k + (encoder.features if encoder else 0)
    parameters = Parameters(
        actor=_layers(for_actor, (inputs, *hidden, a), ACTOR_OUTPUT_GAIN),
        critic=_layers(for_critic, (inputs, *hidden, 1), 1.0),
        log_std=jnp.full(a, math.log(initial_std), jnp.float32),
        encoder=encoder,
    )
    normaliser = Normaliser(jnp.zeros(k), jnp.ones(k), jnp.zeros(()))
    return Policy(parameters, normaliser, (low + high) / 2, (high - low) / 2, schema)


def _layers(key: Array, widths: Sequence[int], output_gain: float) -> Layers:
    """Layers with orthogonal weights (Saxe et al., arXiv:1312.6120)."""
    gains = [math.sqrt(2)] * (len(widths) - 2) + [output_gain]
    keys, sizes = jax.random.split(key, len(gains)), list(itertools.pairwise(widths))
    sampled = [jax.random.normal(one, (max(size), min(size))) for one, size in zip(keys, sizes, strict=True)]
    weights = zip(gains, sizes, _orthonormal(sampled), strict=True)
    return [(gain * (q if i >= o else q.T), jnp.zeros(o)) for gain, (i, o), q in weights]


def _orthonormal(matrices: Sequence[Array]) -> list[Array]:
    """Matrices `[m, n]`, n ≤ m, each made orthonormal column by column, from the first on.

    By Gram and Schmidt, twice, which is enough (Giraud et al., 2005), in one loop for all of them. A decomposition of
    JAX's needs LAPACK, for which it imports SciPy: 0.7 s of each training.
    """
    longest, most = (max(matrix.shape[axis] for matrix in matrices) for axis in (0, 1))
    padded = [jnp.pad(x, ((0, longest - x.shape[0]), (0, most - x.shape[1]))) for x in matrices]

    def orthonormalise(i: Any, q: Array) -> Array:
        column, earlier = q[:, :, i], jnp.where(jnp.arange(most) < i, q, 0.0)
        for _ in range(2):
            column -= jnp.einsum("kmn,kn->km", earlier, jnp.einsum("kmn,km->kn", earlier, column))
        length = jnp.linalg.norm(column, axis=1, keepdims=True)
        return q.at[:, :, i].set(column / jnp.maximum(length, jnp.finfo(q.dtype).tiny))  # what was padded is zero

    done = jax.lax.fori_loop(0, most, orthonormalise, jnp.stack(padded))
    return [q[: x.shape[0], : x.shape[1]] for q, x in zip(done, matrices, strict=True)]


def _forward(layers: Layers, x: Array) -> Array:
    for weight, bias in layers[:-1]:
        x = jnp.tanh(x @ weight + bias)
    weight, bias = layers[-1]
    return x @ weight + bias
