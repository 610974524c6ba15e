"""Triangle meshes of a compiled MuJoCo model, for viewers that know nothing of MuJoCo.

Importing trimesh, which could make the primitives, takes longer than all the rest of drawing the arm (0.2 s).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from reachlab.render.scene import SHOWN_GROUPS

SEGMENTS = 32
"""Sides of a round shape; its profile has half as many."""

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices `[v, 3]` [m] and the three vertices of each face `[f, 3]`, counter-clockwise from outside."""

Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, each 0 to 1."""


@dataclass(frozen=True)
class Solid:
    """All that a body shows in one colour: its mesh in the body's frame."""

    body: int
    colour: Colour
    vertices: np.ndarray
    faces: np.ndarray


def solids(model: mujoco.MjModel) -> list[Solid]:
    """The visible geometry of a model; infinite planes are not in it."""
    parts: dict[tuple[int, Colour], list[Mesh]] = {}
    for geom in range(model.ngeom):
        colour = _colour(model, geom)
        kind = mujoco.mjtGeom(model.geom_type[geom])
        if model.geom_group[geom] in SHOWN_GROUPS and colour[3] > 0 and kind in SHAPES:
            mesh = _moved(SHAPES[kind](model, geom), model.geom_pos[geom], model.geom_quat[geom])
            parts.setdefault((int(model.geom_bodyid[geom]), colour), []).append(mesh)
    return [Solid(body, colour, *_joined(meshes)) for (body, colour), meshes in parts.items()]


def _colour(model: mujoco.MjModel, geom: int) -> Colour:
    material = model.geom_matid[geom]
    red, green, blue, opacity = (model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]).tolist()
    return red, green, blue, opacity


def _moved(mesh: Mesh, position: np.ndarray, quaternion: np.ndarray) -> Mesh:
    return Rotation.from_quat(quaternion, scalar_first=True).apply(mesh[0]) + position, mesh[1]


def _joined(meshes: list[Mesh]) -> Mesh:
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, first, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def _split(quads: np.ndarray) -> np.ndarray:
    """Two triangles of each quadrilateral `[f, 4]`."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _revolved(radii: np.ndarray, heights: np.ndarray) -> Mesh:
    """Surface of a profile `[p]`, bottom to top, turned about z; a point that is given twice makes a sharp edge."""
    angles = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)
    x, y = radii[:, None] * np.cos(angles), radii[:, None] * np.sin(angles)
    vertices = np.stack(np.broadcast_arrays(x, y, heights[:, None]), axis=-1).reshape(-1, 3)
    rings = np.arange(len(vertices)).reshape(x.shape)
    lower, upper = rings[:-1], rings[1:]
    quads = np.stack([lower, np.roll(lower, -1, axis=1), np.roll(upper, -1, axis=1), upper], axis=-1)
    return vertices, _split(quads.reshape(-1, 4))


def _ball(radius: float, half: float = 0.0) -> Mesh:
    """A ball, its halves moved apart by `half` each."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, SEGMENTS // 2 + 2)  # an even number: no point on the equator
    return _revolved(radius * np.cos(angles), radius * np.sin(angles) + half * np.sign(angles))


def _ellipsoid(model: mujoco.MjModel, geom: int) -> Mesh:
    vertices, faces = _ball(1.0)
    return vertices * model.geom_size[geom], faces


def _cylinder(model: mujoco.MjModel, geom: int) -> Mesh:
    radius, half, _ = model.geom_size[geom]
    return _revolved(radius * np.array([0, 1, 1, 1, 1, 0]), half * np.array([-1, -1, -1, 1, 1, 1]))


def _box(model: mujoco.MjModel, geom: int) -> Mesh:
    """Six sides that share no vertex, so that the edges stay sharp."""
    square = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
    turns = [np.roll(square, shift, axis=1) for shift in range(3)]
    # Mirrored at the centre a side would face inwards; in reverse order it faces outwards again.
    corners = np.concatenate([*turns, *(-turn[::-1] for turn in turns)])
    return corners * model.geom_size[geom], _split(np.arange(len(corners)).reshape(-1, 4))


def _mesh(model: mujoco.MjModel, geom: int) -> Mesh:
    """A mesh of the file; vertices are split where its normals are, so that the edges stay sharp."""
    mesh = model.geom_dataid[geom]
    rows = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    pairs = np.stack([model.mesh_face[rows].ravel(), model.mesh_facenormal[rows].ravel()], axis=-1)
    corners, faces = np.unique(pairs, axis=0, return_inverse=True)
    return model.mesh_vert[model.mesh_vertadr[mesh] + corners[:, 0]].astype(float), faces.reshape(-1, 3)


SHAPES: dict[mujoco.mjtGeom, Callable[[mujoco.MjModel, int], Mesh]] = {
    mujoco.mjtGeom.mjGEOM_SPHERE: lambda model, geom: _ball(model.geom_size[geom, 0]),
    mujoco.mjtGeom.mjGEOM_CAPSULE: lambda model, geom: _ball(*model.geom_size[geom, :2]),
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: _ellipsoid,
    mujoco.mjtGeom.mjGEOM_CYLINDER: _cylinder,
    mujoco.mjtGeom.mjGEOM_BOX: _box,
    mujoco.mjtGeom.mjGEOM_MESH: _mesh,
}
"""Meshes of geoms by their type, in the geom's own frame."""
