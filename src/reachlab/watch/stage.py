"""The scene in the browser: arm, table, target, orientations and paths, drawn by viser."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from reachlab.render.marks import PATH, TARGET_AXES, TOOL_AXES, TRAIL, Block, Colour, Marks
from reachlab.render.scene import TABLE_CENTRE, TABLE_SIZE, distance_needed, in_front, outline, scene_spec
from reachlab.robots.shapes.solids import SHAPES
from reachlab.tasks import camera as observation_camera
from reachlab.tasks.task import TaskSetup
from reachlab.watch.captions import angle_text
from reachlab.watch.moment import Moment
from reachlab.watch.player import target_box
from reachlab.watch.solids import Solid, solids

if TYPE_CHECKING:
    import viser

FRAME_RATE = 50.0
"""Pictures in a second [1/s]; viser sends at most 60."""

PAUSE = 0.8
"""Time for which the end of an episode stays in view, and in a recording its begin [s]."""

EDGES, EDGE_WIDTH = (150, 155, 166), 0.002
"""Colour of the workspace's edges, and their width [m]."""

PATH_WIDTH, TRAIL_WIDTH = 0.004, 0.01
"""Width of the tool's drawn path and of a target's trail [m]."""

HANDLE_SIZE = 0.16
"""Size of the arrows and arcs by which the target is moved and turned [m]."""

LABEL_BELOW = (0.0, 0.0, -0.05)
"""Where the label hangs under the target [m]."""

HEADING_AT = (0.3, 0.0, 0.8)
"""Where a recording tells what it shows [m]."""

GRID_CELL, GRID_FADE = 0.1, 6.0
"""The ground's cells, and where it has faded away [m]."""

VIEW_FROM, VIEW_TO = (1.5, -1.1, 0.95), (0.3, -0.02, 0.26)
"""Where the first camera stands, and which point it faces [m]."""

FIELD_OF_VIEW = 0.8
"""Vertical field of view of the first camera [rad]."""

ASPECT = 4 / 3
"""Width of a narrow page over its height: all of the arm is seen on it."""

CAMERA_LENGTH, CAMERA_WIDTH, CAMERA = 0.07, 0.002, (90, 95, 106)
"""The drawn camera: its length, the width of its edges [m], and their colour."""

SKY, GROUND, SKY_INTENSITY = (255, 255, 255), (150, 155, 165), 2.2
"""Light from above and below, and its strength."""


class Stage:
    """Draws a robot at work on a viser server.

    Attributes:
        workspace: the edges of the robot's workspace.
        path: the tool's path in this episode, once it has moved.
        trail: where the target has been, once it has moved by itself.
        axes, target_axes: of the tool and of the target, which show their orientation.
        label: the text below the target.
        balls: the target, and around it the ball in which the tool is near enough.
        camera: the observation camera with its picture, once there is one.
        goals: corners `[2, 3]` m of the box that holds all places that the task asks for.
        bodies: as many as a scene has room for, once a moment was shown.
    """

    def __init__(self, server: viser.ViserServer, setup: TaskSetup) -> None:
        """Stage with a task's arm at home; the target shows with the first moment, in a ball of the success distance.

        All places that the task asks for are in view.
        """
        robot, self.goals = setup.robot, target_box(setup)
        self._scene, self._robot = server.scene, robot
        self._objects = setup.task.scene(setup).objects > 0
        self._model = scene_spec(robot, setup.rules.success_distance).compile()
        self._data = mujoco.MjData(self._model)
        self._joints = self._model.jnt_qposadr
        self.path: viser.LineSegmentsHandle | None = None
        self.trail: viser.LineSegmentsHandle | None = None
        self._drawn: dict[str, np.ndarray] = {}
        self.camera: viser.CameraFrustumHandle | None = None
        self.bodies: list[viser.MeshHandle] = []
        self._blocks: tuple[Block, ...] = ()
        self._set_view(server)
        self._frames = [self._scene.add_frame(self._name(body), show_axes=False) for body in range(self._model.nbody)]
        parts = [(solid.body, self._add(number, solid)) for number, solid in enumerate(solids(self._model))]
        edges = np.array(robot.workspace_edges(), np.float32)
        self.workspace = self._scene.add_line_segments("/workspace", edges, EDGES, thickness=EDGE_WIDTH * robot.scale)
        target = self._model.body("target").id
        self._target, self.balls = self._frames[target], [mesh for body, mesh in parts if body == target]
        self._target.visible = False
        # Not a child of the target: a recording moves children only when they themselves change.
        self.label = self._scene.add_label("/label", "", anchor="top-center", visible=False)
        self._heading: viser.LabelHandle | None = None
        self.axes, self.target_axes = self._add_axes("/tool", TOOL_AXES), self._add_axes("/target_axes", TARGET_AXES)
        self._place(np.array(robot.home), None)

    def add_handle(self, free: Sequence[bool], *, turns: bool = False) -> viser.TransformControlsHandle:
        """Handle by which a person moves the target, along the axes x, y, z that are free, or also `turns` it."""
        # The axes of one that turns are its own.
        x, y, z = (turns or axis for axis in free)
        return self._scene.add_transform_controls(
            "/handle",
            scale=HANDLE_SIZE * self._robot.scale,
            active_axes=(x, y, z),
            disable_rotations=not turns,
            depth_test=False,
        )

    def show(self, moment: Moment, *, axes: bool = False, observation: np.ndarray | None = None) -> None:
        """Show a moment, and in front of the observation camera its picture, `[height, width, 3]` uint8."""
        self._place(moment.q, moment.target)
        turned = moment.target_orientation
        self._target.visible, self.label.visible, self.axes.visible = True, True, axes
        self.target_axes.visible = bool(len(turned))
        self.label.position = moment.target + self._robot.scale * np.array(LABEL_BELOW)
        self.axes.position, self.axes.wxyz = moment.tool, moment.orientation
        if len(turned):
            self.target_axes.position, self.target_axes.wxyz = moment.target, turned
        for ball in self.balls:
            ball.color = _bytes(Marks(reached=moment.reached).colour)
        self.path = self._show_path("/path", self.path, moment.path, PATH, PATH_WIDTH)
        self.trail = self._show_path("/trail", self.trail, moment.trail, TRAIL, TRAIL_WIDTH)
        self._show_blocks(moment.blocks)
        if observation is not None:
            self._show_observation(observation)

    def head(self, text: str) -> None:
        """Write a text above the scene."""
        if self._heading is None:
            place = in_front(self._robot, HEADING_AT)
            self._heading = self._scene.add_label("/heading", text, position=place, anchor="bottom-center")
        self._heading.text = text

    def cast_shadows(self, cast: bool) -> None:
        """Draw shadows, or not."""
        self._scene.configure_default_lights(cast_shadow=cast)

    def _set_view(self, server: viser.ViserServer) -> None:
        camera, robot = server.initial_camera, self._robot
        position, looks_at = in_front(robot, VIEW_FROM), in_front(robot, VIEW_TO)
        back = position - looks_at
        distance = float(np.linalg.norm(back))
        points = np.concatenate([outline(robot, self._model), self.goals]) - looks_at
        needed = distance_needed(points, -back / distance, np.degrees(FIELD_OF_VIEW), ASPECT)
        camera.position = position if needed <= distance else looks_at + needed / distance * back
        camera.look_at, camera.fov = looks_at, FIELD_OF_VIEW
        self._scene.world_axes.visible = False
        # Without a graphics card an environment map or shadows take longer to draw than all the rest.
        self._scene.configure_environment_map(None)
        self.cast_shadows(False)
        self._scene.add_light_hemisphere("/sky", sky_color=SKY, ground_color=GROUND, intensity=SKY_INTENSITY)
        self._scene.add_grid(
            "/ground",
            infinite_grid=True,
            cell_size=GRID_CELL * robot.scale,
            fade_distance=GRID_FADE * robot.scale,
            position=robot.placed((0.0, 0.0, TABLE_CENTRE[2] - TABLE_SIZE[2])),
        )

    def _name(self, body: int) -> str:
        return f"/{self._model.body(body).name or body}"

    def _add(self, number: int, solid: Solid) -> viser.MeshHandle:
        red, green, blue, opacity = solid.colour
        return self._scene.add_mesh_simple(
            f"{self._name(solid.body)}/{number}",
            solid.vertices,
            solid.faces,
            color=(red, green, blue),
            opacity=opacity if opacity < 1 else None,
            cast_shadow=opacity == 1,
        )

    def _place(self, q: np.ndarray, target: np.ndarray | None) -> None:
        self._data.qpos[self._joints[: len(q)]] = q
        if target is not None:
            self._data.mocap_pos[0] = target
        mujoco.mj_kinematics(self._model, self._data)
        for frame, position, quaternion in zip(self._frames, self._data.xpos, self._data.xquat, strict=True):
            frame.position, frame.wxyz = position, quaternion

    def _show_observation(self, picture: np.ndarray) -> None:
        if self.camera is None:
            from scipy.spatial.transform import Rotation

            position, rotation = observation_camera.camera_pose(self._robot, objects=self._objects)
            down_and_ahead = rotation * (1, -1, -1)
            self.camera = self._scene.add_camera_frustum(
                "/camera",
                fov=np.radians(observation_camera.FIELD_OF_VIEW),
                aspect=1.0,
                scale=CAMERA_LENGTH * self._robot.scale,
                thickness=CAMERA_WIDTH * self._robot.scale,
                color=CAMERA,
                image=picture,
                format="png",
                position=position,
                wxyz=Rotation.from_matrix(down_and_ahead).as_quat(scalar_first=True),
                cast_shadow=False,
            )
        else:
            self.camera.image = picture

    def _show_blocks(self, blocks: tuple[Block, ...]) -> None:
        before, self._blocks = self._blocks, blocks
        for number, block in enumerate(blocks):
            if number == len(self.bodies):
                name, colour = f"/body/{number}", _bytes(block.colour)
                self.bodies.append(
                    self._scene.add_mesh_simple(name, *SHAPES[mujoco.mjtGeom(block.kind)](block.size), color=colour)
                )
            elif not np.array_equal(block.size, before[number].size):
                self.bodies[number].vertices, self.bodies[number].faces = SHAPES[mujoco.mjtGeom(block.kind)](block.size)
            shape = self.bodies[number]
            shape.position, shape.wxyz, shape.visible = block.position, block.quaternion, block.present
            shape.color = _bytes(block.colour)

    def _add_axes(self, name: str, size: tuple[float, float]) -> viser.FrameHandle:
        length, radius = self._robot.scale * np.array(size)
        return self._scene.add_frame(name, axes_length=length, axes_radius=radius, origin_radius=radius, visible=False)

    def _show_path(
        self, name: str, line: viser.LineSegmentsHandle | None, path: np.ndarray, colour: Colour, width: float
    ) -> viser.LineSegmentsHandle | None:
        """The line of a path `[k, 3]` [m]; None as long as there is no point of it."""
        if not len(path) or path is self._drawn.get(name):
            return line
        self._drawn[name] = path
        corners = np.array([path[0], *path], np.float32)
        points = np.stack([corners[:-1], corners[1:]], axis=1)
        if line is None:
            return self._scene.add_line_segments(name, points, _bytes(colour), thickness=width * self._robot.scale)
        line.points = points
        return line


def errors_text(moment: Moment) -> str:
    """How far the tool is from the target, as the label and the panel show it."""
    distance = f"{1000 * moment.distance:.1f} mm"
    return distance if moment.angle is None else f"{distance}, {angle_text(moment.angle)}"


def _bytes(colour: Colour) -> tuple[int, int, int]:
    red, green, blue = (round(255 * part) for part in colour)
    return red, green, blue
