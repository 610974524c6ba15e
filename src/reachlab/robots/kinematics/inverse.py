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
    for_joints,
    frames_at,
    jacobian_rows,
    joint_vectors,
    norm,
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
from reachlab.settings.arguments import typed
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


def ik_approach(
    chain: Chain, q: Array, position: Array, quaternion: Array, damping: Scalar = DAMPING, holding: Scalar = 1.0
) -> Array:
    """The same step towards a tool at `position [..., 3]` m; where `holding` is 0, in any orientation."""
    frames = frames_at(chain, components(q))
    linear = Vec(*components(position)).minus(frames.position)
    return _pose_step(chain, q, frames, linear, quaternion, damping, holding)


def _pose_step(
    chain: Chain, q: Array, frames: Frames, linear: Vec, held: Array, damping: Scalar = DAMPING, holding: Scalar = 1.0
) -> Array:
    angular, rows = _orientation(chain, frames, held, q)
    rows = [*rows[:3], *(jnp.asarray(mul(holding, row)) for row in rows[3:])]
    shorten = _shrink(MAX_TURN, _size(angular))
    turn = [mul(shorten, part) for part in angular]
    return _bounded_step(chain, q, rows, linear, turn, damping, MAX_JOINT_STEP)


def ik_point_step(chain: Chain, q: Array, command: Array, displacement: Array) -> Array:
    """Displacement `[..., n]` of a joint command that moves the tool by `displacement [..., 3]` m, in any orientation.

    The damped least-squares step of `ik_displace` for the position alone, linearised at the joints `q [..., n]`. Added
    to `command [..., n]` it keeps the joint limits: a joint that would pass one stops there, and the step is solved
    again for the others, `LIMIT_PASSES` times in all.
    """
    rows = jacobian_rows(chain, frames_at(chain, components(q)), q)[:3]
    commanded, wish = jnp.moveaxis(command, -1, 0), components(displacement)

    def again(_: int, before: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        free, stopped = before[:2]
        left = [sub(wanted, _along(row, stopped)) for row, wanted in zip(rows, wish, strict=True)]
        solved = _least_squares(once([free * row for row in rows]), left, POINT_DAMPING)
        wanted = once(commanded + (stopped + solved))
        allowed = once(_clip(chain, wanted))
        free, step = jnp.where(allowed == wanted, free, 0.0), allowed - commanded
        return free, jnp.where(free > 0, 0.0, step), step

    zero = jnp.zeros(commanded.shape)
    _, _, step = jax.lax.fori_loop(0, LIMIT_PASSES, again, (zero + 1.0, zero, zero))
    return jnp.moveaxis(step, 0, -1)


@typed
def inverse_kinematics(
    chain: Chain,
    target: Pose,
    start: ArrayLike,
    key: Array | int,
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
        key: random key of the restarts, or a seed; equal keys give equal solutions.
        restarts: attempts after the first.
        iterations: steps an attempt.
        position_tolerance: largest position error [m] of a converged pose.
        angle_tolerance: largest angle error [rad] of a converged pose.

    Raises:
        InputError: a quaternion is not of length 1, or there are not as many joints as the chain's.
    """
    target, shape = _unit(target), (max(restarts, 1), chain.n)
    key = jax.random.key(key) if isinstance(key, int) else key
    seeds = jax.random.uniform(key, shape, minval=np.array(chain.lower), maxval=np.array(chain.upper))
    start = jnp.broadcast_to(joint_vectors(chain, start), (*target.position.shape[:-1], chain.n))

    def errors(q: Array) -> tuple[Vec, tuple[Scalar, ...], list[Array], Array, Array, Array]:
        frames = frames_at(chain, components(q))
        linear = Vec(*components(target.position)).minus(frames.position)
        angular, rows = _orientation(chain, frames, target.quaternion, q)
        distance, angle = linear.norm(), _size(angular)
        reached = (distance <= position_tolerance) & (angle <= angle_tolerance)
        return linear, angular, rows, distance, angle, reached

    def advance(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        q, _, count = carry
        linear, angular, rows, distance, angle, reached = errors(q)
        damping = DAMPING + SUGIHARA * (distance**2 + angle**2)
        moved = _bounded_step(chain, q, rows, linear, angular, damping, MAX_SOLVER_STEP)
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


def _orientation(chain: Chain, frames: Frames, quaternion: Array, q: Array) -> tuple[tuple[Scalar, ...], list[Array]]:
    """Rotation error [rad] from the tool to an orientation `[..., 4]`, and the Jacobian's rows to mend it.

    It has a rotation vector's parts or, without the six joints of a pose, the tilt alone, about the arm's side.
    """
    target, rows = rotation_from_quaternion(*components(quaternion)), jacobian_rows(chain, frames, q)
    if chain.poses:
        return tuple(rotation_error(frames.rotation, target)), rows
    approach = Vec(*chain.approach)
    axis, held = frames.rotation.apply(approach), target.apply(approach)
    out = frames.position.minus(frames.origins[0])
    length = jnp.sqrt(out.x**2 + out.y**2) + TINY
    across = once(Vec(-out.y / length, out.x / length, 0.0))
    # Not from the vertical part: of an axis that points down its rounding would be a tilt of 0.3 mrad.
    aside = jnp.sqrt(held.x**2 + held.y**2)
    wanted = once(Vec(mul(aside, across.y), mul(-aside, across.x), held.z))
    tilt = once(across.dot(axis.cross(wanted)))
    return (tilt,), once([*rows[:3], jnp.asarray(across.dot(Vec(*rows[3:])))])


def rotation_error(current: Rotation, target: Rotation) -> Vec:
    """World-frame rotation vector from `current` to `target`, as `2 sin(θ/2)` times the axis.

    It equals the rotation vector to third order, is smooth up to half a turn and needs no arc tangent.
    """
    _, x, y, z = quaternion_from_rotation(target.compose(current.transpose()))
    return once(Vec(2.0 * x, 2.0 * y, 2.0 * z))


def _bounded_step(
    chain: Chain,
    start: Array,
    rows: Sequence[Array],
    linear: Vec,
    angular: Sequence[Scalar],
    damping: Scalar,
    bound: float,
) -> Array:
    """Joint vectors `[..., n]` after one step from `start [..., n]` of at most `bound` a joint, inside the limits."""
    q = jnp.moveaxis(start, -1, 0)
    step = _least_squares(rows, (*linear, *angular), damping)
    scale = once(_shrink(bound, _longest(step)))
    clipped = once(_clip(chain, q + scale * step))

    moved, lower, upper = clipped - q, for_joints(chain.lower, start), for_joints(chain.upper, start)
    left = [sub(mul(scale, wanted), _along(row, moved)) for row, wanted in zip(rows, linear, strict=False)]
    free = jnp.where((clipped > lower) & (clipped < upper), 1.0, 0.0)
    repair = _least_squares(once([free * row for row in rows[:3]]), left, damping)
    shorten = once(_shrink(bound, _longest(repair)))
    return jnp.moveaxis(_clip(chain, clipped + shorten * repair), 0, -1)


def _least_squares(rows: Sequence[Array], error: Sequence[Scalar], damping: Scalar) -> Array:
    """Step of the joints `[n, ...]` by which a Jacobian of these rows takes away an error."""
    gram = [[_along(one, other) for other in rows[: i + 1]] for i, one in enumerate(rows)]
    for i in range(len(rows)):
        gram[i][i] = add(gram[i][i], damping)
    weights = once(solve_positive(gram, error))
    return once(jnp.asarray(total([mul(row, weight) for row, weight in zip(rows, weights, strict=True)])))


def _along(row: Array, other: Array) -> Scalar:
    """Sum of the products of two rows, one joint after the other."""
    return total([row[joint] * other[joint] for joint in range(len(row))])


def _shrink(bound: float, length: Scalar) -> Scalar:
    """Factor that brings `length` down to `bound`, 1 where it is shorter."""
    return bound / jnp.maximum(length, bound)


def _longest(step: Array) -> Array:
    """Largest joint of a step `[n, ...]`, by its size."""
    return functools.reduce(jnp.maximum, [jnp.abs(joint) for joint in step])


def _clip(chain: Chain, q: Array) -> Array:
    """Joints `[n, ...]` within their limits."""
    below = jnp.moveaxis(q, 0, -1)
    return jnp.clip(q, for_joints(chain.lower, below), for_joints(chain.upper, below))
