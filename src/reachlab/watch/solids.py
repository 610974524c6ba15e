"""Triangle meshes of a compiled MuJoCo model, for viewers that know nothing of MuJoCo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

SEGMENTS = 32
"""Sides of a round shape; its profile has half as many."""

SHOWN_GROUPS = (0, 1, 2)
"""Groups of geoms that MuJoCo's own viewer shows at first."""

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
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, quaternion)
    return mesh[0] @ rotation.reshape(3, 3).T + position, mesh[1]


def _joined(meshes: list[Mesh]) -> Mesh:
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, first, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def _revolved(radii: np.ndarray, heights: np.ndarray) -> Mesh:
    """Surface of a profile `[p]`, bottom to top, turned about z; a point said twice makes an edge."""
    angles = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)
    x, y = radii[:, None] * np.cos(angles), radii[:, None] * np.sin(angles)
    vertices = np.stack([x, y, np.broadcast_to(heights[:, None], x.shape)], axis=-1).reshape(-1, 3)
    ring, side = np.meshgrid(np.arange(len(radii) - 1), np.arange(SEGMENTS), indexing="ij")
    a, b = ring * SEGMENTS + side, ring * SEGMENTS + (side + 1) % SEGMENTS
    quads = np.stack([a, b, b + SEGMENTS, a + SEGMENTS], axis=-1).reshape(-1, 4)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _ellipsoid(model: mujoco.MjModel, geom: int) -> Mesh:
    vertices, faces = _rounded(np.ones(1), 0.0)
    return vertices * model.geom_size[geom], faces


def _sphere(model: mujoco.MjModel, geom: int) -> Mesh:
    return _rounded(model.geom_size[geom][:1], 0.0)


def _capsule(model: mujoco.MjModel, geom: int) -> Mesh:
    return _rounded(model.geom_size[geom][:1], model.geom_size[geom][1])


def _rounded(radius: np.ndarray, half: float) -> Mesh:
    """A ball cut at its equator, its halves `half` above and below."""
    angles = np.linspace(-np.pi / 2, 0, SEGMENTS // 4 + 1)
    radii, heights = radius * np.cos(angles), radius * np.sin(angles) - half
    if half:
        return _revolved(np.append(radii, radii[::-1]), np.append(heights, -heights[::-1]))
    return _revolved(np.append(radii, radii[-2::-1]), np.append(heights, -heights[-2::-1]))


def _cylinder(model: mujoco.MjModel, geom: int) -> Mesh:
    radius, half, _ = model.geom_size[geom]
    return _revolved(radius * np.array([0, 1, 1, 1, 1, 0]), half * np.array([-1, -1, -1, 1, 1, 1]))


def _box(model: mujoco.MjModel, geom: int) -> Mesh:
    """Six sides that share no vertex, so that the edges stay sharp."""
    square = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
    turns = [np.roll(square, shift, axis=1) for shift in range(3)]
    # Mirrored at the centre a side would face inwards; in reverse order it faces outwards again.
    corners = np.concatenate([*turns, *(-turn[::-1] for turn in turns)])
    quads = np.arange(len(corners)).reshape(-1, 4)
    return corners * model.geom_size[geom], np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _mesh(model: mujoco.MjModel, geom: int) -> Mesh:
    """A mesh of the file; vertices are parted where its normals are, so that the edges stay sharp."""
    mesh = model.geom_dataid[geom]
    rows = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    pairs = np.stack([model.mesh_face[rows].ravel(), model.mesh_facenormal[rows].ravel()], axis=-1)
    corners, faces = np.unique(pairs, axis=0, return_inverse=True)
    return model.mesh_vert[model.mesh_vertadr[mesh] + corners[:, 0]].astype(float), faces.reshape(-1, 3)


SHAPES: dict[mujoco.mjtGeom, Callable[[mujoco.MjModel, int], Mesh]] = {
    mujoco.mjtGeom.mjGEOM_SPHERE: _sphere,
    mujoco.mjtGeom.mjGEOM_CAPSULE: _capsule,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: _ellipsoid,
    mujoco.mjtGeom.mjGEOM_CYLINDER: _cylinder,
    mujoco.mjtGeom.mjGEOM_BOX: _box,
    mujoco.mjtGeom.mjGEOM_MESH: _mesh,
}
"""Meshes of geoms by their type, in the geom's own frame."""
