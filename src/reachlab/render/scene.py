"""The scene around a robot in pictures for people: table, target, workspace and light, as a MuJoCo model."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from reachlab.render.marks import BALL_OPACITY, TARGET_RADIUS, WAITING
from reachlab.robots.robot import Robot

WIDTH, HEIGHT = 640, 480
"""Size of a picture [pixels]."""

TABLE_CENTRE, TABLE_SIZE, TABLE_COLOUR = (0.5, 0.0, -0.065), (0.75, 0.5, 0.035), (0.62, 0.65, 0.69, 1.0)
"""The table's slab [m]: its top, at z = -0.03, is where the tutorial's object, 2 cm thick, comes to rest."""

EDGE_RADIUS, EDGE_COLOUR = 0.002, (0.33, 0.37, 0.44, 1.0)
"""Radius [m] and colour of the workspace's drawn edges: wider than half a pixel, and darker than sky and table."""


def scene_spec(robot: Robot, success_distance: float = TARGET_RADIUS) -> mujoco.MjSpec:
    """The robot on a table, with a target (mocap body `target`), the workspace's edges and light.

    The target's geoms are `target`, and `near`, the translucent ball in which the tool is near enough, where that is
    the larger one.
    """
    spec = robot.spec()
    world, visual = spec.worldbody, spec.visual
    visual.global_.offwidth, visual.global_.offheight = WIDTH, HEIGHT
    visual.headlight.ambient, visual.headlight.diffuse = [0.4] * 3, [0.3] * 3
    visual.headlight.specular = [0.1] * 3
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.98, 0.985, 0.99],
        rgb2=[0.82, 0.87, 0.92],
        width=64,
        height=64,
    )
    world.add_light(
        pos=[1.5, -1.5, 2.2],
        dir=[-0.55, 0.55, -1.0],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=[0.42] * 3,
        specular=[0.3] * 3,
        castshadow=True,
    )
    drawn: dict[str, Any] = {"contype": 0, "conaffinity": 0}
    capsule, sphere = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_SPHERE
    add_table(spec, robot)
    for start, end in robot.workspace_edges():
        world.add_site(type=capsule, fromto=[*start, *end], size=[EDGE_RADIUS, 0, 0], rgba=EDGE_COLOUR)
    target = world.add_body(name="target", mocap=True)
    radius, opacity = min(success_distance, TARGET_RADIUS), BALL_OPACITY * (success_distance > TARGET_RADIUS)
    target.add_geom(name="target", type=sphere, size=[radius, 0, 0], rgba=[*WAITING, 1], **drawn)
    target.add_geom(name="near", type=sphere, size=[success_distance, 0, 0], rgba=[*WAITING, opacity], **drawn)
    return spec


def add_table(spec: mujoco.MjSpec, robot: Robot, *, solid: bool = False) -> mujoco.MjsGeom:
    """Put a table under the arm's workspace; a solid one stops what touches it."""
    touch = int(solid)
    return spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        contype=touch,
        conaffinity=touch,
        pos=robot.placed(TABLE_CENTRE),
        size=robot.scale * np.array(TABLE_SIZE),
        rgba=TABLE_COLOUR,
    )
