"""The observation camera: pictures of many environments at once, drawn by MuJoCo off screen on all cores."""

from __future__ import annotations

import itertools
import operator
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import mujoco
import numpy as np

from reachlab.control.bodies import Bodies
from reachlab.control.planning.workers import cores
from reachlab.render.marks import FIXED, OBJECT, WAITING
from reachlab.render.offscreen import Offscreen
from reachlab.render.scene import add_table, drawn_spec
from reachlab.render.view_randomisation import ARM_GREYS, BODY, DARKEST, LUMA, Views
from reachlab.render.view_randomisation import TARGET as TARGET_GREY
from reachlab.robots.robot import Robot
from reachlab.tasks.camera import FIELD_OF_VIEW
from reachlab.tasks.schema import SIZE

SLICES, STACKS, QUADS = 10, 6, 1
"""Facets of round shapes, and of flat ones: at 84 pixels more are not seen, and cost three times the time."""

GROUND_SIZE = (4.0, 4.0, 0.01)
"""Half the size of the drawn ground [m]; it lies where the tutorial's does."""

WIDE = 5.0
"""How much wider the ground is in colour, where other cameras look along it."""

GROUND_PLACE = (0.0, 0.0, -0.66)
"""Middle of the drawn ground [m]."""

Shapes = tuple[tuple[mujoco.mjtGeom, tuple[float, ...], tuple[float, ...], tuple[float, ...]], ...]
"""Primitives: type, size [m], position in their body's frame [m] and quaternion."""

TOOL_TARGET: Shapes = (
    (mujoco.mjtGeom.mjGEOM_CYLINDER, (0.0155, 0.06), (0.0, -0.004, 0.0), (1.0, 1.0, 0.0, 0.0)),
    (mujoco.mjtGeom.mjGEOM_BOX, (0.044, 0.006, 0.015), (0.0, 0.039, 0.0), (1.0, 0.0, 0.0, 0.0)),
)
"""The tutorial's object 000, beside its arm: a bar of 3 cm by 12 cm, with a crossbar of 9 cm."""

CROSS: Shapes = (
    (mujoco.mjtGeom.mjGEOM_BOX, (0.07, 0.01, 0.0005), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
    (mujoco.mjtGeom.mjGEOM_BOX, (0.01, 0.07, 0.0005), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
)
"""A mark under the place of an object: its arms are longer than an object is wide."""

BESIDE = 500
"""Shapes that a picture may hold beside those of arm, table, ground and target."""


class Tints(NamedTuple):
    """Red, green and blue `[3]` that greys of views are multiplied by: of the target, objects and other bodies."""

    target: np.ndarray
    moved: np.ndarray
    fixed: np.ndarray


GREY = Tints(*np.ones((3, 3)))
COLOUR = Tints(np.array(WAITING) / TARGET_GREY[0], np.array(OBJECT) / BODY[0], np.array(FIXED) / BODY[0])
"""Tints of pictures in grey, and of those in colour: there they have the colours of pictures for people."""


class ObservationCamera:
    """Draws the pictures that a policy observes of a robot and its target, a share of them on each core."""

    def __init__(
        self, robot: Robot, *, objects: bool = False, threads: int = 0, size: int = SIZE, colour: bool = False
    ) -> None:
        """Camera on a robot, and on the last of the bodies beside it, if it moves `objects`.

        It has `threads` threads, 0 for one a core; they are started for the first picture. Pictures have `size` ×
        `size` pixels, of three colours each where it draws in `colour`.
        """
        self._robot, self._objects = robot, objects
        self._shape, self._colour = (size, size, 3)[: 2 + colour], colour
        self._threads = threads or cores()
        self._pools: list[ThreadPoolExecutor] = []
        self._painters: list[_Painter] = []

    def pictures(self, actuated: np.ndarray, goal: np.ndarray, bodies: Bodies, views: Views) -> np.ndarray:
        """Pictures `[B, size, size]` uint8, or `[B, size, size, 3]` in colour, each in its own view.

        Args:
            actuated: joints, and the gripper's opening `[B, m]` [rad or m].
            goal: places `[B, 3]` [m].
            bodies: what is beside each arm `[B, K]`, of NumPy.
            views: see `make_views`.

        Raises:
            InputError: there is no OpenGL to draw with.
        """
        if not self._painters:
            self._open()
        out = np.empty((len(views.arm), *self._shape), np.uint8)
        bounds = np.linspace(0, len(out), len(self._pools) + 1).astype(int)
        shares = [slice(*pair) for pair in itertools.pairwise(bounds) if pair[0] < pair[1]]
        jobs = [
            pool.submit(painter.paint, *jax.tree.map(operator.itemgetter(rows), (actuated, goal, bodies, views, out)))
            for pool, painter, rows in zip(self._pools, self._painters, shares, strict=False)
        ]
        for job in jobs:
            job.result()
        return out

    def _open(self) -> None:
        # An OpenGL context belongs to the thread that draws with it.
        self._pools = [ThreadPoolExecutor(1) for _ in range(self._threads)]
        settings = self._robot, self._objects, self._shape[0], self._colour
        self._painters = [pool.submit(_Painter, *settings).result() for pool in self._pools]

    def close(self) -> None:
        """Free the OpenGL contexts; they are made again when needed."""
        for pool, painter in zip(self._pools, self._painters, strict=False):
            pool.submit(painter.close).result()
        for pool in self._pools:
            pool.shutdown()
        self._pools, self._painters = [], []


class _Painter(Offscreen):
    """One thread's share: a scene, and an OpenGL context of its own."""

    def __init__(self, robot: Robot, objects: bool, size: int, colour: bool) -> None:
        # Mesa's software renderer would start threads of its own for each context.
        os.environ.setdefault("LP_NUM_THREADS", "0")
        super().__init__(_model(robot, objects=objects, size=size, colour=colour), size, size, BESIDE)
        self._robot, self._objects, self._tints = robot, objects, COLOUR if colour else GREY
        parts = [self._model.geom(name).id for name in (TABLE, GROUND)]
        self._table, self._ground = parts
        self._target = np.flatnonzero(self._model.geom_bodyid == self._model.body(TARGET).id)
        self._arm = np.setdiff1d(np.arange(self._model.ngeom), [*parts, *self._target])
        self._colours = self._model.geom_rgba[self._arm, :3].copy()
        self._scene.flags[:] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_CULL_FACE] = 1
        self._option.sitegroup[:] = 0
        self._view.type, self._view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0

    def paint(self, actuated: np.ndarray, goal: np.ndarray, bodies: Bodies, views: Views, out: np.ndarray) -> None:
        """Fill `out [m, size, size]`, with three colours or none behind, with the pictures of `m` arms."""
        from scipy.spatial.transform import Rotation

        model, data, scene = self._model, self._data, self._scene
        self._context.make_current()
        quaternions = Rotation.from_matrix(views.rotation).as_quat(scalar_first=True)
        arm, places, beside = self._arm_colours(views.arm), np.array(goal), _shapes(bodies)
        tints = self._tints
        if self._objects:
            places[:, 2] -= np.asarray(bodies.extent)[:, -1, 2]  # the mark lies under the object
        for i, picture in enumerate(out):
            model.cam_pos[0], model.cam_quat[0] = views.position[i], quaternions[i]
            model.light_dir[0], model.light_diffuse[0] = views.lamp_direction[i], views.lamp[i]
            model.vis.headlight.ambient[:] = views.ambient[i]
            colours = model.geom_rgba
            colours[self._arm, :3] = arm[i]
            colours[self._table, :3], colours[self._ground, :3] = views.table[i], views.ground[i]
            colours[self._target, :3] = np.minimum(views.target[i] * tints.target, 1.0)
            posture = self._robot.posture(actuated[i])
            data.qpos[model.jnt_qposadr[: len(posture)]] = posture
            data.mocap_pos[0] = places[i]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            self._update()
            for number, shape in enumerate(beside[i], 1):
                tint = tints.moved if self._objects and number == len(beside[i]) else tints.fixed
                colour = np.minimum([*views.body[i] * tint, 1.0], 1.0).astype(np.float32)
                mujoco.mjv_initGeom(scene.geoms[scene.ngeom], *shape, colour)
                scene.ngeom += 1
            pixels = self._read()
            picture[:] = pixels if out.ndim > 3 else pixels[..., 0]

    def _arm_colours(self, added: np.ndarray) -> np.ndarray:
        """Colours of the arm's shapes `[m, shapes, 3]`."""
        return np.clip(self._colours + added[:, np.arange(len(self._arm)) % ARM_GREYS, None], DARKEST, 1.0)


def _shapes(bodies: Bodies) -> list[list[tuple[Any, ...]]]:
    """Of each of `m` arms the bodies beside it that are there: kind, size, place and rotation."""
    from scipy.spatial.transform import Rotation

    count, room = bodies.kind.shape
    if not room:  # an arm alone is drawn as fast as it can be
        return [[] for _ in range(count)]
    turns = Rotation.from_quat(bodies.quaternion.reshape(-1, 4), scalar_first=True).as_matrix().reshape(count, room, 9)
    sizes, places = np.asarray(bodies.mujoco_size, float), np.asarray(bodies.position, float)
    present, kinds = np.asarray(bodies.present), bodies.kind.tolist()
    return [
        [(kinds[i][k], sizes[i, k], places[i, k], turns[i, k]) for k in np.flatnonzero(present[i])]
        for i in range(count)
    ]


TABLE, GROUND, TARGET = "reachlab_table", "reachlab_ground", "reachlab_target"
"""Names in the drawn model: shapes, and the target's body."""


def _model(robot: Robot, *, objects: bool, size: int, colour: bool) -> mujoco.MjModel:
    """The robot on a table, with a target, for objects a cross, a camera and a lamp; all is grey without `colour`."""
    spec = drawn_spec(robot)
    world, quality = spec.worldbody, spec.visual.quality
    quality.numslices, quality.numstacks, quality.numquads = SLICES, STACKS, QUADS
    quality.offsamples = quality.shadowsize = 0
    visual = spec.visual
    visual.global_.offwidth = visual.global_.offheight = size
    visual.headlight.diffuse = visual.headlight.specular = [0.0] * 3
    add_table(spec, robot).name = TABLE
    drawn = {"contype": 0, "conaffinity": 0}
    box, directional = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    ground = robot.scale * np.array(GROUND_SIZE) * (WIDE if colour else 1.0)
    world.add_geom(name=GROUND, type=box, size=ground, pos=robot.placed(GROUND_PLACE), **drawn)
    target = world.add_body(name=TARGET, mocap=True)
    shapes, scale = (CROSS, 1.0) if objects else (TOOL_TARGET, robot.scale)
    for kind, sides, position, quaternion in shapes:
        lengths = {"size": scale * np.array([*sides, 0.0][:3]), "pos": scale * np.array(position)}
        target.add_geom(type=kind, quat=quaternion, **lengths, **drawn)
    world.add_camera(fovy=FIELD_OF_VIEW)
    for light in spec.lights:
        spec.delete(light)
    world.add_light(pos=[0.0, 0.0, 3.0], type=directional, castshadow=False, specular=[0.0] * 3)
    model = spec.compile()
    painted = model.geom_matid >= 0
    colours = np.where(painted[:, None], model.mat_rgba[model.geom_matid] if model.nmat else 1.0, model.geom_rgba)
    model.geom_rgba[:, :3] = colours[:, :3] if colour else (colours[:, :3] @ np.array(LUMA))[:, None]
    model.geom_matid[:] = -1
    return model
