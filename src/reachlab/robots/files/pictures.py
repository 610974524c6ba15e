"""Robots without their pictures: meshes and textures that are missing, or that nobody draws."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import mujoco

INFERRED = mujoco.mjtInertiaFromGeom

HIDDEN_GROUP = 3
"""Group of geoms that is not drawn, as is usual in MJCF of collision shapes."""


def leave_out(spec: mujoco.MjSpec, files: frozenset[str]) -> None:
    """Remove the meshes, height fields and textures of these files, and what they draw."""
    _remove_textures(spec, {texture.name for texture in spec.textures if files & {texture.file, *texture.cubefiles}})
    shapes = {shape.name for shape in (*spec.meshes, *spec.hfields) if shape.file in files}
    _remove_shapes(spec, [geom for geom in spec.geoms if {geom.meshname, geom.hfieldname} & shapes], shapes)


def as_shells(spec: mujoco.MjSpec) -> None:
    """Let those meshes be shells from which no mass comes: of one that is not closed there is no volume."""
    weighed = {geom.meshname for geom in spec.geoms if weighs(spec, geom)}
    for mesh in spec.meshes:
        if mesh.name not in weighed:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL


def hide_doubles(spec: mujoco.MjSpec) -> None:
    """Draw no collision shapes of links that have shapes to be drawn: a URDF has both, and both would be seen."""
    for body in spec.bodies:
        solid = [geom for geom in body.geoms if geom.contype or geom.conaffinity]
        if len(solid) < len(body.geoms):
            for geom in solid:
                geom.group = HIDDEN_GROUP


def without_pictures(spec: mujoco.MjSpec) -> None:
    """Remove textures, height fields and those meshes that no body's inertia is inferred from."""
    _remove_textures(spec, {texture.name for texture in spec.textures})
    drawn = [geom for geom in spec.geoms if geom.hfieldname or (geom.meshname and not weighs(spec, geom))]
    kept = {geom.meshname for geom in spec.geoms if weighs(spec, geom)}
    _remove_shapes(spec, drawn, {shape.name for shape in (*spec.meshes, *spec.hfields)} - kept)


def without_shapes(spec: mujoco.MjSpec, kept: Collection[str] = ()) -> None:
    """Remove the geoms that no body's inertia is inferred from, with what names them; none where a tendon may.

    Those whose names are `kept` stay.
    """
    if not spec.tendons:
        _remove_shapes(spec, [geom for geom in spec.geoms if geom.name not in kept and not weighs(spec, geom)])


def weighs(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
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
    for texture in spec.textures:
        if texture.name in names:
            spec.delete(texture)


def _remove_shapes(spec: mujoco.MjSpec, geoms: list[mujoco.MjsGeom], shapes: Iterable[str] = ()) -> None:
    """Remove geoms with the pairs that name them, and meshes and height fields by name."""
    names = {geom.name for geom in geoms} - {""}
    for pair in spec.pairs:
        if names & {pair.geomname1, pair.geomname2}:
            spec.delete(pair)
    for shape in (*geoms, *(shape for shape in (*spec.meshes, *spec.hfields) if shape.name in shapes)):
        spec.delete(shape)
