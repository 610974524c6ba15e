"""Small vectors, rotations and linear solves written on scalars that are each one array over the batch.

XLA's CPU backend is slow on stacks of 3 x 3 matrices with the batch in front, and fast on long
one-dimensional arrays. So a vector here is three arrays `[B]`, a rotation three such vectors, and a
6 x 6 factorisation is unrolled into scalar operations. Python floats mark constants known while
tracing: a product with an exact 0 or 1 is never emitted, so a robot whose joint frames are quarter
turns pays nothing for them.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array

Scalar = Array | float
Tree = TypeVar("Tree")


def once(tree: Tree) -> Tree:
    """The same values, computed once.

    XLA fuses cheap producers into each of their consumers and computes them again there: unhindered,
    720 products of an inverse-kinematics step become 3,400. A barrier that survives until fusion (see
    `jax_setup.jit`) stops that.
    """
    leaves, structure = jax.tree.flatten(tree)
    traced = [leaf for leaf in leaves if not isinstance(leaf, float)]
    kept = iter(jax.lax.optimization_barrier(traced))
    return jax.tree.unflatten(structure, [leaf if isinstance(leaf, float) else next(kept) for leaf in leaves])


def mul(a: Scalar, b: Scalar) -> Scalar:
    """Product, folded when either factor is the constant 0, 1 or -1."""
    if isinstance(b, float):
        a, b = b, a
    if isinstance(a, float) and not isinstance(b, float):
        if a == 0.0:
            return 0.0
        if a == 1.0:
            return b
        if a == -1.0:
            return -b
    return a * b


def add(a: Scalar, b: Scalar) -> Scalar:
    """Sum, folded when either term is the constant 0."""
    if isinstance(a, float) and a == 0.0:
        return b
    if isinstance(b, float) and b == 0.0:
        return a
    return a + b


def sub(a: Scalar, b: Scalar) -> Scalar:
    """Difference, folded when either term is the constant 0."""
    return add(a, mul(-1.0, b))


def total(terms: Sequence[Scalar]) -> Scalar:
    """Sum of the terms, folded."""
    return functools.reduce(add, terms, 0.0)


class Vec(NamedTuple):
    """A vector in three dimensions; every component is a constant or an array `[B]`."""

    x: Scalar
    y: Scalar
    z: Scalar

    def plus(self, other: Vec) -> Vec:
        """Sum of two vectors."""
        return Vec(*map(add, self, other))

    def minus(self, other: Vec) -> Vec:
        """Difference of two vectors."""
        return Vec(*map(sub, self, other))

    def times(self, scale: Scalar) -> Vec:
        """Vector scaled by a number."""
        return Vec(*(mul(scale, component) for component in self))

    def dot(self, other: Vec) -> Scalar:
        """Scalar product."""
        return total([mul(a, b) for a, b in zip(self, other, strict=True)])

    def norm(self) -> Array:
        """Euclidean length."""
        return jnp.sqrt(self.dot(self))

    def cross(self, other: Vec) -> Vec:
        """Vector product."""
        return Vec(
            sub(mul(self.y, other.z), mul(self.z, other.y)),
            sub(mul(self.z, other.x), mul(self.x, other.z)),
            sub(mul(self.x, other.y), mul(self.y, other.x)),
        )


ZERO = Vec(0.0, 0.0, 0.0)


class Rotation(NamedTuple):
    """A rotation matrix by its columns, the frame's own axes."""

    x: Vec
    y: Vec
    z: Vec

    def apply(self, v: Vec) -> Vec:
        """Vector `v` of this frame, in the parent's."""
        return self.x.times(v.x).plus(self.y.times(v.y)).plus(self.z.times(v.z))

    def compose(self, other: Rotation) -> Rotation:
        """Matrix product, this rotation on the left."""
        return Rotation(*(self.apply(column) for column in other))

    def transpose(self) -> Rotation:
        """Inverse rotation."""
        return Rotation(*(Vec(*row) for row in zip(*self, strict=True)))

    def turn_z(self, cos: Scalar, sin: Scalar) -> Rotation:
        """This frame turned about its own z axis."""
        x = self.x.times(cos).plus(self.y.times(sin))
        y = self.y.times(cos).minus(self.x.times(sin))
        return Rotation(x, y, self.z)


IDENTITY = Rotation(Vec(1.0, 0.0, 0.0), Vec(0.0, 1.0, 0.0), Vec(0.0, 0.0, 1.0))


def rotation_from_quaternion(w: Scalar, x: Scalar, y: Scalar, z: Scalar) -> Rotation:
    """Rotation of the unit quaternion `w, x, y, z`."""

    def two(a: Scalar, b: Scalar) -> Scalar:
        return mul(2.0, mul(a, b))

    def diagonal(a: Scalar, b: Scalar) -> Scalar:
        return sub(1.0, add(two(a, a), two(b, b)))

    return Rotation(
        Vec(diagonal(y, z), add(two(x, y), two(w, z)), sub(two(x, z), two(w, y))),
        Vec(sub(two(x, y), two(w, z)), diagonal(x, z), add(two(y, z), two(w, x))),
        Vec(add(two(x, z), two(w, y)), sub(two(y, z), two(w, x)), diagonal(x, y)),
    )


def quaternion_from_rotation(rotation: Rotation) -> tuple[Array, Array, Array, Array]:
    """Unit quaternion `w, x, y, z` with `w >= 0`, exact to rounding at every angle.

    Shepperd, "Quaternion from rotation matrix", Journal of Guidance and Control 1(3), 1978: of the
    four candidates the one with the largest divisor is taken.
    """
    (xx, yx, zx), (xy, yy, zy), (xz, yz, zz) = rotation
    plus_x, plus_y, plus_z = add(zy, yz), add(xz, zx), add(yx, xy)
    minus_x, minus_y, minus_z = sub(zy, yz), sub(xz, zx), sub(yx, xy)
    rows = (
        (1.0 + xx + yy + zz, minus_x, minus_y, minus_z),
        (minus_x, 1.0 + xx - yy - zz, plus_z, plus_y),
        (minus_y, plus_z, 1.0 - xx + yy - zz, plus_x),
        (minus_z, plus_y, plus_x, 1.0 - xx - yy + zz),
    )
    best, largest = rows[0], rows[0][0]
    for i in range(1, 4):
        better = rows[i][i] > largest
        best = tuple(jnp.where(better, new, old) for new, old in zip(rows[i], best, strict=True))
        largest = jnp.maximum(rows[i][i], largest)
    scale = jnp.where(best[0] < 0.0, -0.5, 0.5) / jnp.sqrt(largest)
    w, x, y, z = (component * scale for component in best)
    return w, x, y, z


def solve_positive(a: Sequence[Sequence[Scalar]], b: Sequence[Scalar]) -> list[Scalar]:
    """Solution of `A x = b` by an unrolled Cholesky factorisation.

    Args:
        a: lower triangle of a symmetric positive definite matrix, row `i` with `i + 1` entries.
        b: right-hand side.
    """
    n = len(b)
    lower: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    inverse: list[Scalar] = [0.0] * n
    for i in range(n):
        for j in range(i):
            known = total([mul(lower[i][k], lower[j][k]) for k in range(j)])
            lower[i][j] = mul(sub(a[i][j], known), inverse[j])
        known = total([mul(lower[i][k], lower[i][k]) for k in range(i)])
        inverse[i] = 1.0 / jnp.sqrt(sub(a[i][i], known))
    half: list[Scalar] = []
    for i in range(n):
        known = total([mul(lower[i][k], half[k]) for k in range(i)])
        half.append(mul(sub(b[i], known), inverse[i]))
    x: list[Scalar] = [0.0] * n
    for i in reversed(range(n)):
        known = total([mul(lower[k][i], x[k]) for k in range(i + 1, n)])
        x[i] = mul(sub(half[i], known), inverse[i])
    return x
