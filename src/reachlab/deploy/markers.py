"""Bodies beside an arm as messages of ROS 2: markers, which RViz draws."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def to_markers(bodies: Sequence[dict[str, Any]], frame: str = "base") -> Any:
    """A `MarkerArray` of bodies as `Controller.step` takes them: spheres, cubes, and cylinders for capsules."""
    from visualization_msgs.msg import Marker, MarkerArray

    found = []
    for number, one in enumerate(bodies):
        half, radius = np.asarray(one.get("half", np.zeros(3)), float), float(one.get("radius", 0.0))
        marker = Marker(ns="bodies", id=number)
        marker.header.frame_id = frame
        if half[:2].any():
            marker.type, size = Marker.CUBE, 2 * (half + radius)
        elif half[2]:
            marker.type, size = Marker.CYLINDER, 2 * np.array([radius, radius, half[2]])
        else:
            marker.type, size = Marker.SPHERE, np.full(3, 2 * radius)
        place, turn, scale = marker.pose.position, marker.pose.orientation, marker.scale
        place.x, place.y, place.z = map(float, one["position"])
        turn.w, turn.x, turn.y, turn.z = map(float, one.get("quaternion", (1.0, 0.0, 0.0, 0.0)))
        scale.x, scale.y, scale.z = map(float, size)
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = 0.9, 0.5, 0.1, 0.6
        found.append(marker)
    return MarkerArray(markers=found)


def from_markers(message: Any, seen: float) -> list[dict[str, Any]]:
    """Bodies, seen at a time [s], of a `MarkerArray` that holds all of them.

    A cylinder is taken as the capsule around it: its axis, swept by a ball of its radius.

    Raises:
        ValueError: a marker is none of the three, or has no size, or is deleted: where which are is not known.
    """
    from visualization_msgs.msg import Marker

    found = []
    for marker in sorted(message.markers, key=lambda one: (one.ns, one.id)):
        if marker.action == Marker.DELETEALL:
            continue
        if marker.action != Marker.ADD:
            raise ValueError(f"marker {marker.id} of '{marker.ns}' is deleted: each message has to hold all of them")
        place, turn = marker.pose.position, marker.pose.orientation
        half = np.array([marker.scale.x, marker.scale.y, marker.scale.z]) / 2
        if marker.type not in (Marker.CUBE, Marker.CYLINDER, Marker.SPHERE) or not (half > 0).all():
            raise ValueError(f"marker {marker.id} of '{marker.ns}' has type {marker.type} and scale {2 * half}")
        shape: dict[str, Any] = {"radius": max(half)}
        if marker.type == Marker.CUBE:
            shape = {"half": half}
        elif marker.type == Marker.CYLINDER:
            shape = {"half": np.array([0.0, 0.0, half[2]]), "radius": max(half[:2])}
        pose = {"position": [place.x, place.y, place.z], "quaternion": [turn.w, turn.x, turn.y, turn.z]}
        found.append({**pose, **shape, "time": seen})
    return found
