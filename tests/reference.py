"""Kinematics in float64 NumPy, on plain 4 x 4 matrices: what the compiled ones are checked against.

Written from MuJoCo's documentation of joints and shares no code with `reachlab.robots.kinematics.forward`, only the
named bounds of its inverse-kinematics step. Joint vectors are `[B, n]`, quaternions w, x, y, z.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from reachlab.robots.kinematics.inverse import DAMPING, MAX_JOINT_STEP, MAX_TURN


def rotation_matrix(quaternion):
    """Rotation matrices `[..., 3, 3]` of unit quaternions `[..., 4]`."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, np.float64), -1, 0)
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def quaternion(rotation):
    """Unit quaternions `[..., 4]`, `w >= 0`, of rotation matrices: an eigenvector (Bar-Itzhack, 2000)."""
    r = np.asarray(rotation, np.float64)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(r, (-2, -1), (0, 1))
    matrix = [
        [xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, yy - xx - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, zz - xx - yy],
    ]
    largest = np.linalg.eigh(np.stack([np.stack(row, -1) for row in matrix], -2))[1][..., -1]
    return np.where(largest[..., :1] < 0, -largest, largest)


def random_quaternions(rng, *shape):
    """Uniform unit quaternions `[*shape, 4]`."""
    normal = rng.normal(size=(*shape, 4))
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def angle_between(a, b):
    """Angle [rad] between rotations given as unit quaternions `[..., 4]`, whatever their signs."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    chord = np.minimum(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return 4 * np.arcsin(np.clip(chord / 2, 0, 1))


def _transforms(rotation, position):
    result = np.zeros((*np.broadcast_shapes(rotation.shape[:-2], position.shape[:-1]), 4, 4))
    result[..., :3, :3], result[..., :3, 3], result[..., 3, 3] = rotation, position, 1.0
    return result


def _turns(axis, angle):
    """Rotations `[B, 3, 3]` by `angle [B]` about a fixed unit axis (Rodrigues)."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + s * k + (1 - c) * (k @ k)


@dataclass(frozen=True)
class Solved:
    """One inverse-kinematics step: the joint vectors, and what tells how far float32 may stray from them."""

    q: np.ndarray
    clipped_only: np.ndarray
    """The same without the second solve `[B, n]`."""
    unclipped: np.ndarray
    """The first solve alone, limits ignored `[B, n]`."""
    condition: np.ndarray
    """The worst condition number of the damped matrices that were solved `[B]`."""
    length: np.ndarray
    """Largest joint displacement of the first solve before it was shortened `[B]`."""


class Arm:
    """The joints between the world and a site or body, as MuJoCo's compiled model states them."""

    def __init__(self, model, tool):
        self.model = model
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tool)
        self.tip = np.eye(4)
        if site >= 0:
            self.tip = _transforms(rotation_matrix(model.site_quat[site]), model.site_pos[site])
        body = int(model.site_bodyid[site]) if site >= 0 else int(model.body(tool).id)
        self.bodies = []
        while body:
            self.bodies.insert(0, body)
            body = int(model.body_parentid[body])
        adr, num = model.body_jntadr, model.body_jntnum
        self.joints = [j for b in self.bodies for j in range(adr[b], adr[b] + num[b])]
        self.n = len(self.joints)
        limited = model.jnt_limited[self.joints].astype(bool)
        self.lower = np.where(limited, model.jnt_range[self.joints, 0], -np.inf)
        self.upper = np.where(limited, model.jnt_range[self.joints, 1], np.inf)

    def sample(self, rng, count, within=1.0):
        """Joint vectors `[count, n]`, uniform in the middle part `within` of the limits (±π, ±1 m without)."""
        lower, upper = np.clip(self.lower, -np.pi, np.pi), np.clip(self.upper, -np.pi, np.pi)
        middle, half = (lower + upper) / 2, (upper - lower) / 2
        return (middle + within * half * rng.uniform(-1, 1, (count, self.n))).astype(np.float32)

    def frames(self, q):
        """Tool transforms `[B, 4, 4]`, and each joint's world axis and anchor `[B, 3]`."""
        q = np.asarray(q, np.float64)
        m = self.model
        pose = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        axes, anchors = [], []
        for b in self.bodies:
            pose = pose @ _transforms(rotation_matrix(m.body_quat[b]), m.body_pos[b])
            for j in range(m.body_jntadr[b], m.body_jntadr[b] + m.body_jntnum[b]):
                axis, anchor = m.jnt_axis[j], m.jnt_pos[j]
                moved = q[:, self.joints.index(j)] - m.qpos0[m.jnt_qposadr[j]]
                axes.append(pose[:, :3, :3] @ axis)
                anchors.append(pose[:, :3, :3] @ anchor + pose[:, :3, 3])
                if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE:
                    pose = pose @ _transforms(np.eye(3), moved[:, None] * axis)
                else:
                    turn = _turns(axis, moved)
                    pose = pose @ _transforms(turn, anchor - turn @ anchor)
        return pose @ self.tip, axes, anchors

    def forward(self, q):
        """Tool positions `[B, 3]` and quaternions `[B, 4]`."""
        pose = self.frames(q)[0]
        return pose[:, :3, 3], quaternion(pose[:, :3, :3])

    def jacobian(self, q):
        """Geometric Jacobian `[B, 6, n]`, linear rows first."""
        pose, axes, anchors = self.frames(q)
        columns = []
        for j, axis, anchor in zip(self.joints, axes, anchors, strict=True):
            slide = self.model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
            linear = axis if slide else np.cross(axis, pose[:, :3, 3] - anchor)
            columns.append(np.concatenate([linear, 0 * axis if slide else axis], -1))
        return np.stack(columns, -1)

    def numeric_jacobian(self, q, step=1e-6):
        """The same by central differences of `frames`."""
        q = np.asarray(q, np.float64)
        rotation = self.frames(q)[0][:, :3, :3]
        columns = []
        for i in range(self.n):
            ahead, behind = (self.frames(q + sign * step * np.eye(self.n)[i])[0] for sign in (1, -1))
            rate = (ahead - behind) / (2 * step)
            spin = rate[:, :3, :3] @ rotation.transpose(0, 2, 1)
            angular = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1)
            columns.append(np.concatenate([rate[:, :3, 3], angular], -1))
        return np.stack(columns, -1)

    def ik_step(self, q, position, target_quaternion):
        """One damped least-squares step, by the rules that `kinematics.ik_displace` documents."""
        q = np.asarray(q, np.float64)
        pose = self.frames(q)[0]
        jacobian = self.jacobian(q)
        linear = np.asarray(position, np.float64) - pose[:, :3, 3]
        turn = rotation_matrix(target_quaternion) @ pose[:, :3, :3].transpose(0, 2, 1)
        angular = 2 * quaternion(turn)[:, 1:]
        angular = angular * (MAX_TURN / np.maximum(np.linalg.norm(angular, axis=1), MAX_TURN))[:, None]

        step, first = _damped(jacobian, np.concatenate([linear, angular], 1))
        length = np.abs(step).max(1)
        scale = (MAX_JOINT_STEP / np.maximum(length, MAX_JOINT_STEP))[:, None]
        unclipped = q + scale * step
        clipped = np.clip(unclipped, self.lower, self.upper)

        left = scale * linear - np.einsum("bij,bj->bi", jacobian[:, :3], clipped - q)
        free = (clipped > self.lower) & (clipped < self.upper)
        repair, second = _damped(jacobian[:, :3] * free[:, None], left)
        repair = repair * MAX_JOINT_STEP / np.maximum(np.abs(repair).max(axis=1, keepdims=True), MAX_JOINT_STEP)
        repaired = np.clip(clipped + repair, self.lower, self.upper)
        return Solved(repaired, clipped, unclipped, np.maximum(first, second), length)


def _damped(jacobian, error):
    """Solutions `[B, n]` of the damped normal equations, and their condition numbers `[B]`."""
    transpose = jacobian.transpose(0, 2, 1)
    gram = jacobian @ transpose + DAMPING * np.eye(jacobian.shape[1])
    weights = np.linalg.solve(gram, error[..., None])
    return (transpose @ weights)[..., 0], np.linalg.cond(gram)
