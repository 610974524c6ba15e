"""The policy: two networks, a Gaussian head and the observation normaliser, as one pytree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.agents.encoder import Encoder, Keypoints, Pooled, Squares
from reachlab.agents.layers import Layers, forward, make_layers
from reachlab.agents.memory import Cell
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
    """Layers of actor and critic, `log_std [a]`, the encoder of a picture or of rows if any, and the memory if any."""

    actor: Layers
    critic: Layers
    log_std: Array
    encoder: Encoder | None = None
    memory: Cell | None = None


Memory = Array | None
"""What a policy remembers `[..., M]`; None of one without memory."""


class Inputs(NamedTuple):
    """Inputs of the networks.

    Attributes:
        picture: `[..., SIZE, SIZE]` uint8; None where observations hold none.
        vector: normalised `[..., k]`; None where observations are a picture.
        memory: what is remembered before them `[..., M]`; None where nothing is. Before a sequence of inputs
            `[T, B, ...]`, `[1, B, M]`.
        begins: of such a sequence, with which of its inputs episodes begin `[T, B]`.
        rows: `[..., K, row]` as they are; None where observations hold none.
    """

    picture: Array | None
    vector: Array | None
    memory: Array | None = None
    begins: Array | None = None
    rows: Array | None = None


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

    def __repr__(self) -> str:
        """How many numbers it has, and what it observes; JAX may put something else in place of arrays."""
        count = sum(getattr(one, "size", 0) for one in jax.tree.leaves(self.parameters))
        return f"<Policy of {count:,} parameters>"

    def act(self, observation: Observed, key: Array | None = None) -> Array:
        """Action `[..., a]` for an observation: the mean without a key, a sample with one.

        Raises:
            InputError: the policy has a memory.
        """
        return self.decide(observation, None, key)[0]

    def initial(self, *batch: int) -> Memory:
        """What is remembered `[..., M]` at the start of episodes; None of a policy without memory."""
        cell = self.parameters.memory
        return None if cell is None else jnp.zeros((*batch, cell.size))

    def decide(self, observation: Observed, memory: Memory, key: Array | None = None) -> tuple[Array, Memory]:
        """Action `[..., a]` for an observation and what was remembered, and what is remembered then.

        The action is the mean without a key, a sample with one.

        Raises:
            InputError: what `reset` gives is given whole.
        """
        if isinstance(observation, tuple) and any(isinstance(part, dict) for part in observation):
            raise InputError("an observation is needed, got a tuple with infos: `observation, _ = env.reset()`.")
        if observation is None:
            raise InputError("an observation is needed, as of `env.reset()`, got None.")
        known = features(self.parameters, self.inputs(observation, memory))
        head = gaussian(self.parameters, known)
        return self.action(head.mean if key is None else head.sample(key)), remembered(self.parameters, known)

    def inputs(self, observation: Observed, memory: Memory = None) -> Inputs:
        """Inputs of the networks, of an observation and what is remembered."""
        if isinstance(observation, list | tuple):
            observation = jnp.asarray(observation, jnp.float32)
        picture, vector = self.schema.split(observation)
        if vector is not None and jnp.shape(vector)[-1:] != (self.schema.vector_size,):
            names = ", ".join(field.name for field in self.schema.vectors)
            raise InputError(
                f"the policy observes {names}, {self.schema.vector_size} numbers, and got an array of shape"
                f" {jnp.shape(vector)}: give the environment the run's `observation`."
            )
        rows = self.schema.rows(observation)
        return Inputs(picture, None if vector is None else self.normaliser(vector), memory, rows=rows)

    def observed(self, observation: Observed) -> Policy:
        """Policy whose normaliser knows a batch `[n, ...]` of observations more."""
        count = len(jax.tree.leaves(observation)[0])
        return replace(self, normaliser=self.normaliser.update(self.schema.split(observation)[1], count))

    def action(self, output: Array) -> Array:
        """Action `[..., a]` in the environment's units of a network output."""
        return self.centre + self.half * output


def encoded(parameters: Parameters, inputs: Inputs) -> Array:
    """The vector, and what the encoder makes of the picture `[..., f]`; or what it makes of vector and rows.

    A policy that remembers knows whether the picture came: of a black one all is 0, or else it would drive the gates of
    the memory to where they are not taught any more.
    """
    known: Any = inputs  # an encoder comes with what it encodes, and without one there is a vector
    picture, vector, rows = known.picture, known.vector, known.rows
    if isinstance(parameters.encoder, Pooled):
        return parameters.encoder(vector, rows)
    if parameters.encoder is None:
        return vector
    points = parameters.encoder(picture)
    if parameters.memory is not None:
        pixels = picture.reshape(*picture.shape[:-2], -1).astype(points.dtype)
        came = jnp.minimum(pixels @ jnp.ones((pixels.shape[-1], 1)), 1.0)
        points = jnp.concatenate([came * points, came], axis=-1)
    return points if vector is None else jnp.concatenate([points, vector], axis=-1)


def features(parameters: Parameters, inputs: Inputs) -> Array:
    """Inputs of actor and critic `[..., f]`: what is observed and, behind it, what is remembered then."""
    x, cell, memory = encoded(parameters, inputs), parameters.memory, inputs.memory
    if cell is None:
        return x
    if memory is None:
        raise InputError("this policy has to be given its memory: give its memory to `decide`, see `initial`.")
    after = cell(memory, x) if inputs.begins is None else cell.over(memory[0], x, inputs.begins)
    return jnp.concatenate([x, after], axis=-1)


def remembered(parameters: Parameters, known: Array) -> Memory:
    """What is remembered `[..., M]`, of features."""
    return None if parameters.memory is None else known[..., -parameters.memory.size :]


def gaussian(parameters: Parameters, known: Array) -> Gaussian:
    """Distribution of network outputs, of features."""
    return Gaussian(forward(parameters.actor, known), parameters.log_std)


def worth(parameters: Parameters, known: Array) -> Array:
    """Expected return `[...]`, of features."""
    return forward(parameters.critic, known)[..., 0]


def distribution(parameters: Parameters, inputs: Inputs) -> Gaussian:
    """Distribution of network outputs."""
    return gaussian(parameters, features(parameters, inputs))


def value(parameters: Parameters, inputs: Inputs) -> Array:
    """Expected return `[...]`."""
    return worth(parameters, features(parameters, inputs))


def make_policy(
    key: Array,
    schema: Schema,
    action_bounds: Bounds,
    hidden: Sequence[int],
    initial_std: float,
    *,
    points: int = 0,
    memory: int = 0,
) -> Policy:
    """Untrained policy for observations of a schema and actions with these lower and upper bounds `[a]`.

    Where the observation holds a picture the policy has an encoder, which finds so many `points` in it or, with 0, sees
    it as a whole; where it holds rows, one that pools them. It remembers so many numbers.
    """
    low, high = (jnp.asarray(bound) for bound in action_bounds)
    k, a, encoder = schema.vector_size, len(low), None
    for_actor, for_critic, for_encoder = jax.random.split(key, 3)
    if schema.pictures:
        encoder = Keypoints.make(for_encoder, points) if points else Squares.make(for_encoder, SIZE)
    inputs = k + (encoder.features if encoder else 0)
    if schema.row:
        encoder = Pooled.make(for_encoder, k, schema.row)
        inputs = encoder.features
    inputs += 1 if encoder and memory else 0
    cell = Cell.make(jax.random.fold_in(key, 3), inputs, memory) if memory else None
    inputs += memory
    parameters = Parameters(
        actor=make_layers(for_actor, (inputs, *hidden, a), ACTOR_OUTPUT_GAIN),
        critic=make_layers(for_critic, (inputs, *hidden, 1), 1.0),
        log_std=jnp.full(a, math.log(initial_std), jnp.float32),
        encoder=encoder,
        memory=cell,
    )
    normaliser = Normaliser(jnp.zeros(k), jnp.ones(k), jnp.zeros(()))
    return Policy(parameters, normaliser, (low + high) / 2, (high - low) / 2, schema)
