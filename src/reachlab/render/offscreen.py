"""Pictures for people: a camera on the scene, drawn by MuJoCo off screen."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import os
import platform
import sys
from typing import Any

import mujoco
import numpy as np

from reachlab.render.marks import (
    AXES,
    BALL_OPACITY,
    PATH,
    PATH_RADIUS,
    TARGET_RADIUS,
    TOOL_AXES,
    TRAIL,
    TRAIL_OPACITY,
    TRAIL_RADIUS,
    Axes,
    Block,
    Marks,
)
from reachlab.render.scene import HEIGHT, WIDTH, distance_needed, front, in_front, outline, scene_spec
from reachlab.robots.robot import Robot
from reachlab.settings.validation import InputError

EDGE, GEOM, DECORATION = int(mujoco.mjtObj.mjOBJ_SITE), int(mujoco.mjtObj.mjOBJ_GEOM), int(mujoco.mjtCatBit.mjCAT_DECOR)
"""The workspace's edges are sites. They and the ball are drawn as decoration: that throws no shadow."""

LOOKS_AT, DISTANCE = (0.27, 0.0, 0.3), 1.75
"""Point in the middle of a picture of the tutorial's arm, and how far the camera is from it, at least [m]."""

AZIMUTH, ELEVATION = 130.0, -22.0
"""Where the camera looks: about the vertical from the arm's front, and up [deg]."""

BESIDE = 2000
"""Shapes that a picture may hold beside those of the scene; paths that need more of them are cut short."""


class Offscreen:
    """Draws a model off screen, in an OpenGL context of its own, which belongs to the thread that makes it."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int, beside: int) -> None:
        """Pictures of a model have `height` × `width` pixels, and room for so many shapes beside those of the model.

        Raises:
            InputError: there is no OpenGL to draw with.
        """
        self._context = gl_context(width, height)
        self._model, self._data = model, mujoco.MjData(model)
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + model.nsite + beside)
        self._draw = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._draw)
        self._option, self._view = mujoco.MjvOption(), mujoco.MjvCamera()
        self._viewport, self._pixels = mujoco.MjrRect(0, 0, width, height), np.empty((height, width, 3), np.uint8)

    def _update(self) -> None:
        """Put what the data says into the scene."""
        every = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, self._data, self._option, None, self._view, every, self._scene)

    def _read(self) -> np.ndarray:
        """Picture of the scene `[height, width, 3]` uint8, until the next one is drawn."""
        mujoco.mjr_render(self._viewport, self._scene, self._draw)
        mujoco.mjr_readPixels(self._pixels, None, self._viewport, self._draw)
        return self._pixels[::-1]  # OpenGL begins below

    def close(self) -> None:
        """Free the OpenGL context."""
        self._draw.free()
        self._context.free()


class Camera(Offscreen):
    """Draws a robot and its target off screen."""

    def __init__(self, robot: Robot, width: int = WIDTH, height: int = HEIGHT) -> None:
        """Camera on a robot; pictures have `height` × `width` pixels.

        Raises:
            InputError: there is no OpenGL to draw with.
        """
        spec = scene_spec(robot)
        spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
        super().__init__(spec.compile(), width, height, BESIDE)
        self._joints, self._scale = self._model.jnt_qposadr, robot.scale
        self._target, self._near = (self._model.geom(name).id for name in ("target", "near"))
        self._view.azimuth, self._view.elevation = AZIMUTH + np.degrees(front(robot)), ELEVATION
        self._view.lookat[:] = in_front(robot, LOOKS_AT)
        around, up = np.radians([self._view.azimuth, self._view.elevation])
        ahead = np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
        lens = {"ahead": ahead, "field": self._model.vis.global_.fovy, "aspect": width / height}
        self._needed = lambda points: distance_needed(points - self._view.lookat, **lens)
        self._distance = max(DISTANCE * robot.scale, self._needed(outline(robot, self._model)))

    def picture(self, q: np.ndarray, target: np.ndarray, marks: Marks | None = None) -> np.ndarray:
        """Picture `[height, width, 3]` uint8 of joints, `Robot.posture` or the arm's alone, and a target `[3]`."""
        marks = marks or Marks(TARGET_RADIUS * self._scale)
        self._show_target(marks)
        self._data.qpos[self._joints[: len(q)]] = q
        self._data.mocap_pos[0] = target
        self._view.distance = max(self._distance, self._needed(np.asarray(target)[None]))
        mujoco.mj_forward(self._model, self._data)
        self._context.make_current()
        self._update()
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.objtype == EDGE or (geom.objtype == GEOM and geom.objid == self._near):
                geom.category = DECORATION
        for block in marks.blocks:
            if block.present:
                self._show_block(block)
        for axes in marks.axes:
            self._show_axes(axes)
        self._show_path(marks.path, PATH_RADIUS, (*PATH, 1.0))
        self._show_path(marks.trail, TRAIL_RADIUS, (*TRAIL, TRAIL_OPACITY))
        return self._read().copy()

    def _show_target(self, marks: Marks) -> None:
        model, radius = self._model, TARGET_RADIUS * self._scale
        model.geom_size[self._target, 0] = min(marks.success_distance, radius)
        model.geom_size[self._near, 0] = marks.success_distance
        model.geom_rgba[self._target] = [*marks.colour, 1]
        model.geom_rgba[self._near] = [*marks.colour, BALL_OPACITY * (marks.success_distance > radius)]

    def _show_block(self, block: Block) -> None:
        turn, colour = np.empty(9), np.array((*block.colour, block.opacity), "f4")
        mujoco.mju_quat2Mat(turn, np.asarray(block.quaternion, float))
        shape = self._scene.geoms[self._scene.ngeom]
        size, position = block.size.astype(float), block.position.astype(float)
        mujoco.mjv_initGeom(shape, block.kind, size, position, turn, colour)
        self._scene.ngeom += 1

    def _show_axes(self, axes: Axes) -> None:
        length, radius = axes.size
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, np.asarray(axes.quaternion, float))
        for direction, colour in zip(turn.reshape(3, 3).T, AXES, strict=True):
            self._show_line(axes.position, axes.position + length * self._scale * direction, radius, (*colour, 1.0))

    def _show_path(self, path: np.ndarray, radius: float, colour: tuple[float, ...]) -> None:
        for start, end in itertools.pairwise(path):
            self._show_line(start, end, radius, colour)

    def _show_line(self, start: np.ndarray, end: np.ndarray, radius: float, colour: tuple[float, ...]) -> None:
        """Draw a line between points `[3]` [m] if the scene has room for it.

        Its radius [m] is beside the tutorial's arm; its colour has an opacity.
        """
        scene, still, turned = self._scene, np.zeros(3), np.eye(3).ravel()
        if scene.ngeom == scene.maxgeom:
            return
        line = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(line, mujoco.mjtGeom.mjGEOM_CYLINDER, still, still, turned, np.array(colour, "f4"))
        mujoco.mjv_connector(line, mujoco.mjtGeom.mjGEOM_CYLINDER, radius * self._scale, start, end)
        line.category = DECORATION
        scene.ngeom += 1


def portrait(robot: Robot, width: int, height: int) -> np.ndarray:
    """Picture `[height, width, 3]` uint8 of a robot at home above its workspace, with its tool frame.

    The x axis of the frame is red, y green, z blue; the ball is in the middle of the workspace's lower face.

    Raises:
        InputError: there is no OpenGL to draw with.
    """
    low, high = np.array(robot.workspace)
    tool = Axes(*robot.chain.tool_at(robot.home), TOOL_AXES)
    camera = Camera(robot, width, height)
    try:
        ground = np.array([*((low + high) / 2)[:2], low[2]])
        return camera.picture(np.array(robot.home), ground, Marks(TARGET_RADIUS * robot.scale, axes=(tool,)))
    finally:
        camera.close()


def gl_context(width: int, height: int) -> Any:
    """Off-screen OpenGL context: EGL on Linux unless `MUJOCO_GL` says otherwise."""
    backend = os.environ.get("MUJOCO_GL", "").lower()
    if backend not in ("egl", "osmesa", "glfw"):
        backend = {"Linux": "egl", "Darwin": "cgl"}.get(platform.system(), "glfw")
    try:
        if "torch" in sys.modules:  # which imports Triton when it needs it, and dies where Mesa's LLVM came first
            with contextlib.suppress(ImportError):
                importlib.import_module("triton")
        context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        context.make_current()
        # A context that does not work is noticed only by drawing in it.
        mujoco.MjrContext(mujoco.MjSpec().compile(), mujoco.mjtFontScale.mjFONTSCALE_50).free()
    except Exception as error:
        hint = "on Debian or Ubuntu, apt install libegl1 libopengl0 libgl1-mesa-dri"
        why = str(error).rstrip(".")
        raise InputError(f"pictures need OpenGL ({backend}), which does not start here ({why}): {hint}.") from None
    return context
