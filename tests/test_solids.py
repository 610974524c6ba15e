"""Meshes of a model's geometry."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from reachlab.render.scene import scene_spec
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.loading import load_robot
from reachlab.robots.shapes.solids import SOLID
from reachlab.watch.solids import Solid, solids

TETRAHEDRON = '<asset><mesh name="corner" vertex="0 0 0 0.3 0 0 0 0.3 0 0 0 0.3"/></asset>'

GEOMS = {
    mujoco.mjtGeom.mjGEOM_SPHERE: ('type="sphere" size="0.2"', 4 / 3 * np.pi * 0.2**3),
    mujoco.mjtGeom.mjGEOM_CAPSULE: ('type="capsule" size="0.1 0.3"', np.pi * 0.1**2 * (0.6 + 4 / 3 * 0.1)),
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: ('type="ellipsoid" size="0.1 0.2 0.3"', 4 / 3 * np.pi * 0.1 * 0.2 * 0.3),
    mujoco.mjtGeom.mjGEOM_CYLINDER: ('type="cylinder" size="0.1 0.3"', np.pi * 0.1**2 * 0.6),
    mujoco.mjtGeom.mjGEOM_BOX: ('type="box" size="0.1 0.2 0.3"', 8 * 0.1 * 0.2 * 0.3),
    mujoco.mjtGeom.mjGEOM_MESH: ('type="mesh" mesh="corner"', 0.3**3 / 6),
}
"""A geom of each type and its volume [m³]."""

POSE = 'pos="0.5 0 0" euler="0 90 0"'


def solids_of(*geoms: str) -> list[Solid]:
    body = "".join(f"<geom {geom}/>" for geom in geoms)
    return solids(mujoco.MjModel.from_xml_string(f"<mujoco>{TETRAHEDRON}<worldbody>{body}</worldbody></mujoco>"))


def volume(solid: Solid) -> float:
    """Volume inside the faces, counted negative where they face inwards (the divergence theorem)."""
    a, b, c = (solid.vertices[solid.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("kind", SOLID)
def test_a_mesh_is_closed_faces_outwards_and_has_the_geoms_volume(kind: mujoco.mjtGeom) -> None:
    geom, expected = GEOMS[kind]
    (solid,) = solids_of(f"{geom} {POSE}")
    assert volume(solid) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("kind", [mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX], ids=str)
def test_a_mesh_lies_where_the_geom_does(kind: mujoco.mjtGeom) -> None:
    """Turned a quarter about y, what was 0.3 m along z is along x."""
    (solid,) = solids_of(f"{GEOMS[kind][0]} {POSE}")
    np.testing.assert_allclose(solid.vertices.min(axis=0)[0], 0.2, atol=1e-6)
    np.testing.assert_allclose(solid.vertices.max(axis=0)[0], 0.8, atol=1e-6)


def test_geoms_of_one_body_and_colour_are_one_solid() -> None:
    red, blue = 'rgba="1 0 0 1"', 'rgba="0 0 1 1"'
    ball, box = (GEOMS[kind][0] for kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_BOX))
    found = solids_of(f"{ball} {red}", f"{box} {red}", f"{box} {blue}")
    assert [solid.colour for solid in found] == [(1, 0, 0, 1), (0, 0, 1, 1)]
    assert volume(found[0]) == pytest.approx(
        sum(GEOMS[kind][1] for kind in GEOMS if kind.name[6:] in ("_SPHERE", "_BOX")), rel=0.03
    )


@pytest.mark.parametrize("hidden", ['group="3"', 'rgba="1 1 1 0"'])
def test_what_mujoco_does_not_show_is_not_there(hidden: str) -> None:
    assert solids_of(f'type="sphere" size="0.1" {hidden}') == []


@pytest.mark.parametrize("name", ROBOTS)
def test_every_moving_body_of_a_robot_is_seen(name: str) -> None:
    model = scene_spec(load_robot(name)).compile()
    assert {solid.body for solid in solids(model)} == set(range(model.nbody))
