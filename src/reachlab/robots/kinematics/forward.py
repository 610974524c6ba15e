"""Kinematics of a serial chain of hinge and slide joints: the tool's pose, and its Jacobian.

Every function takes joint vectors `[..., n]` with any leading shape and is traced by JAX; the work
is done on scalars (see `scalar_algebra`). Positions are in metres in the world frame, angles in radians,
quaternions unit and ordered w, x, y, z.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.scalars import (
    IDENTITY,
    ZERO,
    Rotation,
    Scalar,
    Vec,
    once,
    quaternion_from_rotation,
    total,
)
from reachlab.settings.validation import InputError


class Pose(NamedTuple):
    """A pose: `position [..., 3]` m and unit `quaternion [..., 4]` wxyz."""

    position: Array
    quaternion: Array


class Frames(NamedTuple):
    """World axes and origins of the joints, and the tool's pose."""

    axes: list[Vec]
    origins: list[Vec]
    rotation: Rotation
    position: Vec


def forward_kinematics(chain: Chain, q: ArrayLike) -> Pose:
    """Pose of the tool at joint vectors `q [..., n]`.

    Args:
        chain: the arm's joints, as `Robot.chain`.
        q: joints [rad or m].

    Raises:
        InputError: they are not as many as the chain's.
    """
    q = joint_vectors(chain, q)
    frames = frames_at(chain, components(q))
    return Pose(stack(frames.position, q), stack(quaternion_from_rotation(frames.rotation), q))


def jacobian(chain: Chain, q: ArrayLike) -> Array:
    """Geometric Jacobian `[..., 6, n]` of the tool in the world frame: linear rows, then angular.

    Raises:
        InputError: there are not as many joints as the chain's.
    """
    q = joint_vectors(chain, q)
    rows = jacobian_rows(chain, frames_at(chain, components(q)), q)
    return jnp.moveaxis(jnp.stack(rows), (0, 1), (-2, -1))


def joint_vectors(chain: Chain, q: ArrayLike) -> Array:
    """Joint vectors `[..., n]` as an array of floating-point numbers.

    Raises:
        InputError: they are not as many as the chain's, or it is none.
    """
    if not isinstance(chain, Chain):
        raise InputError(f"a chain is needed, as load_robot('panda').chain, got {type(chain).__name__}.")
    given = jnp.asarray([] if q is None else q)
    if given.shape[-1:] != (chain.n,):
        raise InputError(f"joint vectors have {chain.n} numbers in their last axis, and the shape is {given.shape}.")
    return given if jnp.issubdtype(given.dtype, jnp.floating) else given.astype(jnp.float32)


def angle_between(quaternion: Any, other: Any) -> Any:
    """Angle `[...]` rad between orientations `[..., 4]`, in arrays of NumPy or of JAX.

    By the arc sine of half the chord between the quaternions: the arc cosine of their product is blind near zero.
    """
    module: Any = np if isinstance(quaternion, np.ndarray) else jnp
    chords = [norm(other + sign * quaternion) for sign in (-1.0, 1.0)]
    return 4 * module.arcsin(module.minimum(module.minimum(*chords) / 2, 1.0))


def frames_at(chain: Chain, q: Sequence[Scalar]) -> Frames:
    """Frames at the joints `q`, one scalar a joint."""
    moved = _moved(chain, q)
    rotation, position = moved[-1][2:]
    turn, offset = chain.frames[-1]
    axes, origins = [axis for axis, *_ in moved], [origin for _, origin, *_ in moved]
    return once(Frames(axes, origins, rotation.compose(turn), position.plus(rotation.apply(offset))))


def link_frames(chain: Chain, q: Sequence[Scalar]) -> list[tuple[Rotation, Vec]]:
    """Rotations and positions [m] of the links at the joints `q`, one scalar a joint; see `Chain.links_at`."""
    return once([(IDENTITY, ZERO), *((rotation, position) for _, _, rotation, position in _moved(chain, q))])


def _moved(chain: Chain, q: Sequence[Scalar]) -> list[tuple[Vec, Vec, Rotation, Vec]]:
    """Of each joint its axis and origin, and the rotation and position of the link that it moves."""
    rotation, position = IDENTITY, ZERO
    moved = []
    hinges = [joint for joint, slide in enumerate(chain.slides) if not slide]
    turns: list[tuple[Scalar, Scalar]] = [(0.0, 0.0)] * len(q)
    if hinges:  # at once: a kernel for each took a fifth of the time in which a training's collection compiles
        angles = jnp.stack([q[joint] for joint in hinges])
        cosines, sines = once((jnp.cos(angles), jnp.sin(angles)))
        for row, joint in enumerate(hinges):
            turns[joint] = cosines[row], sines[row]
    for (turn, offset), slide, value, (cos, sin) in zip(chain.frames[:-1], chain.slides, q, turns, strict=True):
        position = position.plus(rotation.apply(offset))
        rotation = rotation.compose(turn)
        axis, origin = rotation.z, position
        if slide:
            position = position.plus(rotation.z.times(value))
        else:
            rotation = rotation.turn_z(cos, sin)
        moved.append((axis, origin, rotation, position))
    return moved


def jacobian_rows(chain: Chain, frames: Frames, like: Array) -> list[Array]:
    """Rows of the Jacobian `[n, ...]`, three linear ones, then three angular ones, of joint vectors `like [..., n]`."""
    axis, origin = (
        Vec(*(stack(parts, like, axis=0) for parts in zip(*vectors, strict=True)))
        for vectors in (frames.axes, frames.origins)
    )
    linear, angular = axis.cross(frames.position.minus(origin)), axis
    if any(chain.slides):
        slides = for_joints(chain.slides, like)
        linear = Vec(*(jnp.where(slides, along, moved) for along, moved in zip(axis, linear, strict=True)))
        angular = Vec(*(jnp.where(slides, 0.0, part) for part in axis))
    return once([jnp.asarray(row) for row in (*linear, *angular)])


def for_joints(values: Sequence[float], like: Array) -> np.ndarray:
    """A value of each joint `[n, ...]`, to stand beside what is computed of joint vectors `like [..., n]`."""
    return np.array(values).reshape(-1, *[1] * (like.ndim - 1))


def components(array: Array) -> list[Array]:
    """Components `[...]` of vectors `[..., k]`."""
    return [array[..., i] for i in range(array.shape[-1])]


def norm(vectors: Any) -> Any:
    """Length `[...]` of vectors `[..., k]`, in arrays of NumPy or of JAX; see `added`."""
    return added(vectors * vectors) ** 0.5


def added(vectors: Any) -> Any:
    """Sum `[...]` of the components of vectors `[..., k]`, one after the other.

    How XLA rounds a sum over an axis depends on the batch, and a part of the environments has to be as in all of them.
    """
    return total(components(vectors))


def stack(parts: Sequence[Scalar], like: Array, axis: int = -1) -> Array:
    """Vectors of their components along an axis, `[..., k]`, in shape and type those of `like`."""
    shape = like.shape[:-1]
    return jnp.stack([jnp.broadcast_to(jnp.asarray(c, like.dtype), shape) for c in parts], axis)
