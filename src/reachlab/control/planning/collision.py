"""Whether an arm is free among bodies: by MuJoCo, in microseconds, with the shapes that its contacts are judged by."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import mujoco
import numpy as np

from reachlab.control.planning.arm import Arm

NEAR = 0.1
"""Distance beyond which `distances` tells none apart [m]."""


RESOLUTION = 0.03
"""Distance between the points of a path that have to be free [rad]."""

LEAST_BOUND = 1e-6
"""Radius of the sphere around a ball without size [m]: of 0 MuJoCo takes it for a plane."""

FAR = (0.0, 0.0, -10.0)
"""Where bodies are that are not there [m]: below everything, so that nothing has to tell them apart."""

CAPSULE, BODY, TABLE = "reachlab_capsule_", "reachlab_body_", "reachlab_table"
"""Names of the geoms of what is judged by contacts, the first two before a number."""

_Geom = mujoco.mjtGeom


class Geoms(NamedTuple):
    """MuJoCo's arrays of the geoms that bodies are, `[..., K, *]`, by the names of the model's."""

    geom_type: np.ndarray
    geom_pos: np.ndarray
    geom_quat: np.ndarray
    geom_sameframe: np.ndarray
    geom_size: np.ndarray
    geom_rbound: np.ndarray


def geoms_of(bodies: Any) -> Geoms:
    """Bodies `[..., K]`, as `control.bodies` describes them and in NumPy, as MuJoCo has them."""
    size = np.asarray(bodies.size, np.float64)
    long = np.where(bodies.kind == int(_Geom.mjGEOM_BOX), np.linalg.norm(size, axis=-1), size[..., 0] + size[..., 1])
    return Geoms(
        geom_type=np.array(bodies.kind),
        geom_pos=np.array(bodies.position, np.float64),
        geom_quat=np.array(bodies.quaternion, np.float64),
        # `Batch.set_const` notes here which of them lie as the world does, whose pose they are then given.
        geom_sameframe=np.full(long.shape, mujoco.mjtSameFrame.mjSAMEFRAME_NONE),
        geom_size=size,
        geom_rbound=np.maximum(long, LEAST_BOUND),
    )


def arm_model(arm: Arm, count: int) -> mujoco.MjModel:
    """An arm as its capsules, the table and `count` bodies: what of them may not meet collides, and nothing else."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    link, links = spec.worldbody, [spec.worldbody]
    for frame, slides in zip(arm.frames[:-1], arm.slides, strict=True):
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, frame[:3, :3].ravel())
        link = link.add_body(pos=frame[:3, 3], quat=turn, mass=1.0, inertia=[1.0, 1.0, 1.0], explicitinertial=True)
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        link.add_joint(type=kind, axis=[0, 0, 1])
        links.append(link)
    capsules = zip(arm.links, arm.starts, arm.ends, arm.radii, strict=True)
    for number, (carrier, start, end, radius) in enumerate(capsules):
        add_capsule(links[carrier], number, start, end, radius)
    add_surroundings(spec, arm, arm.floors, arm.table, count)
    return spec.compile()


def add_capsule(holder: Any, number: int, start: np.ndarray, end: np.ndarray, radius: float) -> None:
    """Add a capsule of an arm to the body that holds it, from `start [3]` to `end [3]` in its frame [m]."""
    geom = holder.add_geom(name=f"{CAPSULE}{number}", size=[radius, 0, 0], mass=0)
    if (start == end).all():
        geom.type, geom.pos = _Geom.mjGEOM_SPHERE, start
    else:
        geom.type, geom.fromto = _Geom.mjGEOM_CAPSULE, np.concatenate([start, end])


def add_surroundings(spec: mujoco.MjSpec, shapes: Any, floors: Any, table: float, count: int) -> None:
    """Add the table, a plane at its height [m] without an edge, and `count` bodies; what may not meet collides.

    These are capsules of moving links and bodies, those of them and the table that `floors` say, and the shapes'
    `pairs`: these and `links` are as those of `Arm`.
    """
    spec.worldbody.add_geom(name=TABLE, type=_Geom.mjGEOM_PLANE, size=[0, 0, 1], pos=[0.0, 0.0, table])
    for number in range(count):
        spec.worldbody.add_geom(name=f"{BODY}{number}", type=_Geom.mjGEOM_SPHERE, size=[LEAST_BOUND] * 3, pos=FAR)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0  # only pairs collide
    pairs = []
    for number, floor in zip(np.flatnonzero(shapes.links), floors, strict=True):
        pairs += [(f"{CAPSULE}{number}", f"{BODY}{other}") for other in range(count)]
        pairs += [(f"{CAPSULE}{number}", TABLE)] * bool(floor)
    for one, other in (*pairs, *((f"{CAPSULE}{one}", f"{CAPSULE}{other}") for one, other in shapes.pairs)):
        spec.add_pair(geomname1=one, geomname2=other, condim=1, margin=0, gap=0)


class CollisionChecker:
    """An arm, the table and room for bodies."""

    def __init__(self, arm: Arm, count: int) -> None:
        """Of an arm, and with room for so many bodies."""
        self._model = model = arm_model(arm, count)
        self._n, self._data = arm.n, mujoco.MjData(model)
        self._bodies = [model.geom(f"{BODY}{number}").id for number in range(count)]
        holders = model.geom_bodyid[np.stack([model.pair_geom1, model.pair_geom2])]
        self._own = holders.min(axis=0) > 0

    def place(self, bodies: Any) -> None:
        """Put bodies `[K]` where they are, see `geoms_of`."""
        for name, numbers in geoms_of(bodies)._asdict().items():
            getattr(self._model, name)[self._bodies] = numbers

    def keep(self, outside: float, own: float) -> None:
        """Count as free what is so far from bodies and the table, and links that are so far from each other [m]."""
        self._model.pair_margin[:] = np.where(self._own, own, outside)

    def free(self, q: np.ndarray) -> bool:
        """Whether the arm is free at joints `q [n]`."""
        data = self._data
        data.qpos[: self._n] = q
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_collision(self._model, data)
        return data.ncon == 0

    def straight(self, start: np.ndarray, end: np.ndarray, resolution: float = RESOLUTION) -> bool:
        """Whether the arm is free on the straight way between joints `[n]`, at points so far apart [rad]."""
        way = end - start
        return all(self.free(start + share * way) for share in _shares(int(np.linalg.norm(way) / resolution)))

    def distances(self, q: np.ndarray) -> tuple[float, float]:
        """Distance of the arm at joints `q [n]` from bodies and the table, and of its links from each other [m]."""
        before = self._model.pair_margin.copy()
        self.keep(NEAR, NEAR)
        self.free(q)
        self._model.pair_margin[:] = before
        contacts = self._data.contact
        own = (self._model.geom_bodyid[contacts.geom] > 0).all(axis=1)
        return min(contacts.dist[~own], default=NEAR), min(contacts.dist[own], default=NEAR)


@functools.cache
def _shares(between: int) -> np.ndarray:
    """Shares of a way at which it is looked at `[between + 2]`: its ends first, then such that gaps are halved."""
    order = sorted(range(between + 1), key=lambda number: f"{number:016b}"[::-1])
    return np.array([between + 1, *order]) / (between + 1)
