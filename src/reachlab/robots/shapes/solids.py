"""Triangle meshes of the geoms of a compiled MuJoCo model.

Importing trimesh, which could make the primitives, takes longer than all the rest of drawing the arm (0.2 s); importing
scipy's rotations takes as long.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

SHOWN_GROUPS = (0, 1, 2)
"""Groups of geoms that MuJoCo shows at first."""

SEGMENTS = 32
"""Sides of a round shape; its profile has half as many."""

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices `[v, 3]` [m] and the three vertices of each face `[f, 3]`, counter-clockwise from outside."""


def mesh_of(model: mujoco.MjModel, geom: int) -> Mesh:
    """The mesh of a geom, of a type in `SOLID`, in the frame of its body."""
    kind = mujoco.mjtGeom(model.geom_type[geom])
    vertices, faces = SHAPES[kind](model.geom_size[geom]) if kind in SHAPES else _mesh(model, geom)
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    return vertices @ turn.reshape(3, 3).T + model.geom_pos[geom], faces


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


def ball(radius: float, half: float = 0.0) -> Mesh:
    """A ball of a radius [m], its halves moved apart along z by `half` m each: a capsule."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, SEGMENTS // 2 + 2)  # an even number: no point on the equator
    return _revolved(radius * np.cos(angles), radius * np.sin(angles) + half * np.sign(angles))


def _ellipsoid(half: np.ndarray) -> Mesh:
    vertices, faces = ball(1.0)
    return vertices * half, faces


def _cylinder(size: np.ndarray) -> Mesh:
    radius, half, _ = size
    return _revolved(radius * np.array([0, 1, 1, 1, 1, 0]), half * np.array([-1, -1, -1, 1, 1, 1]))


def box(half: np.ndarray) -> Mesh:
    """A box of half sizes `[3]` m: six sides that share no vertex, so that the edges stay sharp."""
    square = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
    turns = [np.roll(square, shift, axis=1) for shift in range(3)]
    # Mirrored at the centre a side would face inwards; in reverse order it faces outwards again.
    corners = np.concatenate([*turns, *(-turn[::-1] for turn in turns)])
    return corners * half, _split(np.arange(len(corners)).reshape(-1, 4))


def _mesh(model: mujoco.MjModel, geom: int) -> Mesh:
    """A mesh of the file; vertices are split where its normals are, so that the edges stay sharp."""
    mesh = model.geom_dataid[geom]
    rows = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    pairs = np.stack([model.mesh_face[rows].ravel(), model.mesh_facenormal[rows].ravel()], axis=-1)
    corners, faces = np.unique(pairs, axis=0, return_inverse=True)
    return model.mesh_vert[model.mesh_vertadr[mesh] + corners[:, 0]].astype(float), faces.reshape(-1, 3)


SHAPES: dict[mujoco.mjtGeom, Callable[[np.ndarray], Mesh]] = {
    mujoco.mjtGeom.mjGEOM_SPHERE: lambda size: ball(size[0]),
    mujoco.mjtGeom.mjGEOM_CAPSULE: lambda size: ball(*size[:2]),
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: _ellipsoid,
    mujoco.mjtGeom.mjGEOM_CYLINDER: _cylinder,
    mujoco.mjtGeom.mjGEOM_BOX: box,
}
"""Meshes of shapes by their type and MuJoCo's `geom_size [3]` m, in their own frame."""

SOLID = {*SHAPES, mujoco.mjtGeom.mjGEOM_MESH}
"""Types of geoms that have a mesh."""


def links_of_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Number of the link to which each body belongs `[nbody]`, of a robot's model; see `Chain.links_at`."""
    moved = (model.body_jntadr + model.body_jntnum).clip(0)  # up to the last joint of each; without one -1 + 0
    return moved[model.body_weldid]


def solid_geoms(model: mujoco.MjModel, n: int) -> list[list[int]]:
    """Numbers of the geoms that are solid of each of `n + 1` links, of a robot's model.

    This is what is drawn of each body and does not collide: collision shapes are simplified, and may be thinner than
    the link (those of the catalogue's arms leave up to a third of it out). Where there is none, it is all of the body.
    """
    links: list[list[int]] = [[] for _ in range(n + 1)]
    drawn = np.isin(model.geom_group, SHOWN_GROUPS) & (model.geom_contype == 0) & (model.geom_conaffinity == 0)
    for body, link in enumerate(links_of_bodies(model)):
        geoms = [int(geom) for geom in np.flatnonzero(model.geom_bodyid == body)]
        geoms = [geom for geom in geoms if mujoco.mjtGeom(model.geom_type[geom]) in SOLID]
        links[link] += [geom for geom in geoms if drawn[geom]] or geoms
    return links
