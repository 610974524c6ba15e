"""The scene around a robot in pictures for people: table, target, workspace and light, as a MuJoCo model."""

from __future__ import annotations

import itertools
from typing import Any

import mujoco
import numpy as np

from reachlab.render.marks import TARGET_RADIUS, WAITING
from reachlab.robots.robot import TUTORIAL_WORKSPACE, Robot
from reachlab.robots.shapes.solids import SHOWN_GROUPS
from reachlab.tasks.camera import FIELD_OF_VIEW

WIDTH, HEIGHT = 640, 480
"""Size of a picture [pixels]."""

TABLE_CENTRE, TABLE_SIZE, TABLE_COLOUR = (0.5, 0.0, -0.065), (0.75, 0.5, 0.035), (0.62, 0.65, 0.69, 1.0)
"""The table's slab [m]: its top, at z = -0.03, is where the tutorial's object, 2 cm thick, comes to rest."""

FOOTING = 0.25
"""The table reaches so far behind the tutorial's arm [m]."""

GROUND = ((TUTORIAL_WORKSPACE[0][0] + TUTORIAL_WORKSPACE[1][0]) / 2, 0.0, 0.0)
"""Middle of the floor of the tutorial's workspace [m]."""

FILLED = 0.85
"""Share of the picture within which an arm at home lies."""

ROD_RADIUS, ROD_COLOUR = 0.025, (0.75, 0.77, 0.8, 1.0)
"""Radius [m] and colour of the rods that stand for an arm without shapes."""

EDGE_RADIUS, EDGE_COLOUR = 0.002, (0.33, 0.37, 0.44, 1.0)
"""Radius [m] and colour of the workspace's drawn edges: wider than half a pixel, and darker than sky and table."""


def scene_spec(robot: Robot) -> mujoco.MjSpec:
    """The robot on a table, with a target (mocap body `target`), the workspace's edges and light.

    The target's geoms are `target`, and `near`, the translucent ball in which the tool is near enough; until a camera
    sizes them this one is not seen.
    """
    spec = drawn_spec(robot)
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
        world.add_site(type=capsule, fromto=[*start, *end], size=[EDGE_RADIUS * robot.scale, 0, 0], rgba=EDGE_COLOUR)
    target = world.add_body(name="target", mocap=True)
    size = [TARGET_RADIUS * robot.scale, 0, 0]
    for name, opacity in (("target", 1), ("near", 0)):
        target.add_geom(name=name, type=sphere, size=size, rgba=[*WAITING, opacity], **drawn)
    return spec


def front(robot: Robot) -> float:
    """Angle about the vertical from x to the way from the arm's first joint to the middle of its workspace [rad]."""
    x, y = (np.mean(robot.workspace, axis=0) - robot.chain.frames[0][1])[:2]
    return float(np.arctan2(y, x))


def in_front(robot: Robot, point: tuple[float, ...]) -> np.ndarray:
    """Where a point `[3]` m of the tutorial's scene lies for this arm: as `Robot.placed`, and turned to its front."""
    cos, sin = np.cos(front(robot)), np.sin(front(robot))
    turn, ground = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]), robot.placed(GROUND)
    return robot.scale * turn @ point + (ground - robot.scale * turn @ GROUND)


def outline(robot: Robot, model: mujoco.MjModel) -> np.ndarray:
    """Points `[k, 3]` m around all of the arm at home, of a model of its scene, and of its workspace."""
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[: robot.chain.n]] = robot.home
    mujoco.mj_kinematics(model, data)
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    points = list(np.array(robot.workspace_edges()).reshape(-1, 3))
    for geom in np.flatnonzero(model.geom_group < len(SHOWN_GROUPS)):
        if model.body_weldid[model.geom_bodyid[geom]]:
            centre, half = model.geom_aabb[geom].reshape(2, 3)
            points += list(data.geom_xpos[geom] + (centre + corners * half) @ data.geom_xmat[geom].reshape(3, 3).T)
    return np.array(points)


def distance_needed(points: np.ndarray, ahead: np.ndarray, field: float, aspect: float) -> float:
    """Distance from which points `[k, 3]` m from the picture's middle are seen [m].

    Args:
        points: what is to be seen.
        ahead: where the camera looks, a unit vector `[3]`.
        field: from the picture's lower to its upper edge [deg].
        aspect: its width over its height.
    """
    right = np.array([ahead[1], -ahead[0], 0.0]) / np.linalg.norm(ahead[:2])
    tall = FILLED * np.tan(np.radians(field / 2))
    sideways, upright = np.abs(points @ right) / (tall * aspect), np.abs(points @ np.cross(right, ahead)) / tall
    return float((np.maximum(sideways, upright) - points @ ahead).max())


def drawn_spec(robot: Robot) -> mujoco.MjSpec:
    """The robot's spec, with rods between its bodies where nothing that moves would be seen, as without meshes."""
    spec = robot.spec()
    model = spec.compile()
    moved = [geom for geom in range(model.ngeom) if model.body_weldid[model.geom_bodyid[geom]]]
    if any(model.geom_group[geom] in SHOWN_GROUPS and model.geom_rgba[geom, 3] for geom in moved):
        return spec
    bodies = spec.bodies
    for body in range(1, model.nbody):
        way, above = model.body_pos[body], bodies[int(model.body_parentid[body])]
        if np.linalg.norm(way) > ROD_RADIUS * robot.scale:
            rod: dict[str, Any] = {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, "fromto": [0.0, 0.0, 0.0, *way]}
            size = [ROD_RADIUS * robot.scale, 0, 0]
            above.add_geom(**rod, size=size, rgba=ROD_COLOUR, contype=0, conaffinity=0, mass=0.0)
    return spec


def pose_around(robot: Robot, azimuth: float, elevation: float) -> tuple[np.ndarray, np.ndarray]:
    """Pose of a camera from which, at `CameraEntry.angles`, all goals, the workspace and the arm at home are seen.

    It is as that of `tasks.camera.camera_pose`.
    """
    around, up = np.radians(azimuth) + front(robot), np.radians(elevation)
    back = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    right = np.array([-np.sin(around), np.cos(around), 0.0])
    goals = list(itertools.product(*zip(*robot.goal_box, strict=True)))
    points = np.concatenate([goals, outline(robot, drawn_spec(robot).compile())])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    distance = distance_needed(points - middle, -back, FIELD_OF_VIEW, aspect=1.0)
    return middle + distance * back, np.stack([right, np.cross(back, right), back], axis=1)


def add_table(spec: mujoco.MjSpec, robot: Robot, *, solid: bool = False) -> mujoco.MjsGeom:
    """Put a table under the arm and its workspace; a solid one stops what touches it."""
    touch, turn, centre = int(solid), front(robot) / 2, in_front(robot, TABLE_CENTRE)
    size = robot.scale * np.array(TABLE_SIZE)
    foot = float(np.linalg.norm((centre - robot.chain.frames[0][1])[:2]))
    size[0] = max(size[0], foot + FOOTING * robot.scale)
    return spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        contype=touch,
        conaffinity=touch,
        pos=centre,
        quat=[np.cos(turn), 0.0, 0.0, np.sin(turn)],
        size=size,
        rgba=TABLE_COLOUR,
    )
