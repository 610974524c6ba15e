from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.jax_setup import jit
from reachlab.robots.kinematics import scalars
from reachlab.robots.kinematics.inverse import ik_displace
from reachlab.robots.kinematics.scalars import IDENTITY, Rotation, Vec
from reachlab.robots.loading import load_robot
from reference import angle_between, quaternion, random_quaternions, rotation_matrix

QUARTER_TURN = Rotation(Vec(1.0, 0.0, 0.0), Vec(0.0, 0.0, 1.0), Vec(0.0, -1.0, 0.0))
"""A quarter turn about x, as most joint frames of the iiwa have."""


def operations(function, *shapes):
    """Names of the operations that JAX traces."""
    jaxpr = jax.make_jaxpr(function)(*(jnp.ones(shape) for shape in shapes))
    return [str(equation.primitive) for equation in jaxpr.eqns]


def of_matrix(matrix):
    """Rotation in scalars of matrices `[B, 3, 3]`."""
    return Rotation(*(Vec(*(jnp.asarray(matrix[:, i, j], jnp.float32) for i in range(3))) for j in range(3)))


@pytest.fixture(scope="module")
def quaternions():
    """Compiled `quaternion_from_rotation` of matrices `[B, 3, 3]`."""
    program = jit(lambda rotation: jnp.stack(scalars.quaternion_from_rotation(rotation), -1))
    return lambda matrix: np.asarray(program(of_matrix(matrix)))


# --- folding -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda a: scalars.mul(a, 0.0), []),
        (lambda a: scalars.mul(0.0, a), []),
        (lambda a: scalars.mul(1.0, a), []),
        (lambda a: scalars.mul(a, -1.0), ["neg"]),
        (lambda a: scalars.mul(a, 2.0), ["mul"]),
        (lambda a: scalars.add(a, 0.0), []),
        (lambda a: scalars.add(0.0, a), []),
        (lambda a: scalars.add(a, 1.0), ["add"]),
        (lambda a: scalars.sub(a, 0.0), []),
        (lambda a: scalars.sub(0.0, a), ["neg"]),
        (lambda a: scalars.total([0.0, a, 0.0]), []),
        (lambda a: Vec(1.0, 0.0, 0.0).dot(Vec(a, 2.0 * a, a)), ["mul"]),
        (lambda a: Vec(0.0, 0.0, 1.0).cross(Vec(a, a, a)), ["neg"]),
        (lambda a: tuple(QUARTER_TURN.apply(Vec(a, a, a))), ["neg"]),
        (lambda a: tuple(IDENTITY.apply(Vec(a, a, a))), []),
        (lambda a: tuple(IDENTITY.turn_z(a, a)), ["neg"]),
    ],
)
def test_constant_zeros_and_ones_cost_nothing(function, expected):
    assert operations(function, 4) == expected


def test_folded_arithmetic_is_arithmetic():
    """Folding may drop operations, never change a value."""
    for a in (0.0, 1.0, -1.0, 0.3, jnp.asarray([0.3, -2.0])):
        for b in (0.0, 1.0, -1.0, 0.7, jnp.asarray([4.0, 0.5])):
            np.testing.assert_allclose(scalars.mul(a, b), np.multiply(a, b), rtol=1e-6)
            np.testing.assert_allclose(scalars.add(a, b), np.add(a, b), rtol=1e-6)
            np.testing.assert_allclose(scalars.sub(a, b), np.subtract(a, b), rtol=1e-6)


def test_rotations_compose_and_invert_like_matrices():
    rng = np.random.default_rng(0)
    a, b = rotation_matrix(random_quaternions(rng, 2, 10))
    v = rng.normal(size=(10, 3))
    in_scalars = Vec(*jnp.asarray(v.T, jnp.float32))

    def matrix(rotation):
        return np.stack([np.stack(column, -1) for column in rotation], -1)

    np.testing.assert_allclose(matrix(of_matrix(a).compose(of_matrix(b))), a @ b, atol=1e-6)
    np.testing.assert_allclose(matrix(of_matrix(a).transpose()), a.transpose(0, 2, 1), atol=1e-7)
    np.testing.assert_allclose(np.stack(of_matrix(a).apply(in_scalars), -1), (a @ v[..., None])[..., 0], atol=1e-6)


# --- rotations and quaternions -----------------------------------------------------------------------

TURN_AXES = {
    "x": [1, 0, 0],
    "y": [0, 1, 0],
    "z": [0, 0, 1],
    "mostly x": [0.9, 0.3, -0.2],
    "mostly y": [-0.2, 0.9, 0.3],
    "mostly z": [0.3, -0.2, 0.9],
    "diagonal": [1, -1, 1],
}


@pytest.mark.parametrize("axis", TURN_AXES.values(), ids=list(TURN_AXES))
def test_quaternion_of_a_rotation_is_exact_at_every_angle(quaternions, axis):
    """Through 0 and 180°, where each of Shepperd's four candidates has its turn."""
    half = np.deg2rad([0.0, 0.01, 30.0, 90.0, 119.0, 121.0, 150.0, 179.99, 180.0, 180.01, 240.0, 359.9]) / 2
    unit = np.array(axis) / np.linalg.norm(axis)
    true = np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * unit], 1)
    found = quaternions(rotation_matrix(true))
    assert angle_between(found, true).max() <= 1e-6
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-6)
    assert (found[:, 0] >= 0).all()


def test_quaternion_of_a_random_rotation_is_the_references(quaternions):
    true = random_quaternions(np.random.default_rng(1), 500)
    # All four candidates are the best one somewhere.
    assert set(np.abs(true).argmax(1)) == {0, 1, 2, 3}
    found = quaternions(rotation_matrix(true))
    assert angle_between(found, quaternion(rotation_matrix(true))).max() <= 1e-6


def test_rotation_of_a_quaternion_is_the_references():
    true = random_quaternions(np.random.default_rng(2), 500)
    rotation = scalars.rotation_from_quaternion(*jnp.asarray(true.T, jnp.float32))
    found = np.stack([np.stack(column, -1) for column in rotation], -1)
    np.testing.assert_allclose(found, rotation_matrix(true), atol=1e-6)


# --- linear solves -----------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [3, 6])
def test_unrolled_cholesky_solves_what_lapack_solves(n):
    rng = np.random.default_rng(n)
    root = rng.normal(size=(200, n, n))
    a = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n)
    b = rng.normal(size=(200, n))
    lower = [[jnp.asarray(a[:, i, j], jnp.float32) for j in range(i + 1)] for i in range(n)]
    program = jit(lambda a, b: jnp.stack(scalars.solve_positive(a, b), -1))
    x = np.asarray(program(lower, [jnp.asarray(column, jnp.float32) for column in b.T]))
    exact = np.linalg.solve(a, b[..., None])[..., 0]
    # Relative error of a backward stable solve: rounding times the condition number.
    error = np.linalg.norm(x - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert (error <= n * np.finfo(np.float32).eps * np.linalg.cond(a)).all()


# --- barriers ----------------------------------------------------------------------------------------


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="the option is of XLA's CPU compiler")
@pytest.mark.compiled
def test_what_is_computed_once_stays_computed_once_in_the_compiled_program():
    """The trick to which the kinematics owe their speed; a new XLA may drop it without a word."""
    chain = load_robot("iiwa14").chain

    def step(*arguments):
        return ik_displace(chain, *arguments)

    arguments = jnp.zeros((256, chain.n)), jnp.zeros((256, 3)), jnp.ones((256, 4))

    def counted(compiler):
        text = compiler(step).lower(*arguments).compile().as_text()
        return text.count(" cosine("), text.count(" multiply(")

    (cosines, products), (again, many) = counted(jit), counted(jax.jit)
    assert cosines == 1 < again
    assert 2 * products < many


def test_once_keeps_values_and_constants():
    tree = {"a": jnp.arange(3.0), "b": (2.0, jnp.ones(2))}
    kept = scalars.once(tree)
    assert kept["b"][0] == 2.0
    assert isinstance(kept["b"][0], float)
    jax.tree.map(np.testing.assert_array_equal, kept, tree)
