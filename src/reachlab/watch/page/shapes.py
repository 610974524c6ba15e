"""What is drawn of an arm, small enough for a page: its meshes by link, and from where it is seen."""

from __future__ import annotations

import base64
import itertools
import zlib
from typing import Any

import mujoco
import numpy as np

from reachlab.render.scene import in_front, scene_spec
from reachlab.robots.robot import Robot
from reachlab.robots.shapes.solids import Mesh, links_of_bodies
from reachlab.watch.solids import solids

SHARES = 65535
"""A vertex is sent as so many shares of its mesh's size: a link of 0.5 m to 8 µm."""

VIEW_FROM, VIEW_TO = (1.5, -1.1, 0.95), (0.3, -0.02, 0.26)
"""Where the first camera stands, and which point it faces, in the scene of the tutorial's arm [m]."""

FIELD_OF_VIEW = 0.8
"""Vertical field of view of the camera [rad]."""

NORMAL_STEPS = 4
"""Vertices of one place become one where their normals agree to one of so many steps of the unit."""


def scene(robot: Robot) -> dict[str, Any]:
    """All that a page draws of an arm: its view, and parts in the frames of its links as solids.js reads them."""
    figure = Figure(robot)
    model, data, links = figure.model, figure.data, links_of_bodies(figure.model)
    fingers = figure.move(robot.posture(np.array(robot.at_home)))
    frames = np.concatenate([robot.chain.links_at(robot.home), fingers])
    to_links, target = np.linalg.inv(frames), model.body("target").id
    parts, buffers, corners = [], [], np.array(robot.workspace_edges()).reshape(-1, 3).tolist()
    for one in solids(model):
        if one.body == target:
            continue
        link = int(links[one.body])
        placed = one.vertices @ data.xmat[one.body].reshape(3, 3).T + data.xpos[one.body]
        if one.body:
            sides = zip(placed.min(axis=0), placed.max(axis=0), strict=True)
            corners += [list(corner) for corner in itertools.product(*sides)]
        vertices = placed @ to_links[link, :3, :3].T + to_links[link, :3, 3]
        part, buffer = packed((vertices, one.faces))
        parts.append({"link": link, "colour": one.colour, "table": not one.body, **part})
        buffers.append(buffer)
    return {
        "parts": parts,
        "data": base64.b64encode(zlib.compress(b"".join(buffers), 9)).decode(),
        "edges": np.round(robot.workspace_edges(), 4).tolist(),
        "points": np.round(corners, 3).tolist(),
        "middle": np.mean(robot.workspace, axis=0).tolist(),
        "scale": robot.scale,
        "top": robot.table_top,
        "from": in_front(robot, VIEW_FROM).tolist(),
        "to": in_front(robot, VIEW_TO).tolist(),
        "field": FIELD_OF_VIEW,
    }


class Figure:
    """An arm as it is drawn, in its scene.

    Attributes:
        model, data: of the scene.
    """

    def __init__(self, robot: Robot) -> None:
        """Of an arm."""
        self.model, self._n = scene_spec(robot).compile(), robot.chain.n
        self.data = mujoco.MjData(self.model)

    def move(self, q: np.ndarray) -> np.ndarray:
        """Move joints of arm and fingers to `[n + k]`; the frames `[k, 4, 4]` of the bodies of the fingers there."""
        model, data = self.model, self.data
        data.qpos[model.jnt_qposadr[: len(q)]] = q
        mujoco.mj_kinematics(model, data)
        bodies = model.jnt_bodyid[self._n : len(q)]
        frames = np.tile(np.eye(4), (len(bodies), 1, 1))
        frames[:, :3, :3], frames[:, :3, 3] = data.xmat[bodies].reshape(-1, 3, 3), data.xpos[bodies]
        return frames


def packed(mesh: Mesh) -> tuple[dict[str, Any], bytes]:
    """A mesh's numbers of vertices and faces, lower corner and size [m], and as bytes its faces and vertices.

    Both are differences from one number to the next, which compress well: of all faces, then of x, y and z.
    """
    vertices, faces = welded(mesh)
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    shares = np.round((vertices - low) / np.where(size > 0, size, 1.0) * SHARES).astype(np.int32)
    steps = np.diff(shares, axis=0, prepend=0).astype(np.uint16)  # in the size of a share they come round again
    part = {"vertices": len(vertices), "faces": len(faces), "low": low.tolist(), "size": size.tolist()}
    return part, np.diff(faces.ravel(), prepend=0).astype("<i4").tobytes() + steps.T.astype("<u2").tobytes()


def welded(mesh: Mesh) -> Mesh:
    """A mesh without vertices of the same place and normal, in the order in which faces need them."""
    vertices, faces = mesh
    normals = np.zeros_like(vertices)
    one, other = (vertices[faces[:, corner]] - vertices[faces[:, 0]] for corner in (1, 2))
    np.add.at(normals, faces.ravel(), np.repeat(np.cross(one, other), 3, axis=0))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    places = np.concatenate([np.round(vertices / size * SHARES), np.round(normals * NORMAL_STEPS)], axis=1)
    _, first, merged = np.unique(places, axis=0, return_index=True, return_inverse=True)
    faces = merged.ravel()[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    used, when = np.unique(faces, return_index=True)
    used = used[when.argsort()]
    numbers = np.zeros(len(first), int)
    numbers[used] = np.arange(len(used))
    return vertices[first[used]], numbers[faces]
