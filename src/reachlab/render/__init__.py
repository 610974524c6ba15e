"""How it looks: the scene, and the cameras in it."""

from __future__ import annotations

from typing import NamedTuple


class CameraEntry(NamedTuple):
    """A camera of the table.

    Attributes:
        summary: where it stands, in words.
        angles: about the vertical from the way in front of the arm, and up from the table, to the camera [deg]; without
            them it is the one of observations, in grey.
    """

    summary: str
    angles: tuple[float, ...] = ()


CAMERAS: dict[str, CameraEntry] = {
    "front": CameraEntry("in front of the arm, looking down at it, in colour", (0.0, 40.0)),
    "side": CameraEntry("at the arm's left, looking down at it, in colour", (90.0, 40.0)),
    "top": CameraEntry("above the workspace, in colour", (0.0, 85.0)),
    "observation": CameraEntry("the one of observations, in grey"),
}
"""Cameras by name, of which datasets have pictures. Adding one takes its line here."""
