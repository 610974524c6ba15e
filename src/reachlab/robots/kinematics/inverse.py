"""Inverse kinematics of a serial chain: damped steps within the joint limits, and a solver of poses.

Functions take joint vectors `[..., n]` with any leading shape and are traced by JAX; see `kinematics`.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from numpy.typing import ArrayLike

from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.forward import (
    Frames,
    Pose,
    components,
    frames_at,
    jacobian_columns,
    joint_vectors,
    norm,
    stack,
)
from reachlab.robots.kinematics.scalars import (
    Rotation,
    Scalar,
    Vec,
    add,
    mul,
    once,
    quaternion_from_rotation,
    rotation_from_quaternion,
    solve_positive,
    sub,
    total,
)
from reachlab.settings.validation import InputError

DAMPING = 1e-5
"""Added to the diagonal of J Jᵀ; the tutorial's joint damping."""

POINT_DAMPING = 1e-3
"""The same for the position alone, whose target may be far."""

SUGIHARA = 0.1
"""Weight of the squared error in the damping of the inverse-kinematics solver."""

MAX_SOLVER_STEP = 1.0
"""Largest joint displacement of one step of the solver [rad or m]; its damping does the rest."""

LIMIT_PASSES = 4
"""Times that a step of the position alone is solved, each time without the joints that have met their limits."""

MAX_TURN = 0.1
"""Largest orientation error handed to one linearised step [rad]; more is turned over several steps."""

MAX_JOINT_STEP = 0.2
"""Largest joint displacement of one linearised step [rad or m], beyond which J has changed."""

UNIT = 1e-3
"""How far the length of a quaternion may be from 1."""

TINY = 1e-6
"""Added to a length that divides [m]."""


class IKSolution(NamedTuple):
    """Joint vectors `q [..., n]`, whether each `converged [...]`, and what is left of the error.

    `position_error [...]` is in metres, `angle_error [...]` in radians.
    """

    q: Array
    converged: Array
    position_error: Array
    angle_error: Array


def ik_displace(chain: Chain, q: Array, displacement: Array, quaternion: Array) -> Array:
    """Joint vectors `[..., n]` one damped least-squares step from `q [..., n]`.

    The step is to a tool point displaced by `displacement [..., 3]` m and held as `quaternion [..., 4]`. It is
    `Jᵀ (J Jᵀ + λ 1)⁻¹ e` (Wampler, "Manipulator inverse kinematic solutions based on vector
    formulations and damped least-squares methods", IEEE Trans. SMC 16(1), 1986), shortened to
    `MAX_TURN` and `MAX_JOINT_STEP` and clipped to the joint limits. A second solve, for the position
    alone and with the joints that hit a limit held, gives back what clipping took: position outranks
    orientation. `q` within the limits stays within them, and finite input gives finite output. Of an arm with fewer
    than six joints the tool's tilt alone is held: the angle of `Chain.approach` from straight down, outward.
    """
    frames = frames_at(chain, components(q))
    return _pose_step(chain, q, frames, Vec(*components(displacement)), quaternion)


def ik_approach(chain: Chain, q: Array, position: Array, quaternion: Array, damping: float = DAMPING) -> Array:
    """The same step towards a tool at `position [..., 3]` m."""
    frames = frames_at(chain, components(q))
    return _pose_step(chain, q, frames, Vec(*components(position)).minus(frames.position), quaternion, damping)


def _pose_step(chain: Chain, q: Array, frames: Frames, linear: Vec, held: Array, damping: float = DAMPING) -> Array:
    angular, columns = _orientation(chain, frames, held)
    shorten = _shrink(MAX_TURN, _size(angular))
    turn = [mul(shorten, part) for part in angular]
    return stack(_bounded_step(chain, components(q), columns, linear, turn, damping, MAX_JOINT_STEP), q)


def ik_point_step(chain: Chain, q: Array, command: Array, displacement: Array) -> Array:
    """Displacement `[..., n]` of a joint command that moves the tool by `displacement [..., 3]` m, in any orientation.

    The damped least-squares step of `ik_displace` for the position alone, linearised at the joints `q [..., n]`. Added
    to `command [..., n]` it keeps the joint limits: a joint that would pass one stops there, and the step is solved
    again for the others, `LIMIT_PASSES` times in all.
    """
    columns = [column[:3] for column in jacobian_columns(chain, frames_at(chain, components(q)))]
    commanded, wish = components(command), components(displacement)

    def again(_: int, before: tuple[list[Array], ...]) -> tuple[list[Array], ...]:
        free, stopped = before[:2]
        left = [
            sub(wanted, total([mul(column[row], s) for column, s in zip(columns, stopped, strict=True)]))
            for row, wanted in enumerate(wish)
        ]
        masked = once([tuple(mul(f, c) for c in column) for f, column in zip(free, columns, strict=True)])
        solved = _least_squares(masked, left, POINT_DAMPING)
        wanted = once([c + (a + b) for c, a, b in zip(commanded, stopped, solved, strict=True)])
        allowed = once([jnp.clip(a, low, high) for a, low, high in zip(wanted, chain.lower, chain.upper, strict=True)])
        free = [jnp.where(a == w, f, 0.0) for a, w, f in zip(allowed, wanted, free, strict=True)]
        step = [a - c for a, c in zip(allowed, commanded, strict=True)]
        return free, [jnp.where(f > 0, 0.0, s) for f, s in zip(free, step, strict=True)], step

    zero, one = jnp.zeros(q.shape[:-1]), jnp.ones(q.shape[:-1])
    _, _, step = jax.lax.fori_loop(0, LIMIT_PASSES, again, ([one] * chain.n, [zero] * chain.n, [zero] * chain.n))
    return stack(step, q)


def inverse_kinematics(
    chain: Chain,
    target: Pose,
    start: ArrayLike,
    key: Array,
    *,
    restarts: int = 40,
    iterations: int = 25,
    position_tolerance: float = 1e-5,
    angle_tolerance: float = 1e-4,
) -> IKSolution:
    """Joint vectors within the limits that bring the tool to `target [...]`.

    Newton steps damped by the square of the error (Sugihara, "Solvability-unconcerned inverse
    kinematics by the Levenberg-Marquardt method", IEEE Trans. Robotics 27(5), 2011) from `start [..., n]`;
    a pose not reached after `iterations` of them begins again at a random joint vector drawn from
    `key`, at most `restarts` times. What is not reached is returned as it stands, `converged` false.

    Args:
        chain: the arm.
        target: positions `[..., 3]` m and quaternions `[..., 4]`.
        start: first joint vectors, broadcast to `[..., n]`.
        key: random key of the restarts; equal keys give equal solutions.
        restarts: attempts after the first.
        iterations: steps an attempt.
        position_tolerance: largest position error [m] of a converged pose.
        angle_tolerance: largest angle error [rad] of a converged pose.

    Raises:
        InputError: a quaternion is not of length 1, or there are not as many joints as the chain's.
    """
    target = _unit(target)
    shape = (max(restarts, 1), chain.n)
    seeds = jax.random.uniform(key, shape, minval=np.array(chain.lower), maxval=np.array(chain.upper))
    start = jnp.broadcast_to(joint_vectors(chain, start), (*target.position.shape[:-1], chain.n))

    def errors(q: Array) -> tuple[Vec, tuple[Scalar, ...], list[tuple[Scalar, ...]], Array, Array, Array]:
        frames = frames_at(chain, components(q))
        linear = Vec(*components(target.position)).minus(frames.position)
        angular, columns = _orientation(chain, frames, target.quaternion)
        distance, angle = linear.norm(), _size(angular)
        reached = (distance <= position_tolerance) & (angle <= angle_tolerance)
        return linear, angular, columns, distance, angle, reached

    def advance(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        q, _, count = carry
        linear, angular, columns, distance, angle, reached = errors(q)
        damping = DAMPING + SUGIHARA * (distance**2 + angle**2)
        moved = stack(_bounded_step(chain, components(q), columns, linear, angular, damping, MAX_SOLVER_STEP), q)
        again = (count + 1) % iterations == 0
        moved = jnp.where(again, seeds[(count + 1) // iterations - 1], moved)
        return jnp.where(reached[..., None], q, moved), reached, count + 1

    def unfinished(carry: tuple[Array, Array, Array]) -> Array:
        return ~carry[1].all() & (carry[2] < (restarts + 1) * iterations - 1)

    begun = (start, jnp.zeros(start.shape[:-1], bool), jnp.zeros((), jnp.int32))
    q, _, _ = jax.lax.while_loop(unfinished, advance, begun)
    _, _, _, distance, angle, reached = errors(q)
    return IKSolution(q, reached, distance, angle)


def _unit(target: Pose) -> Pose:
    """The same target as arrays; InputError where a quaternion that is known is not of length 1."""
    target = Pose(jnp.asarray(target.position, float), jnp.asarray(target.quaternion, float))
    if not isinstance(length := norm(target.quaternion), Tracer) and (jnp.abs(length - 1.0) > UNIT).any():
        raise InputError(
            f"quaternions of poses are of length 1, and one of the target's has {length.min():g}: divide by it."
        )
    return target


def _size(angular: Sequence[Scalar]) -> Array:
    return Vec(*angular).norm() if len(angular) > 1 else jnp.abs(angular[0])


def _orientation(
    chain: Chain, frames: Frames, quaternion: Array
) -> tuple[tuple[Scalar, ...], list[tuple[Scalar, ...]]]:
    """Rotation error [rad] from the tool to an orientation `[..., 4]`, and the Jacobian's columns to mend it.

    It has a rotation vector's parts or, without the six joints of a pose, the tilt alone, about the arm's side.
    """
    target, columns = rotation_from_quaternion(*components(quaternion)), jacobian_columns(chain, frames)
    if chain.poses:
        return tuple(rotation_error(frames.rotation, target)), columns
    approach = Vec(*chain.approach)
    axis, held = frames.rotation.apply(approach), target.apply(approach)
    out = frames.position.minus(frames.origins[0])
    length = jnp.sqrt(out.x**2 + out.y**2) + TINY
    across = once(Vec(-out.y / length, out.x / length, 0.0))
    # Not from the vertical part: of an axis that points down its rounding would be a tilt of 0.3 mrad.
    aside = jnp.sqrt(held.x**2 + held.y**2)
    wanted = once(Vec(mul(aside, across.y), mul(-aside, across.x), held.z))
    tilt = once(across.dot(axis.cross(wanted)))
    return (tilt,), once([(*column[:3], across.dot(Vec(*column[3:]))) for column in columns])


def rotation_error(current: Rotation, target: Rotation) -> Vec:
    """World-frame rotation vector from `current` to `target`, as `2 sin(θ/2)` times the axis.

    It equals the rotation vector to third order, is smooth up to half a turn and needs no arc tangent.
    """
    _, x, y, z = quaternion_from_rotation(target.compose(current.transpose()))
    return once(Vec(2.0 * x, 2.0 * y, 2.0 * z))


def _bounded_step(
    chain: Chain,
    q: Sequence[Array],
    columns: Sequence[Sequence[Scalar]],
    linear: Vec,
    angular: Sequence[Scalar],
    damping: Scalar,
    bound: float,
) -> list[Scalar]:
    """Joint vector after one step of at most `bound` a joint, inside the limits."""
    step = _least_squares(columns, (*linear, *angular), damping)
    scale = once(_shrink(bound, _longest(step)))
    clipped = once(_clip(chain, [add(a, mul(scale, s)) for a, s in zip(q, step, strict=True)]))

    moved = [sub(new, old) for new, old in zip(clipped, q, strict=True)]
    left = [
        sub(mul(scale, wanted), total([mul(column[row], m) for column, m in zip(columns, moved, strict=True)]))
        for row, wanted in enumerate(linear)
    ]
    free = [
        jnp.where((c > low) & (c < high), 1.0, 0.0)
        for c, low, high in zip(clipped, chain.lower, chain.upper, strict=True)
    ]
    masked = once([tuple(mul(f, c) for c in column[:3]) for f, column in zip(free, columns, strict=True)])
    repair = _least_squares(masked, left, damping)
    shorten = once(_shrink(bound, _longest(repair)))
    bounded = [mul(shorten, r) for r in repair]
    return _clip(chain, [add(c, r) for c, r in zip(clipped, bounded, strict=True)])


def _least_squares(columns: Sequence[Sequence[Scalar]], error: Sequence[Scalar], damping: Scalar) -> list[Scalar]:
    rows = range(len(error))
    gram = [[total([mul(c[i], c[j]) for c in columns]) for j in range(i + 1)] for i in rows]
    for i in rows:
        gram[i][i] = add(gram[i][i], damping)
    weights = once(solve_positive(gram, error))
    return once([total([mul(c[i], weights[i]) for i in rows]) for c in columns])


def _shrink(bound: float, length: Scalar) -> Scalar:
    """Factor that brings `length` down to `bound`, 1 where it is shorter."""
    return bound / jnp.maximum(length, bound)


def _longest(step: Sequence[Scalar]) -> Array:
    """Largest component, by its size."""
    return functools.reduce(jnp.maximum, [jnp.abs(component) for component in step])


def _clip(chain: Chain, q: Sequence[Scalar]) -> list[Scalar]:
    return [jnp.clip(a, low, high) for a, low, high in zip(q, chain.lower, chain.upper, strict=True)]
