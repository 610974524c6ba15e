"""Fingers of a hand in a file: where their tips are once MuJoCo has settled all that moves with the leading joints."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from reachlab.robots.files.gripper import BEYOND, PAD, Place
from reachlab.robots.kinematics.chain import path_of

TIP = 0.02
"""What of a finger is so near its end is its tip [m]."""

APART, STAYS = 0.005, 0.025
"""Tips of fingers come apart by more than the first, and stay apart by less than the second where they are closed
[m]."""

ALONG = np.cos(0.45)
"""Cosine of the angle to the axis of the last joint below which the hand points along that axis."""

DRIVEN, HELD = 0.05, 1e6
"""Share of the way of the joint that moves furthest from which on one is driven; inertia by which joints are held."""

STAGES, STEPS, STEP = 20, 100, 0.002
"""Stages in which a linkage is moved through its range, the engine's steps in each, and their length [s]."""


class UnrecognisedError(Exception):
    """A file has no gripper that can be driven; the sentence says why."""


@dataclass(frozen=True)
class Tip:
    """The end of a finger: the body that has it, and its points `[P, 3]` m in that body."""

    body: int
    points: np.ndarray


class FoundHand:
    """What is beyond an arm's last joint in a compiled file."""

    def __init__(self, model: mujoco.MjModel, arm: Sequence[int]) -> None:
        self.model, self._arm, self._last = model, arm, int(model.jnt_bodyid[arm[-1]])
        below = {body for body in range(model.nbody) if self._last in path_of(model, body)}
        self.rigid = set(np.flatnonzero(model.body_weldid == self._last).tolist())
        sliding = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        inside = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in below and j not in arm]
        self.joints = [j for j in inside if model.jnt_type[j] in sliding]
        self._moved = [body for body in sorted(below - self.rigid) if len(self._points(body))]
        self._data = mujoco.MjData(model)

    def ends(self, leads: Sequence[int]) -> dict[tuple[int, ...], np.ndarray]:
        """Positions `[nq]` of all joints, settled with each lead at its lower (0) or upper (1) limit."""
        which: list[tuple[int, ...]] = list(itertools.product((0, 1), repeat=len(leads)))
        places = {one: self._settled(leads, one) for one in which}
        if not np.isfinite(list(places.values())).all():
            raise UnrecognisedError("its linkage comes to no rest")
        return places

    def _settled(self, leads: Sequence[int], which: Sequence[int]) -> np.ndarray:
        model, held = self.model.__copy__(), [*self._arm, *leads]
        model.opt.timestep, model.opt.integrator = STEP, int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        model.opt.gravity[:] = 0.0
        bits = mujoco.mjtDisableBit
        model.opt.disableflags = int(bits.mjDSBL_CONTACT | bits.mjDSBL_ACTUATION)
        model.dof_armature[model.jnt_dofadr[held]] = HELD
        model.dof_frictionloss[:] = 0.0
        data, places = mujoco.MjData(model), model.jnt_qposadr[leads]
        mujoco.mj_setConst(model, data)
        begin, end = model.qpos0[places], [model.jnt_range[j][i] for j, i in zip(leads, which, strict=True)]
        mujoco.mj_resetData(model, data)
        alone = set(self.joints) <= set(leads)
        for stage in range(1, STAGES + 1):
            data.qpos[places] = begin + stage / STAGES * (end - begin)
            data.qvel[:] = 0.0
            if not alone:
                mujoco.mj_step(model, data, STEPS)
        fingers = model.jnt_qposadr[self.joints]
        place = model.qpos0.copy()
        place[fingers] = data.qpos[fingers]
        place[places] = end
        return place

    def tips(self, ends: dict[tuple[int, ...], np.ndarray], leads: int) -> tuple[Tip, Tip]:
        """The ends of the two fingers, what is farthest out on either side; of one that moves, and of the hand."""
        start = ends[(0,) * leads]
        moves = [
            {body: way for body in self._moved if np.linalg.norm(way := self._way(body, start, ends[one])) > APART / 2}
            for one in ([(1,)] if leads == 1 else [(1, 0), (0, 1)])
        ]
        if not all(moves):
            raise UnrecognisedError("none of what its joints move has a shape")
        first = max(moves[0], key=lambda body: self._far(body, start))
        others = moves[1] if leads == 2 else {b: w for b, w in moves[0].items() if w @ moves[0][first] < 0}
        if others:
            second = max(others, key=lambda body: self._far(body, start))
            return self._tip([first], start), self._tip([second], start)
        return self._tip([first], start), self._tip(sorted(self.rigid), start)

    def _points(self, body: int) -> np.ndarray:
        """Corners `[P, 3]` m of a body's shapes, in the body."""
        model, found = self.model, [np.zeros((0, 3))]
        for geom in np.flatnonzero(model.geom_bodyid == body):
            matrix, mesh = np.zeros(9), int(model.geom_dataid[geom])
            mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
            middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
            points = middle + half * np.array(list(itertools.product((-1, 1), repeat=3)))
            if model.geom_type[geom] == int(mujoco.mjtGeom.mjGEOM_MESH):
                first = model.mesh_vertadr[mesh]
                points = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
            found.append(model.geom_pos[geom] + points @ matrix.reshape(3, 3).T)
        return np.concatenate(found)

    def _at(self, place: np.ndarray) -> mujoco.MjData:
        self._data.qpos[:] = place
        mujoco.mj_kinematics(self.model, self._data)
        return self._data

    def world(self, place: np.ndarray, body: int, points: np.ndarray) -> np.ndarray:
        """Points `[P, 3]` m of a body in the world."""
        data = self._at(place)
        return data.xpos[body] + points @ data.xmat[body].reshape(3, 3).T

    def _far(self, body: int, place: np.ndarray) -> float:
        points = self.world(place, body, self._points(body))
        return float(np.linalg.norm(points - self._data.xpos[self._last], axis=1).max())

    def _way(self, body: int, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Way `[3]` m of what of a body is farthest out."""
        tip = self._tip([body], start)
        return (self.world(end, body, tip.points) - self.world(start, body, tip.points)).mean(axis=0)

    def _tip(self, bodies: Sequence[int], place: np.ndarray) -> Tip:
        """What of bodies, rigid to the first one, is farthest out."""
        data = self._at(place)
        points = np.concatenate([self.world(place, body, self._points(body)) for body in bodies])
        if not len(points):
            raise UnrecognisedError("its hand has no shape that a finger could close against")
        far = np.linalg.norm(points - data.xpos[self._last], axis=1)
        outer = points[far > far.max() - TIP]
        return Tip(bodies[0], (outer - data.xpos[bodies[0]]) @ data.xmat[bodies[0]].reshape(3, 3))

    def between(self, place: np.ndarray, tips: tuple[Tip, Tip]) -> np.ndarray:
        """Way `[3]` m from the middle of the second tip to that of the first."""
        one, other = (_middle(self.world(place, tip.body, tip.points)) for tip in tips)
        return one - other

    def distance(self, place: np.ndarray, tips: tuple[Tip, Tip]) -> float:
        """Distance between the middles of the tips [m]."""
        return float(np.linalg.norm(self.between(place, tips)))

    def frame(self, closed: np.ndarray, tips: tuple[Tip, Tip], way: np.ndarray) -> np.ndarray:
        """Axes of the grasp frame in columns `[3, 3]`: z out of the hand, y along the fingers' way to the first one."""
        one, other = (_middle(self.world(closed, tip.body, tip.points)) for tip in tips)
        data = self._at(closed)
        out = (one + other) / 2 - data.xpos[self._last]
        out, axis = out / np.linalg.norm(out), data.xaxis[self._arm[-1]]
        if abs(axis @ out) > ALONG:
            out = axis * np.sign(axis @ out)
        way = way / np.linalg.norm(way)
        aside = way - (way @ out) * out
        if np.linalg.norm(aside) < 1 - ALONG:
            raise UnrecognisedError("its fingers move along the hand, not towards each other")
        aside /= np.linalg.norm(aside)
        return np.stack([np.cross(aside, out), aside, out], axis=1)

    def _seen(self, place: np.ndarray, tips: tuple[Tip, Tip], frame: np.ndarray) -> list[np.ndarray]:
        """Points of the tips along the axes of a frame."""
        return [self.world(place, tip.body, tip.points) @ frame for tip in tips]

    def gaps(
        self, closed: np.ndarray, opened: np.ndarray, shares: np.ndarray, tips: tuple[Tip, Tip], frame: np.ndarray
    ) -> np.ndarray:
        """Room between the tips [m] at shares `[P]` of the way from closed to open."""
        path = [self._seen(closed + share * (opened - closed), tips, frame) for share in shares]
        return np.array([upper[:, 1].min() - lower[:, 1].max() for upper, lower in path])

    def pads(
        self, place: np.ndarray, tips: tuple[Tip, Tip], frame: np.ndarray
    ) -> tuple[tuple[Place, Place], Place, tuple[Tip, Tip]]:
        """Pads in front of the tips, the frame midway between them, and where they touch what is there."""
        upper, lower = self._seen(place, tips, frame)
        inner = np.array([upper[:, 1].min(), lower[:, 1].max()])
        both = np.concatenate([upper, lower])
        x, end = (both[:, 0].min() + both[:, 0].max()) / 2, min(upper[:, 2].max(), lower[:, 2].max())
        pads, faces = [], []
        for tip, y, side in zip(tips, inner, (1, -1), strict=True):
            pads.append(self._place(place, tip.body, frame @ (x, y + side * PAD[1], end - PAD[2]), frame))
            touch = self._place(place, tip.body, frame @ (x, y, end - BEYOND), frame)
            faces.append(Tip(tip.body, np.array([touch.position])))
        grasp = self._place(place, self._last, frame @ (x, inner.mean(), end - BEYOND), frame)
        return (pads[0], pads[1]), grasp, (faces[0], faces[1])

    def _place(self, place: np.ndarray, body: int, point: np.ndarray, frame: np.ndarray) -> Place:
        data = self._at(place)
        turn, quaternion = data.xmat[body].reshape(3, 3).T, np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, (turn @ frame).flatten())
        return Place(body, tuple((turn @ (point - data.xpos[body])).tolist()), tuple(quaternion.tolist()))


def _middle(points: np.ndarray) -> np.ndarray:
    return (points.min(axis=0) + points.max(axis=0)) / 2
