"""What an arm among obstacles can touch in MuJoCo: itself, the table and obstacles that differ between simulations."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from mujoco.batch import Batch

from reachlab.render.scene import table_top
from reachlab.robots.pictures import without_shapes
from reachlab.robots.robot import Robot
from reachlab.tasks.obstacles import FAR, Obstacles

CAPSULE, OBSTACLE, TABLE = "reachlab_capsule_", "reachlab_obstacle_", "reachlab_table"
"""Names of the geoms that are added, the first two before a number."""

NUMBERS = 11
"""Numbers of an obstacle: position, orientation, half sizes, radius."""

ABSENT = (*FAR, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Those of one that is not there."""

LEAST_BOUND = 1e-6
"""Radius of the sphere around a ball without size [m]: of 0 MuJoCo takes it for a plane."""

_Bit, _Geom = mujoco.mjtDisableBit, mujoco.mjtGeom


def add_contacts(spec: mujoco.MjSpec, robot: Robot, count: int) -> None:
    """Add the arm's capsules, the table and `count` obstacles, and what of them may not meet.

    These are capsules of moving links and obstacles, those capsules and the table, and `Capsules.pairs`. Nothing else
    collides: the file's own shapes are taken out where no inertia follows from them. The table is the plane of its top,
    without an edge. What `Robot.floors` allows to be anywhere does not touch it.

    Contacts have no friction, and the Jacobian is dense: 4.0.0 solves sparse ones wrongly.
    """
    spec.option.disableflags &= ~int(_Bit.mjDSBL_CONTACT | _Bit.mjDSBL_CONSTRAINT)
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    for pair in spec.pairs:
        spec.delete(pair)
    without_shapes(spec)
    _add_capsules(spec, robot)
    top = [0.0, 0.0, table_top(robot)]
    spec.worldbody.add_geom(name=TABLE, type=_Geom.mjGEOM_PLANE, size=[0, 0, 1], pos=top)
    for number in range(count):
        spec.worldbody.add_geom(name=f"{OBSTACLE}{number}", type=_Geom.mjGEOM_SPHERE, size=[LEAST_BOUND] * 3, pos=FAR)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0  # only pairs collide
    for one, other in _pairs(robot, count):
        spec.add_pair(geomname1=one, geomname2=other, condim=1, margin=0, gap=0)


def _add_capsules(spec: mujoco.MjSpec, robot: Robot) -> None:
    model, capsules, joints = robot.spec(pictures=False).compile(), robot.capsules, spec.joints
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[: robot.chain.n]] = robot.home
    mujoco.mj_kinematics(model, data)
    frames = robot.chain.links_at(robot.home)
    for number, link in enumerate(capsules.links):
        body = int(model.jnt_bodyid[link - 1]) if link else 0
        holder = joints[link - 1].parent if link else spec.worldbody
        turn, place = data.xmat[body].reshape(3, 3), data.xpos[body]
        ends = [frames[link] @ (*end, 1.0) for end in (capsules.starts[number], capsules.ends[number])]
        start, end = ((end[:3] - place) @ turn for end in ends)
        geom = holder.add_geom(name=f"{CAPSULE}{number}", size=[capsules.radii[number], 0, 0], mass=0)
        if capsules.starts[number] == capsules.ends[number]:
            geom.type, geom.pos = _Geom.mjGEOM_SPHERE, start
        else:
            geom.type, geom.fromto = _Geom.mjGEOM_CAPSULE, np.concatenate([start, end])


def _pairs(robot: Robot, count: int) -> Iterator[tuple[str, str]]:
    """Names of the geoms, two by two, that may not meet."""
    capsules = robot.capsules
    for number, floor in zip(np.flatnonzero(capsules.links), robot.floors, strict=True):
        yield from ((f"{CAPSULE}{number}", f"{OBSTACLE}{other}") for other in range(count))
        if np.isfinite(floor):
            yield f"{CAPSULE}{number}", TABLE
    yield from ((f"{CAPSULE}{one}", f"{CAPSULE}{other}") for one, other in capsules.pairs)


class Scenes:
    """Obstacles that differ between simulations: `numbers [B, K NUMBERS]`."""

    def __init__(self, batch: Batch) -> None:
        """None of them is there yet."""
        model = batch.model
        self._geoms = [geom for geom in range(model.ngeom) if model.geom(geom).name.startswith(OBSTACLE)]
        names = ("geom_type", "geom_pos", "geom_quat", "geom_sameframe", "geom_size", "geom_rbound")
        self._type, self._position, self._quaternion, self._frame, self._size, self._bound = map(batch.expand, names)
        self.numbers = np.tile(ABSENT, (batch.nsim, len(self._geoms)))

    @staticmethod
    def numbers_of(obstacles: Obstacles) -> np.ndarray:
        """Obstacles `[B, K, ...]` as numbers `[B, K NUMBERS]`."""
        radius = np.asarray(obstacles.radius)[..., None]
        parts = (obstacles.position, obstacles.quaternion, obstacles.half, radius)
        return np.concatenate(parts, axis=-1, dtype=np.float64).reshape(len(radius), -1)

    def become(self, numbers: np.ndarray) -> None:
        """Put obstacles where `numbers` has them."""
        if np.array_equal(numbers, self.numbers):
            return
        self.numbers = np.array(numbers)
        parts = np.split(self.numbers.reshape(len(numbers), -1, NUMBERS), (3, 7, 10), axis=2)
        position, quaternion, half, radius = parts
        box, long = half[..., :1] > 0, half[..., 2:] > 0
        kind = np.where(box, _Geom.mjGEOM_BOX, np.where(long, _Geom.mjGEOM_CAPSULE, _Geom.mjGEOM_SPHERE))
        rounded = np.concatenate([radius, half[..., 2:], np.zeros_like(radius)], axis=2)
        bound = np.linalg.norm(half, axis=2) + radius[..., 0]
        self._type[:, self._geoms] = kind[..., 0]
        self._position[:, self._geoms] = position
        self._quaternion[:, self._geoms] = quaternion
        # `Batch.set_const` notes here which of them lie as the world does, whose pose they are then given.
        self._frame[:, self._geoms] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        self._size[:, self._geoms] = np.where(box, half, rounded)
        self._bound[:, self._geoms] = np.maximum(bound, LEAST_BOUND)
