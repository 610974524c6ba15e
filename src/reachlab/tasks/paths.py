"""Paths of goals that move: lines, circles, smooth random ones, and jumps, as functions of the time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.kinematics.forward import added
from reachlab.settings.tables import Table
from reachlab.tasks.task import TaskSetup

LENGTH = 1 / 3
"""Lines go from the lower to the upper such share of the longest side of the box: no line is shorter."""

SMALLEST_RADIUS = 0.25
"""Of circles, as a share of the largest that fits into the box."""

HARMONICS = (1.0, 1.6, 2.3)
"""Frequencies that a smooth path is made of, as multiples of its lowest; no path repeats itself in an episode."""

INSTANTS = 64
"""Times at which the speed of a smooth path is looked at."""

DIRECTIONS = 64
"""Random directions of which a jump takes the first that stays inside the box."""

STAY = 1.5
"""Time from one jump to the next [s]."""


class Place(NamedTuple):
    """Where a goal is at a time: `position [..., 3]` m and `velocity [..., 3]` m/s."""

    position: Array
    velocity: Array


@dataclass(frozen=True)
class Path:
    """A kind of path.

    Attributes:
        summary: what it is.
        numbers: how many numbers `[numbers]` describe a path.
        sample: these, of a random key and the goal's speed [m/s]; the path is inside the box of goals.
        at: where the goal is, of these numbers and the time since the episode's begin [s].
    """

    summary: str
    numbers: Callable[[TaskSetup], int]
    sample: Callable[[TaskSetup, Array, Array], Array]
    at: Callable[[TaskSetup, Array, Array], Place]


# --- lines ----------------------------------------------------------------------------------------


def _sample_line(setup: TaskSetup, key: Array, speed: Array) -> Array:
    """The speed, and two ends: in the lower and the upper part of the box along its longest side."""
    low, high = setup.task.goal_box(setup)
    for_ends, for_swap = jax.random.split(key)
    ends = jax.random.uniform(for_ends, (2, 3), minval=low, maxval=high)
    longest = int(np.argmax(high - low))
    part = LENGTH * (high - low)[longest]
    shares = (ends[:, longest] - low[longest]) / (high - low)[longest]
    ends = ends.at[:, longest].set(jnp.array([low[longest], high[longest] - part]) + part * shares)
    ends = jnp.where(jax.random.bernoulli(for_swap), ends, ends[::-1])
    return jnp.concatenate([speed[None], ends.ravel()])


def _on_line(_setup: TaskSetup, numbers: Array, time: Array) -> Place:
    """There and back."""
    speed, begin, end = numbers[0], numbers[1:4], numbers[4:7]
    way = end - begin
    length = jnp.linalg.norm(way)
    gone = jnp.mod(speed * time / length, 2.0)
    ahead = gone < 1.0
    return Place(begin + jnp.where(ahead, gone, 2.0 - gone) * way, jnp.where(ahead, speed, -speed) / length * way)


# --- circles --------------------------------------------------------------------------------------


def _sample_circle(setup: TaskSetup, key: Array, speed: Array) -> Array:
    """The angular speed and phase, the centre, and two radii at a right angle."""
    low, high = setup.task.goal_box(setup)
    for_radius, for_axes, for_centre, for_phase = jax.random.split(key, 4)
    largest = float((high - low).min()) / 2
    radius = jax.random.uniform(for_radius, minval=SMALLEST_RADIUS * largest, maxval=largest)
    axes = _axes(jax.random.normal(for_axes, (3, 2)))
    centre = low + radius + jax.random.uniform(for_centre, (3,)) * (high - low - 2 * radius)
    phase = jax.random.uniform(for_phase, maxval=2 * jnp.pi)
    return jnp.concatenate([jnp.stack([speed / radius, phase]), centre, (radius * axes.T).ravel()])


def _axes(z: Array) -> Array:
    """The first factor of `z = QR` `[3, 2]` with the signs of LAPACK's `geqrf`, for which JAX imports SciPy."""
    one, other = z.T
    diagonal = -jnp.copysign(jnp.linalg.norm(one), one[0])
    mirror = one.at[0].add(-diagonal)  # Householder's: what it mirrors the second column to has the sign of its second
    mirrored = other - 2 * mirror * (mirror @ other) / (mirror @ mirror)
    first = one / diagonal
    second = other - first * (first @ other)
    return jnp.stack([first, -jnp.copysign(1.0, mirrored[1]) * second / jnp.linalg.norm(second)], axis=1)


def _on_circle(_setup: TaskSetup, numbers: Array, time: Array) -> Place:
    turn = numbers[0] * time + numbers[1]
    cos, sin = jnp.cos(turn), jnp.sin(turn)
    one, other = numbers[5:8], numbers[8:11]
    return Place(numbers[2:5] + cos * one + sin * other, numbers[0] * (cos * other - sin * one))


# --- smooth random paths --------------------------------------------------------------------------

WAVES = 3 * len(HARMONICS)


def _sample_smooth(setup: TaskSetup, key: Array, speed: Array) -> Array:
    """The lowest frequency, the centre, and amplitudes and phases of its waves in x, y and z.

    The frequency is such that the mean speed over a period of the lowest wave is that asked for. Other stretches of a
    path are up to a third slower or faster.
    """
    low, high = setup.task.goal_box(setup)
    for_size, for_amplitudes, for_centre, for_phases = jax.random.split(key, 4)
    half = (high - low) / 2
    reach = half * jax.random.uniform(for_size, (3,), minval=0.5)
    shares = jax.random.exponential(for_amplitudes, (3, len(HARMONICS)))
    amplitudes = reach[:, None] * shares / shares.sum(axis=1, keepdims=True)
    centre = low + reach + jax.random.uniform(for_centre, (3,)) * (high - low - 2 * reach)
    phases = jax.random.uniform(for_phases, (3, len(HARMONICS)), maxval=2 * jnp.pi)
    numbers = jnp.concatenate([jnp.ones(1), centre, amplitudes.ravel(), phases.ravel()])
    turns = jnp.linspace(0.0, 2 * jnp.pi, INSTANTS)
    mean = jax.vmap(lambda turn: jnp.linalg.norm(_on_smooth(setup, numbers, turn).velocity))(turns).mean()
    return numbers.at[0].set(speed / mean)


def _on_smooth(_setup: TaskSetup, numbers: Array, time: Array) -> Place:
    shape = (3, len(HARMONICS))
    amplitudes, phases = numbers[4 : 4 + WAVES].reshape(shape), numbers[4 + WAVES :].reshape(shape)
    rates = numbers[0] * jnp.array(HARMONICS)
    turns = rates * time + phases
    places, velocities = amplitudes * jnp.sin(turns), rates * amplitudes * jnp.cos(turns)
    return Place(numbers[1:4] + added(places), added(velocities))


# --- jumps ----------------------------------------------------------------------------------------


def _places(setup: TaskSetup) -> int:
    """Places at which a goal that jumps is in an episode."""
    return int(np.ceil(setup.rules.max_steps * setup.period / STAY)) + 1


def _sample_jumps(setup: TaskSetup, key: Array, _speed: Array) -> Array:
    """The places, each `goal_jump` from the one before; however fast other goals are."""
    low, high = setup.task.goal_box(setup)
    for_first, for_jumps = jax.random.split(key)

    def jump(place: Array, key: Array) -> tuple[Array, Array]:
        ways = jax.random.normal(key, (DIRECTIONS, 3))
        there = place + setup.rules.goal_jump * ways / jnp.linalg.norm(ways, axis=-1, keepdims=True)
        inside = ((there >= low) & (there <= high)).all(axis=-1)
        # From the middle of a small box no jump of that length stays inside: the longest one is taken that does.
        found = jnp.where(inside.any(), there[inside.argmax()], jnp.where(place < (low + high) / 2, high, low))
        return found, found

    first = jax.random.uniform(for_first, (3,), minval=low, maxval=high)
    _, others = jax.lax.scan(jump, first, jax.random.split(for_jumps, _places(setup) - 1))
    return jnp.concatenate([first, others.ravel()])


def _after_jumps(setup: TaskSetup, numbers: Array, time: Array) -> Place:
    # Half a period early, so that rounding does not decide between a jump and the next step.
    number = jnp.clip(((time + setup.period / 2) / STAY).astype(jnp.int32), 0, _places(setup) - 1)
    position = jax.lax.dynamic_slice(numbers, (3 * number,), (3,))
    return Place(position, jnp.zeros(3))


PATHS: dict[str, Path] = Table(
    {
        "line": Path("there and back on a line, at an even speed", lambda _: 7, _sample_line, _on_line),
        "circle": Path("round a circle, at an even speed", lambda _: 11, _sample_circle, _on_circle),
        "smooth": Path("along a smooth random path", lambda _: 4 + 2 * WAVES, _sample_smooth, _on_smooth),
        "jumps": Path(
            "to another place at once, again and again", lambda setup: 3 * _places(setup), _sample_jumps, _after_jumps
        ),
    }
)
"""Paths of goals by name."""


def sample_path(setup: TaskSetup, key: Array) -> Array:
    """A path `[1 + k]`: the number of its kind among the rules' `goal_paths`, and the numbers that describe it."""
    for_kind, for_speed, for_path = jax.random.split(key, 3)
    paths = [PATHS[name] for name in setup.rules.goal_paths]
    kind = jax.random.randint(for_kind, (), 0, len(paths))
    least, most = setup.rules.goal_speed
    speed = jax.random.uniform(for_speed, minval=least, maxval=most)
    size = max(path.numbers(setup) for path in paths)
    sampled = [path.sample(setup, for_path, speed) for path in paths]
    padded = jnp.stack([jnp.pad(numbers, (0, size - len(numbers))) for numbers in sampled])
    return jnp.concatenate([kind[None].astype(padded.dtype), padded[kind]])


def place_at(setup: TaskSetup, path: Array, clock: Array) -> Place:
    """Where goals on paths `[B, 1 + k]` are after `clock [B]` steps."""

    def one(path: Array, time: Array) -> Place:
        paths = [PATHS[name] for name in setup.rules.goal_paths]
        places = [kind.at(setup, path[1 : 1 + kind.numbers(setup)], time) for kind in paths]
        chosen = path[0].astype(jnp.int32)
        return jax.tree.map(lambda *each: jnp.stack(each)[chosen], *places)

    return jax.vmap(one)(path, clock * jnp.float32(setup.period))
