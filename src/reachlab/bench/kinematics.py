"""Suite `kinematics`: accuracy of forward kinematics, Jacobian and inverse kinematics."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax import Array

from reachlab.bench.table import Row, row
from reachlab.bench.timing import shortest_time
from reachlab.jax_setup import jit
from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.forward import forward_kinematics, jacobian
from reachlab.robots.kinematics.inverse import inverse_kinematics
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot

POSES = 10_000
"""Random joint vectors that are compared."""

NEAR, ALIGNED = 1e-4, 1e-3
"""Errors up to which inverse kinematics has solved a pose [m, rad]."""

DIFFERENCE = 1e-6
"""Step of the central differences [rad]."""


def kinematics() -> Iterator[Row]:
    """Accuracy of forward kinematics, Jacobian and inverse kinematics."""
    robot = load_robot("iiwa14")
    chain = robot.chain
    generator = np.random.default_rng(0)
    q64 = generator.uniform(chain.lower, chain.upper, (POSES, chain.n))
    q = jnp.asarray(q64, jnp.float32)
    position, quaternion = _mujoco_poses(robot, np.asarray(q, np.float64))
    pose = jit(lambda q: forward_kinematics(chain, q))(q)
    error = np.linalg.norm(np.asarray(pose.position) - position, axis=-1).max()
    angle = _angles(np.asarray(pose.quaternion, np.float64), quaternion).max()
    yield row("forward_kinematics_error", error, "m", poses=POSES, against="MuJoCo")
    yield row("forward_kinematics_angle_error", angle, "rad", poses=POSES, against="MuJoCo")
    yield row("jacobian_error", _jacobian_error(robot, q), "relative", poses=POSES, against="central differences")
    yield from _inverse(chain, robot, q)


def _mujoco_poses(robot: Robot, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tool positions and quaternions of MuJoCo, in float64."""
    model = robot.spec().compile()
    data, site = mujoco.MjData(model), model.site(robot.tool).id
    positions, quaternions = np.empty((len(q), 3)), np.empty((len(q), 4))
    for i, joints in enumerate(q):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        positions[i] = data.site_xpos[site]
        mujoco.mju_mat2Quat(quaternions[i], data.site_xmat[site])
    return positions, quaternions


def _angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between unit quaternions [rad]; by the arc sine, since the arc cosine is inaccurate near zero."""
    a, b = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (a, b))
    chord = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return 4 * np.arcsin(chord / 2)


def _jacobian_error(robot: Robot, q: Array) -> float:
    """Largest error of a Jacobian's linear part against MuJoCo's positions, relative to its largest entry."""
    ours = np.asarray(jit(lambda q: jacobian(robot.chain, q))(q))[:, :3]
    centre = np.asarray(q, np.float64)
    numeric = np.empty_like(ours, dtype=np.float64)
    for joint in range(robot.chain.n):
        step = DIFFERENCE * np.eye(robot.chain.n)[joint]
        ahead, behind = _mujoco_poses(robot, centre + step)[0], _mujoco_poses(robot, centre - step)[0]
        numeric[:, :, joint] = (ahead - behind) / (2 * DIFFERENCE)
    return float((np.abs(ours - numeric).max((1, 2)) / np.abs(numeric).max((1, 2))).max())


def _inverse(chain: Chain, robot: Robot, q: Array) -> Iterator[Row]:
    pose = jit(lambda q: forward_kinematics(chain, q))(q)
    home = jnp.asarray(robot.home)
    solve = jit(lambda pose, key: inverse_kinematics(chain, pose, home, key))
    solution = solve(pose, jax.random.key(0))
    position, quaternion = _mujoco_poses(robot, np.asarray(solution.q, np.float64))
    wanted_position, wanted_quaternion = _mujoco_poses(robot, np.asarray(q, np.float64))
    near = np.linalg.norm(position - wanted_position, axis=-1) <= NEAR
    aligned = _angles(quaternion, wanted_quaternion) <= ALIGNED
    inside = (np.asarray(solution.q) >= chain.lower).all() and (np.asarray(solution.q) <= chain.upper).all()
    yield row("ik_success", (near & aligned).mean(), "rate", poses=POSES, within="0.1 mm and 1e-3 rad")
    yield row("ik_claimed", np.asarray(solution.converged).mean(), "rate", poses=POSES)
    yield row("ik_sound", float(inside and np.isfinite(np.asarray(solution.q)).all()), "1 = limits kept, no NaN")
    seconds = shortest_time(lambda: solve(pose, jax.random.key(0)), repeats=2)
    yield row("ik_time_per_pose", seconds / POSES * 1e6, "µs", poses=POSES, num_envs=POSES)
