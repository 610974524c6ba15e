"""How it looks: the scene, and the cameras in it."""

from __future__ import annotations

from dataclasses import dataclass

from reachlab.settings.tables import Lazy


@dataclass(frozen=True)
class CameraEntry(Lazy):
    """A camera of the table: a function that gives its pose beside a robot, see `tasks.camera.camera_pose`.

    Attributes:
        colour: it draws in colour rather than in grey.
    """

    colour: bool = True


CAMERAS: dict[str, CameraEntry] = {
    "front": CameraEntry("in front of the arm, looking down at it, in colour", "reachlab.render.cameras:front_pose"),
    "side": CameraEntry("at the arm's left, looking down at it, in colour", "reachlab.render.cameras:side_pose"),
    "top": CameraEntry("above the workspace, in colour", "reachlab.render.cameras:top_pose"),
    "observation": CameraEntry("the one of observations, in grey", "reachlab.tasks.camera:camera_pose", colour=False),
}
"""Cameras by name, of which datasets have pictures. Adding one takes its function and its line here."""
