"""Objects in MuJoCo that the arm's gripper pushes: what of it they touch, and where they are."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch

from reachlab.control.bodies import FAR, Bodies, Shape
from reachlab.control.planning.collision import BODY, TABLE
from reachlab.robots.files.gripper import TIPS
from reachlab.robots.robot import Robot
from reachlab.sims.objects import ROLLING, TURNING, mass_and_share, with_objects
from reachlab.tasks.task import Scene

OBJECT = "reachlab_object_"
"""Name of bodies and geoms that are added, before a number."""

SOFTNESS = (0.01, 1.0)
"""Time constant [s] and damping ratio of contacts (MuJoCo's `solref`): penetration stays below a millimetre."""

IMPRATIO = 10.0
"""Stiffness of friction over that of contact: with 1 objects creep by millimetres in seconds, with 10 by tenths."""

HALF = 0.02
"""Half the side of a body before it is put somewhere [m]."""

_Bit, _Geom = mujoco.mjtDisableBit, mujoco.mjtGeom


def add_objects(spec: mujoco.MjSpec, robot: Robot, scene: Scene) -> None:
    """Add objects of a scene, free to move, the table and the bodies that stand on it.

    These and the finger tips collide, nothing else. Friction is the pair's own, so that it is felt whatever a finger's
    or the table's is. Steps are to be of 5 ms at most.
    """
    option = spec.option
    option.disableflags &= ~int(_Bit.mjDSBL_CONTACT | _Bit.mjDSBL_CONSTRAINT)
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # 4.0.0 solves sparse ones wrongly
    option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, IMPRATIO
    for pair in spec.pairs:
        spec.delete(pair)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0  # only pairs collide
    plane, top = _Geom.mjGEOM_PLANE, [0.0, 0.0, robot.table_top]
    spec.worldbody.add_geom(name=TABLE, type=plane, size=[0, 0, 1], pos=top, contype=0, conaffinity=0)
    walls = [f"{BODY}{number}" for number in range(scene.fixed)]
    for wall in walls:
        spec.worldbody.add_geom(name=wall, type=_Geom.mjGEOM_BOX, size=[HALF] * 3, pos=FAR, contype=0, conaffinity=0)
    for number in range(scene.objects):
        name, kind = f"{OBJECT}{number}", mujoco.mjtGeom(scene.shape)
        # Its own mass and inertia, which a URDF's settings do not let MuJoCo infer; see `FreeBodies.become`.
        weight = {"mass": scene.mass, "inertia": [scene.mass * 2 * HALF**2 / 3] * 3, "ipos": [0.0, 0.0, 0.0]}
        body = spec.worldbody.add_body(name=name, pos=FAR, explicitinertial=True, **weight)
        body.add_freejoint(name=name)
        body.add_geom(name=name, type=kind, size=[HALF] * 3, mass=0.0, contype=0, conaffinity=0)
        for other in (TABLE, *walls):
            _add_pair(spec, name, other, scene.friction, rolls=kind == _Geom.mjGEOM_SPHERE)
        for tip in TIPS:
            _add_pair(spec, name, tip, scene.grip)
    for tip in TIPS:
        for other in (TABLE, *walls):
            _add_pair(spec, tip, other, 0.0)


def _add_pair(spec: mujoco.MjSpec, one: str, other: str, friction: float, *, rolls: bool = False) -> None:
    # Friction against rolling costs time, and only balls roll.
    pair = spec.add_pair(geomname1=one, geomname2=other, condim=6 if rolls else 4 if friction else 1)
    pair.solref = SOFTNESS
    pair.friction = [max(friction, 1e-5)] * 2 + [TURNING, ROLLING, ROLLING]


def _gyration(shape: Shape, size: np.ndarray) -> np.ndarray:
    """Principal moments of inertia `[..., 3]` m² of a kilogram of a shape with `size [..., 3]`, see `Bodies`."""
    square = np.square(size)
    if shape == Shape.BALL:
        return 0.4 * np.repeat(square[..., :1], 3, axis=-1)
    if shape == Shape.CYLINDER:
        tilting = square[..., 0] / 4 + square[..., 2] / 3
        return np.stack([tilting, tilting, square[..., 0] / 2], axis=-1)
    return (square.sum(axis=-1, keepdims=True) - square) / 3


class FreeBodies:
    """The last bodies of a scene, which move when they are touched.

    Attributes:
        count: how many.
        position, velocity: numbers of their poses in `qpos` `[K, 7]`, and of their velocities in `qvel` `[K, 6]`.
    """

    def __init__(self, batch: Batch, scene: Scene) -> None:
        """Objects of a scene, all of them there."""
        model, count = batch.model, scene.objects
        joints = [model.joint(f"{OBJECT}{number}") for number in range(count)]
        self.count, self._shape = count, scene.shape
        self.position = np.array([[*range(int(j.qposadr[0]), int(j.qposadr[0]) + 7)] for j in joints], int)
        self.velocity = np.array([[*range(int(j.dofadr[0]), int(j.dofadr[0]) + 6)] for j in joints], int)
        self._qpos, self._qvel, self._batch = batch.bind("qpos"), batch.bind("qvel"), batch
        self._geoms = [model.geom(f"{OBJECT}{number}").id for number in range(count)]
        self._bodies = [model.body(f"{OBJECT}{number}").id for number in range(count)]
        names = ("geom_size", "geom_rbound", "geom_aabb", "body_mass", "body_inertia", "pair_friction")
        self._size, self._bound, self._box, self._mass, self._inertia, self._friction = (
            map(batch.expand, names) if count else [np.zeros(0)] * len(names)
        )
        self._pairs = [
            [i for i in range(model.npair) if geom in (model.pair_geom1[i], model.pair_geom2[i])]
            for geom in self._geoms
        ]
        self._scene, self._rubbing, self._made = scene, model.pair_friction.copy(), np.zeros(0)

    def put(self, bodies: Bodies, rows: np.ndarray | None = None) -> None:
        """Put them where bodies `[B, K]`, in NumPy, have them; of `rows [B]`, or those that are not there already.

        What the engine knows in more digits stays as it is.
        """
        if not self.count:
            return
        asked = [np.asarray(part)[:, -self.count :] for part in (bodies.position, bodies.quaternion, bodies.velocity)]
        pose, moving = np.concatenate(asked[:2], axis=-1), asked[2]
        known = self._read()
        elsewhere = (pose != known[0]).any(axis=(1, 2)) | (moving != known[1]).any(axis=(1, 2))
        chosen = np.flatnonzero(elsewhere if rows is None else rows)
        self._qpos[chosen[:, None], self.position.ravel()] = pose[chosen].reshape(len(chosen), self.position.size)
        self._qvel[chosen[:, None], self.velocity.ravel()] = moving[chosen].reshape(len(chosen), self.velocity.size)

    def _read(self) -> tuple[np.ndarray, np.ndarray]:
        """Poses `[B, K, 7]` and velocities `[B, K, 6]` in single precision."""
        count = len(self._qpos), self.count
        pose, moving = self._qpos[:, self.position.ravel()], self._qvel[:, self.velocity.ravel()]
        return pose.astype(np.float32).reshape(*count, 7), moving.astype(np.float32).reshape(*count, 6)

    def become(self, bodies: Bodies, varied: np.ndarray) -> None:
        """Give them the size of `bodies [B, K]`, and mass and friction as `varied [B, 2]` in -1 to 1 says."""
        if not self.count:
            return
        size = np.asarray(bodies.size)[:, -self.count :].astype(np.float64)
        numbers = np.concatenate([size.reshape(len(size), -1), varied], axis=1)
        if np.array_equal(numbers, self._made):
            return
        self._made = numbers
        mass, share = mass_and_share(self._scene, varied)
        for pairs in self._pairs:
            self._friction[:, pairs, :2] = share[:, :, None] * self._rubbing[pairs, :2]
        cylinder = self._shape == Shape.CYLINDER
        self._size[:, self._geoms] = np.asarray(bodies.mujoco_size)[:, -self.count :]
        self._box[:, self._geoms, 3:] = size if self._shape != Shape.BALL else size[..., :1]
        self._bound[:, self._geoms] = np.linalg.norm(size[..., 1:] if cylinder else size, axis=-1)
        self._mass[:, self._bodies] = mass
        self._inertia[:, self._bodies] = mass[..., None] * _gyration(self._shape, size)
        self._batch.set_const()

    def now(self, bodies: Bodies) -> Bodies:
        """Bodies `[B, K]` with these where they are."""
        if not self.count:
            return bodies
        return with_objects(bodies, *self._read())
