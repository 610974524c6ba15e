"""Robots without their pictures: meshes, textures and skins that are missing, or that nobody draws."""

from __future__ import annotations

import mujoco

from reachlab.robots.picture_files import MISSING

SMALL_MASS, SMALL_INERTIA = 0.01, 1e-5
"""Mass [kg] and moments of inertia [kg m²] of a moving body whose own came from a mesh that is missing."""

INFERRED = mujoco.mjtInertiaFromGeom


def leave_out(spec: mujoco.MjSpec, files: frozenset[str]) -> list[str]:
    """Remove the meshes, height fields and textures of these files and of missing ones, and what they draw.

    Moving bodies that are left without a mass get a small one; their names come back.
    """
    files |= {MISSING}
    textures = {texture.name for texture in spec.textures if files & {texture.file, *texture.cubefiles}}
    _remove_textures(spec, textures)
    shapes = {shape.name for shape in (*spec.meshes, *spec.hfields) if shape.file in files}
    bare = _remove_shapes(spec, [geom for geom in spec.geoms if {geom.meshname, geom.hfieldname} & shapes])
    _remove_unused(spec, shapes)
    light = []
    for body in bare:
        if body.joints and not body.geoms and not body.explicitinertial:
            body.explicitinertial, body.mass, body.inertia = True, SMALL_MASS, [SMALL_INERTIA] * 3
            light.append(body.name)
    return light


def without_pictures(spec: mujoco.MjSpec) -> None:
    """Remove skins, textures, height fields and those meshes that no body's inertia is inferred from."""
    for skin in spec.skins:
        spec.delete(skin)
    _remove_textures(spec, {texture.name for texture in spec.textures})
    drawn = [geom for geom in spec.geoms if geom.hfieldname or (geom.meshname and not _weighs(spec, geom))]
    _remove_shapes(spec, drawn)
    kept = {geom.meshname for geom in spec.geoms}
    _remove_unused(spec, {shape.name for shape in (*spec.meshes, *spec.hfields)} - kept)


def without_shapes(spec: mujoco.MjSpec) -> None:
    """Remove the geoms that no body's inertia is inferred from, with what names them; none where a tendon may."""
    if not spec.tendons:
        _remove_shapes(spec, [geom for geom in spec.geoms if not _weighs(spec, geom)])


def _weighs(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    """Whether its body's inertia is inferred from a geom."""
    low, high = spec.compiler.inertiagrouprange
    how = spec.compiler.inertiafromgeom
    inferred = how == INFERRED.mjINERTIAFROMGEOM_TRUE or (
        how == INFERRED.mjINERTIAFROMGEOM_AUTO and not geom.parent.explicitinertial
    )
    return bool(inferred and low <= geom.group <= high and (geom.mass != 0.0 and geom.density != 0.0))


def _remove_textures(spec: mujoco.MjSpec, names: set[str]) -> None:
    for material in spec.materials:
        material.textures = ["" if name in names else name for name in material.textures]
    for light in spec.lights:
        if light.texture in names:
            light.texture = ""
    for texture in [texture for texture in spec.textures if texture.name in names]:
        spec.delete(texture)


def _remove_shapes(spec: mujoco.MjSpec, geoms: list[mujoco.MjsGeom]) -> list[mujoco.MjsBody]:
    """Remove geoms with the pairs and sensors that name them; their bodies."""
    names = {geom.name for geom in geoms} - {""}
    bodies = {geom.parent.id: geom.parent for geom in geoms}
    for pair in [pair for pair in spec.pairs if names & {pair.geomname1, pair.geomname2}]:
        spec.delete(pair)
    kind = mujoco.mjtObj.mjOBJ_GEOM
    for sensor in spec.sensors:
        if (sensor.objtype == kind and sensor.objname in names) or (sensor.reftype == kind and sensor.refname in names):
            spec.delete(sensor)
    for geom in geoms:
        spec.delete(geom)
    return list(bodies.values())


def _remove_unused(spec: mujoco.MjSpec, names: set[str]) -> None:
    for shape in [shape for shape in (*spec.meshes, *spec.hfields) if shape.name in names]:
        spec.delete(shape)
