"""What is known of an arm."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from reachlab.robots.chain import Chain

Box = tuple[tuple[float, ...], tuple[float, ...]]
"""Lower and upper corner of a box [m]."""

TUTORIAL_WORKSPACE: Box = ((0.2, -0.3, 0.0), (0.7, 0.3, 0.55))
"""Workspace of the tutorial's iiwa, in whose metres table, object and cameras are given."""

FILE, CATALOGUE, DERIVED, DEFAULT = "model file", "catalogue", "derived", "default"
"""Where a figure of a robot may come from."""


@dataclass(frozen=True)
class PybulletModel:
    """A robot in PyBullet's own data.

    Attributes:
        file: URDF file.
        link: index of the link that holds the tool frames.
        tools: tool frames, and how far they lie along that link's z [m].
    """

    file: str
    link: int
    tools: Mapping[str, float]


@dataclass(frozen=True)
class Robot:
    """A serial arm and one of its tool frames.

    Attributes:
        name: name in `ROBOTS`, or the file's stem.
        file: MJCF or URDF file.
        tool: the tool frame, a site or a body.
        chain: joints from the world to the tool, with their position limits [rad or m].
        home: joint vector `[n]` in which episodes start [rad or m].
        speed: joint speed limits `[n]` [rad/s or m/s].
        torque: joint torque limits `[n]` [Nm or N]; infinite where none is known.
        workspace: box in which the tool works [m].
        goal_box: box in which goals are asked for that are not on the table [m].
        held_quaternion: orientation in which the tool is held, wxyz.
        sources: where each of these figures comes from: `FILE`, `CATALOGUE`, `DERIVED` or `DEFAULT`.
        pybullet: the same robot in PyBullet's data; without it, one is written for PyBullet from the robot's own model.
    """

    name: str
    file: Path
    tool: str
    chain: Chain
    home: tuple[float, ...]
    speed: tuple[float, ...]
    torque: tuple[float, ...]
    workspace: Box
    goal_box: Box
    held_quaternion: tuple[float, ...]
    sources: Mapping[str, str] = field(default_factory=dict)
    pybullet: PybulletModel | None = None

    @property
    def scale(self) -> float:
        """Size of the workspace over that of the tutorial's."""
        own, tutorial = (float(np.linalg.norm(np.subtract(*box))) for box in (self.workspace, TUTORIAL_WORKSPACE))
        return own / tutorial

    def spec(self) -> mujoco.MjSpec:
        """The arm alone."""
        return mujoco.MjSpec.from_file(str(self.file))

    def workspace_edges(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The twelve edges of the workspace box, each from one corner to another [m]."""
        corners = np.array(list(itertools.product(*zip(*self.workspace, strict=True))))
        return [(a, b) for a, b in itertools.combinations(corners, 2) if np.count_nonzero(a != b) == 1]
