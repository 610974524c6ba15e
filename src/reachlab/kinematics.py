"""Kinematics of a serial chain of hinge and slide joints: forward, Jacobian and inverse.

Every function takes joint vectors `[..., n]` with any leading shape and is traced by JAX; the work
is done on lanes (see `lanes.py`). Positions are in metres in the world frame, angles in radians,
quaternions unit and ordered w, x, y, z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.lanes import (
    IDENTITY,
    ZERO,
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

if TYPE_CHECKING:
    import mujoco

ROUND_TO_EXACT = 1e-12
"""Constants of a joint frame this close to 0 or 1 are those numbers; they differ by float64 rounding."""

DAMPING = 1e-5
"""Added to the diagonal of J Jᵀ; the tutorial's joint damping."""

SUGIHARA = 0.1
"""Weight of the squared error in the damping of the inverse-kinematics solver."""

MAX_SOLVER_STEP = 1.0
"""Largest joint displacement of one step of the solver [rad or m]; its damping does the rest."""

MAX_TURN = 0.1
"""Largest orientation error handed to one linearised step [rad]; more is turned over several steps."""

MAX_JOINT_STEP = 0.2
"""Largest joint displacement of one linearised step [rad or m], beyond which J has changed."""


@dataclass(frozen=True)
class Chain:
    """A serial chain; constants of the robot, known while tracing.

    The pose of the tool is `F_0 J_0(q_0) F_1 J_1(q_1) ... F_n`, where `J_i` turns about the z axis of
    its frame (hinge) or moves along it (slide).

    Attributes:
        frames: the fixed transforms `F_0 ... F_n`, `n + 1` pairs of rotation and position [m].
        slides: for each joint, whether it slides.
        lower, upper: joint limits [rad or m]; infinite where the joint has none.
        joints: the joints' names, base to tool.
    """

    frames: tuple[tuple[Rotation, Vec], ...]
    slides: tuple[bool, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    joints: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.slides)


class Pose(NamedTuple):
    """A pose: `position [..., 3]` m and unit `quaternion [..., 4]` wxyz."""

    position: Array
    quaternion: Array


class IKSolution(NamedTuple):
    """Joint vectors `q [..., n]`, whether each `converged [...]`, and what is left of the error.

    `position_error [...]` is in metres, `angle_error [...]` in radians.
    """

    q: Array
    converged: Array
    position_error: Array
    angle_error: Array


class _Frames(NamedTuple):
    """World axes and origins of the joints, and the tool's pose, in lanes."""

    axes: list[Vec]
    origins: list[Vec]
    rotation: Rotation
    position: Vec


# --- from a compiled model ------------------------------------------------------------------------


def chain_from_model(model: mujoco.MjModel, tool: str) -> Chain:
    """Chain from the world to the site or body `tool` of a compiled MuJoCo model.

    Raises:
        ValueError: no such site or body, or a ball or free joint on the way.
    """
    import mujoco

    body, tip = _tool_body(model, tool)
    path = []
    while body != 0:
        path.append(body)
        body = int(model.body_parentid[body])
    frames, slides, lower, upper, names = [], [], [], [], []
    transform = np.eye(4)
    for body in reversed(path):
        transform = transform @ _transform(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            kind, name = mujoco.mjtJoint(model.jnt_type[joint]), model.joint(joint).name
            if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                raise ValueError(f"joint {name!r} is a ball or free joint; a chain takes hinge and slide joints only")
            slide = kind == mujoco.mjtJoint.mjJNT_SLIDE
            align = _align_z(model.jnt_pos[joint], model.jnt_axis[joint])
            back = np.linalg.inv(align)
            reference = float(model.qpos0[model.jnt_qposadr[joint]])
            frames.append(transform @ align @ _joint_transform(slide, -reference))
            transform = back
            limited = bool(model.jnt_limited[joint])
            slides.append(slide)
            low, high = model.jnt_range[joint] if limited else (-np.inf, np.inf)
            lower.append(_inward(low, np.inf))
            upper.append(_inward(high, -np.inf))
            names.append(name)
    if not slides:
        raise ValueError(f"no joint moves tool {tool!r}")
    frames.append(transform @ tip)
    return Chain(tuple(map(_constants, frames)), tuple(slides), tuple(lower), tuple(upper), tuple(names))


def _tool_body(model: mujoco.MjModel, tool: str) -> tuple[int, np.ndarray]:
    import mujoco

    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tool)
    if site >= 0:
        return int(model.site_bodyid[site]), _transform(model.site_pos[site], model.site_quat[site])
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tool)
    if body < 0:
        raise ValueError(f"tool {tool!r} is neither a site nor a body of the model")
    return body, np.eye(4)


def _inward(limit: float, inside: float) -> float:
    """The limit as a float32 number that is not beyond it."""
    rounded = np.float32(limit)
    beyond = rounded < limit if inside > limit else rounded > limit
    return float(np.nextafter(rounded, np.float32(inside)) if beyond else rounded)


def _transform(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = (float(c) for c in np.asarray(quaternion) / np.linalg.norm(quaternion))
    transform = np.eye(4)
    transform[:3, :3] = np.array(rotation_from_quaternion(w, x, y, z)).T
    transform[:3, 3] = position
    return transform


def _align_z(position: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Transform to a frame at `position` whose z is `axis`, by the shortest turn."""
    axis = axis / np.linalg.norm(axis)
    half = np.array([1.0 + axis[2], -axis[1], axis[0], 0.0])
    return _transform(position, half if half[0] > ROUND_TO_EXACT else np.array([0.0, 1.0, 0.0, 0.0]))


def _joint_transform(slide: bool, value: float) -> np.ndarray:
    if slide:
        return _transform(np.array([0.0, 0.0, value]), np.array([1.0, 0.0, 0.0, 0.0]))
    return _transform(np.zeros(3), np.array([np.cos(value / 2), 0.0, 0.0, np.sin(value / 2)]))


def _constants(transform: np.ndarray) -> tuple[Rotation, Vec]:
    nearest = np.round(transform)
    exact = np.where(np.abs(transform - nearest) < ROUND_TO_EXACT, nearest, transform)
    rotation = Rotation(*(Vec(*(float(c) for c in column)) for column in exact[:3, :3].T))
    return rotation, Vec(*(float(c) for c in exact[:3, 3]))


# --- forward --------------------------------------------------------------------------------------


def forward_kinematics(chain: Chain, q: Array) -> Pose:
    """Pose of the tool at joint vectors `q [..., n]`."""
    frames = _frames(chain, _lanes(q))
    return Pose(_stack(frames.position, q), _stack(quaternion_from_rotation(frames.rotation), q))


def jacobian(chain: Chain, q: Array) -> Array:
    """Geometric Jacobian `[..., 6, n]` of the tool in the world frame: linear rows, then angular."""
    columns = _columns(chain, _frames(chain, _lanes(q)))
    rows = [_stack(row, q) for row in zip(*columns, strict=True)]
    return jnp.stack(rows, axis=-2)


def _frames(chain: Chain, q: Sequence[Scalar]) -> _Frames:
    rotation, position = IDENTITY, ZERO
    axes, origins = [], []
    turns = once([(0.0, 0.0) if slide else (jnp.cos(a), jnp.sin(a)) for a, slide in zip(q, chain.slides, strict=True)])
    for (turn, offset), slide, value, (cos, sin) in zip(chain.frames[:-1], chain.slides, q, turns, strict=True):
        position = position.plus(rotation.apply(offset))
        rotation = rotation.compose(turn)
        axes.append(rotation.z)
        origins.append(position)
        if slide:
            position = position.plus(rotation.z.times(value))
        else:
            rotation = rotation.turn_z(cos, sin)
    turn, offset = chain.frames[-1]
    return once(_Frames(axes, origins, rotation.compose(turn), position.plus(rotation.apply(offset))))


def _columns(chain: Chain, frames: _Frames) -> list[tuple[Scalar, ...]]:
    columns = []
    for slide, axis, origin in zip(chain.slides, frames.axes, frames.origins, strict=True):
        if slide:
            columns.append((*axis, *ZERO))
        else:
            columns.append((*axis.cross(frames.position.minus(origin)), *axis))
    return once(columns)


def _lanes(array: Array) -> list[Array]:
    return [array[..., i] for i in range(array.shape[-1])]


def _stack(components: Sequence[Scalar], like: Array) -> Array:
    shape = like.shape[:-1]
    return jnp.stack([jnp.broadcast_to(jnp.asarray(c, like.dtype), shape) for c in components], axis=-1)


# --- inverse --------------------------------------------------------------------------------------


def ik_step(chain: Chain, q: Array, target: Pose) -> Array:
    """Joint vectors `[..., n]` one damped least-squares step from `q [..., n]` towards `target`.

    The step is `Jᵀ (J Jᵀ + λ 1)⁻¹ e` (Wampler, "Manipulator inverse kinematic solutions based on vector
    formulations and damped least-squares methods", IEEE Trans. SMC 16(1), 1986), shortened to
    `MAX_TURN` and `MAX_JOINT_STEP` and clipped to the joint limits. A second solve, for the position
    alone and with the joints that hit a limit held, gives back what clipping took: position outranks
    orientation. `q` within the limits stays within them, and finite input gives finite output.
    """
    lanes = _lanes(q)
    linear, angular, columns = _error(chain, lanes, target)
    turn = angular.times(_shrink(MAX_TURN, angular.norm()))
    return _stack(_bounded_step(chain, lanes, columns, linear, turn, DAMPING, MAX_JOINT_STEP), q)


def inverse_kinematics(
    chain: Chain,
    target: Pose,
    start: Array,
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
    """
    lower, upper = (jnp.clip(jnp.asarray(limit), -jnp.pi, jnp.pi) for limit in (chain.lower, chain.upper))
    seeds = jax.random.uniform(key, (restarts, chain.n), minval=lower, maxval=upper)
    start = jnp.broadcast_to(start, (*target.position.shape[:-1], chain.n))

    def errors(q: Array) -> tuple[Vec, Vec, list[tuple[Scalar, ...]], Array, Array, Array]:
        linear, angular, columns = _error(chain, _lanes(q), target)
        distance, angle = linear.norm(), angular.norm()
        reached = (distance <= position_tolerance) & (angle <= angle_tolerance)
        return linear, angular, columns, distance, angle, reached

    def advance(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        q, _, count = carry
        linear, angular, columns, distance, angle, reached = errors(q)
        damping = DAMPING + SUGIHARA * (distance**2 + angle**2)
        moved = _stack(_bounded_step(chain, _lanes(q), columns, linear, angular, damping, MAX_SOLVER_STEP), q)
        again = (count + 1) % iterations == 0
        moved = jnp.where(again, seeds[(count + 1) // iterations - 1], moved)
        return jnp.where(reached[..., None], q, moved), reached, count + 1

    def unfinished(carry: tuple[Array, Array, Array]) -> Array:
        _, reached, count = carry
        return ~reached.all() & (count < (restarts + 1) * iterations - 1)

    begun = (start, jnp.zeros(start.shape[:-1], bool), jnp.zeros((), jnp.int32))
    q, _, _ = jax.lax.while_loop(unfinished, advance, begun)
    _, _, _, distance, angle, reached = errors(q)
    return IKSolution(q, reached, distance, angle)


def _error(chain: Chain, q: Sequence[Array], target: Pose) -> tuple[Vec, Vec, list[tuple[Scalar, ...]]]:
    """Position error [m], rotation error [rad] from the tool to the target, and the Jacobian's columns."""
    frames = _frames(chain, q)
    linear = Vec(*_lanes(target.position)).minus(frames.position)
    angular = _rotation_error(frames.rotation, rotation_from_quaternion(*_lanes(target.quaternion)))
    return linear, angular, _columns(chain, frames)


def _rotation_error(current: Rotation, target: Rotation) -> Vec:
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
    angular: Vec,
    damping: Scalar,
    bound: float,
) -> list[Scalar]:
    """Joint vector after one step of at most `bound` a joint, inside the limits."""
    step = _least_squares(columns, (*linear, *angular), damping)
    longest = jnp.abs(step[0])
    for component in step[1:]:
        longest = jnp.maximum(longest, jnp.abs(component))
    scale = once(_shrink(bound, longest))
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
    bounded = [jnp.clip(r, -bound, bound) for r in repair]
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


def _clip(chain: Chain, q: Sequence[Scalar]) -> list[Scalar]:
    return [jnp.clip(a, low, high) for a, low, high in zip(q, chain.lower, chain.upper, strict=True)]
