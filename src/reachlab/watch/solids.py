"""What a compiled MuJoCo model shows, as triangle meshes, for viewers that know nothing of MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from reachlab.robots.shapes.solids import SHOWN_GROUPS, SOLID, Mesh, mesh_of

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
        if model.geom_group[geom] in SHOWN_GROUPS and colour[3] > 0 and kind in SOLID:
            parts.setdefault((int(model.geom_bodyid[geom]), colour), []).append(mesh_of(model, geom))
    return [Solid(body, colour, *_joined(meshes)) for (body, colour), meshes in parts.items()]


def _colour(model: mujoco.MjModel, geom: int) -> Colour:
    material = model.geom_matid[geom]
    red, green, blue, opacity = (model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]).tolist()
    return red, green, blue, opacity


def _joined(meshes: list[Mesh]) -> Mesh:
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, first, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)
