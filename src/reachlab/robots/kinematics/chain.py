"""A serial chain of hinge and slide joints, taken from a compiled MuJoCo model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from reachlab.robots.kinematics.limits import position_limits
from reachlab.robots.kinematics.scalars import Rotation, Vec, rotation_from_quaternion
from reachlab.robots.kinematics.transforms import joint_transforms, moved_links

DECIMALS = 12
"""Decimals of the constants of a joint frame [m or 1]: one that is 0 or 1 but for float64's rounding is that number."""

NOISE_OF_SLIDES = 0.1
"""Share of a slide's way by which it is away from home at most where an episode begins: 0.3 m may be all of it."""

ROUND_TO_EXACT = 1e-12
"""What is this close to 0 is."""


@dataclass(frozen=True)
class Chain:
    """A serial chain; constants of the robot, known while tracing.

    The pose of the tool is `F_0 J_0(q_0) F_1 J_1(q_1) ... F_n`, where `J_i` turns about the z axis of
    its frame (hinge) or moves along it (slide).

    Attributes:
        frames: the fixed transforms `F_0 ... F_n`, `n + 1` pairs of rotation and position [m].
        slides: for each joint, whether it slides.
        lower, upper: joint limits [rad or m].
        approach: the axis of the tool's frame along which the tool points, a unit vector `[3]`.
    """

    frames: tuple[tuple[Rotation, Vec], ...]
    slides: tuple[bool, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    approach: tuple[float, ...] = (0.0, 0.0, 1.0)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.slides)

    @property
    def poses(self) -> bool:
        """Whether it has the six joints that an orientation takes; with fewer the tool's tilt alone is held."""
        return self.n >= JOINTS_OF_A_POSE

    @property
    def longest(self) -> float:
        """Length of all its offsets and slides in one line [m]; the tool is never further from the base's frame."""
        offsets = sum(float(np.linalg.norm(np.array(offset))) for _, offset in self.frames)
        limits = zip(self.lower, self.upper, self.slides, strict=True)
        return offsets + sum(max(abs(low), abs(high)) for low, high, slides in limits if slides)

    def noise(self, most: float) -> float | np.ndarray:
        """How far from home joints begin `[n]`: by `most` [rad or m], slides by no more than a share of their way."""
        if not any(self.slides):
            return most
        return np.where(self.slides, np.minimum(most, NOISE_OF_SLIDES * np.subtract(self.upper, self.lower)), most)

    def tool_at(self, q: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position `[3]` m and quaternion `[4]` wxyz of the tool at one joint vector `[n]`, without JAX."""
        transform = self.tools_at(q)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, transform[:3, :3].ravel())
        return transform[:3, 3], quaternion

    def tools_at(self, q: Sequence[float] | np.ndarray) -> np.ndarray:
        """Transforms `[..., 4, 4]` of the tool at joint vectors `[..., n]`, without JAX."""
        return self.links_at(q)[..., -1, :, :] @ self.between[-1]

    @property
    def between(self) -> np.ndarray:
        """The fixed transforms as matrices `[n + 1, 4, 4]`."""
        return np.stack([_matrix(*frame) for frame in self.frames])

    def links_at(self, q: Sequence[float] | np.ndarray) -> np.ndarray:
        """Transforms `[..., n + 1, 4, 4]` of the links at joint vectors `[..., n]`, without JAX.

        Link 0 is the base, in the world's frame; link `k + 1` is what joint `k` moves, in the frame `F_0 J_0 ... J_k`.
        """
        values = np.asarray(q, float)
        base = np.broadcast_to(np.eye(4), (*values.shape[:-1], 4, 4))
        return np.stack([base, *moved_links(self.between, self.slides, values)], axis=-3)


class PosedChain(Chain):
    """The same, of which whole orientations are asked also where there are fewer than six joints: some can be had."""

    @property
    def poses(self) -> bool:
        """Whether it is asked for orientations."""
        return True


DIGITS = 6
"""Significant digits of what is derived and then kept, compared or printed: its last bits depend on the CPU."""


def significant(value: float, digits: int = DIGITS) -> float:
    """The number nearest to `value` of so many significant decimal digits."""
    return float(f"{value:.{digits}g}")


JOINTS_OF_A_POSE = 6
"""Joints that place a tool in any orientation."""

AHEAD = 0.3
"""The tool points along its last joint's axis if so much of the way from the joint before to the tool lies along it."""


def path_joints(model: mujoco.MjModel, tool: str, base: int = 0) -> list[int]:
    """Numbers of the joints between a body and the site or body `tool`, base to tool; without free ones.

    Raises:
        ValueError: no such site or body, or it is not moved by the body's joints.
    """
    first, *path = path_of(model, tool_body(model, tool)[0], base)
    if first != base:
        raise ValueError(f"tool {tool!r} is not held by base {model.body(base).name!r}")
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    joints = [joint for body in path for joint in _joints(model, body) if model.jnt_type[joint] != free]
    if not joints:
        raise ValueError(f"no joint moves tool {tool!r}")
    return joints


def moving_joints(model: mujoco.MjModel, body: int) -> set[int]:
    """Numbers of the joints that move a body."""
    return {joint for one in path_of(model, body) for joint in _joints(model, one)}


def chain_from_model(model: mujoco.MjModel, tool: str) -> Chain:
    """Chain from the world to the site or body `tool` of a compiled MuJoCo model, which joints move.

    Raises:
        ValueError: no such site or body, or a ball or free joint on the way.
    """
    last, tip = tool_body(model, tool)
    frames, slides, limits = [], [], []
    transform = np.eye(4)
    for body in path_of(model, last)[1:]:
        transform = transform @ _transform(model.body_pos[body], model.body_quat[body])
        for joint in _joints(model, body):
            kind = mujoco.mjtJoint(model.jnt_type[joint])
            slide = kind == mujoco.mjtJoint.mjJNT_SLIDE
            if not slide and kind != mujoco.mjtJoint.mjJNT_HINGE:
                what, name = kind.name.removeprefix("mjJNT_").lower(), model.joint(joint).name
                raise ValueError(f"joint {name!r} is a {what} joint; a chain takes hinge and slide joints only")
            align = _align_z(model.jnt_pos[joint], model.jnt_axis[joint])
            reference = float(model.qpos0[model.jnt_qposadr[joint]])
            frames.append(transform @ align @ joint_transforms([slide], [-reference])[0])
            transform = np.linalg.inv(align)
            slides.append(slide)
            limits.append(position_limits(model, joint))
    frames.append(transform @ tip)
    lower, upper = zip(*limits, strict=True)
    return Chain(tuple(map(_constants, frames)), tuple(slides), lower, upper, _approach(frames, slides[-1]))


def path_of(model: mujoco.MjModel, body: int, base: int = 0) -> list[int]:
    """Bodies from a base, or the world where that does not hold it, to a body."""
    path = [body]
    while path[0] not in (0, base):
        path.insert(0, int(model.body_parentid[path[0]]))
    return path


def _joints(model: mujoco.MjModel, body: int) -> range:
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _approach(frames: list[np.ndarray], slide: bool) -> tuple[float, ...]:
    """The last joint's axis, away from the joint before; of a wrist that does not turn about it, the way to the tool.

    All in the frame of the last joint, then in the tool's.
    """
    before, last = frames[-2:]
    to_tool = last[:3, 3]
    way = to_tool + before[:3, :3].T @ before[:3, 3]
    axis = np.array([0.0, 0.0, -1.0 if way[2] < 0 else 1.0])
    if not slide and abs(way[2]) < AHEAD * np.linalg.norm(way) and np.linalg.norm(to_tool) > ROUND_TO_EXACT:
        axis = to_tool / np.linalg.norm(to_tool)
    return tuple((np.round(last[:3, :3].T @ axis, DECIMALS) + 0.0).tolist())


def tool_body(model: mujoco.MjModel, tool: str) -> tuple[int, np.ndarray]:
    """The body that holds a site, or is the body, `tool`, and the transform from its frame to the tool's.

    Raises:
        ValueError: no such site or body.
    """
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tool)
    if site >= 0:
        return int(model.site_bodyid[site]), _transform(model.site_pos[site], model.site_quat[site])
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tool)
    if body < 0:
        raise ValueError(
            f"tool {tool!r} is neither a site nor a body of the model, which has the sites"
            f" {listed(model.site, model.nsite)} and the bodies {listed(model.body, model.nbody)}"
        )
    return body, np.eye(4)


def listed(of: Callable[[int], Any], count: int) -> str:
    """The names of a model's sites or bodies, given how one is found by its number, and how many there are."""
    return ", ".join(name for name in (str(of(i).name) for i in range(count)) if name not in ("", "world")) or "(none)"


def _transform(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = (float(c) for c in np.asarray(quaternion) / np.linalg.norm(quaternion))
    return _matrix(rotation_from_quaternion(w, x, y, z), position)


def _align_z(position: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Transform to a frame at `position` whose z is `axis`, by the shortest turn."""
    axis = axis / np.linalg.norm(axis)
    half = np.array([1.0 + axis[2], -axis[1], axis[0], 0.0])
    return _transform(position, half if half[0] > ROUND_TO_EXACT else np.array([0.0, 1.0, 0.0, 0.0]))


def _matrix(rotation: Rotation, offset: Vec | np.ndarray) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = np.array(rotation).T, offset
    return transform


def _constants(transform: np.ndarray) -> tuple[Rotation, Vec]:
    exact = np.round(transform, DECIMALS) + 0.0
    rotation = Rotation(*(Vec(*(float(c) for c in column)) for column in exact[:3, :3].T))
    return rotation, Vec(*(float(c) for c in exact[:3, 3]))
