"""What is known of an arm."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from reachlab.robots.chain import Chain, significant
from reachlab.robots.isolation import Isolation, apply
from reachlab.robots.model_file import ModelFile

if TYPE_CHECKING:
    from reachlab.robots.capsules import Capsules

Box = tuple[tuple[float, ...], tuple[float, ...]]
"""Lower and upper corner of a box [m]."""

FILE, CATALOGUE, DERIVED, DEFAULT = "model file", "catalogue", "derived", "default"
"""Where a figure of a robot may come from."""

TUTORIAL_WORKSPACE: Box = ((0.2, -0.3, 0.0), (0.7, 0.3, 0.55))
"""The box in which the tutorial's arm works [m]; lengths of its task are meant in proportion to it."""


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
        model: the MJCF or URDF file that was read.
        tool: the tool frame, a site or a body.
        joint_names: names of the chain's joints, base to tool.
        chain: joints from the world to the tool, with their position limits [rad or m].
        home: joint vector `[n]` in which episodes start [rad or m].
        speed: joint speed limits `[n]` [rad/s or m/s].
        torque: joint torque limits `[n]` [Nm or N]; infinite where the file's own servos have none.
        acceleration: limits of joint acceleration `[n]` [rad/s² or m/s²], for commands that are shaped.
        jerk: limits of joint jerk `[n]` [rad/s³ or m/s³], likewise.
        workspace: box in which the tool works [m].
        goal_box: box in which goals are asked for that are not on the table [m].
        held_quaternion: orientation in which the tool is held, wxyz.
        mass: of all that the joints move [kg].
        payload: largest mass that varies at its tool [kg].
        isolation: how the arm is cut out of its file.
        sources: where each of these figures comes from, `FILE`, `CATALOGUE`, `DERIVED` or `DEFAULT`; where it differs
            from joint to joint, of each.
        shares: of the boxes that are derived, which share of their points can be reached.
        notices: what was guessed, changed or left out, a sentence each.
        pybullet: the same robot in PyBullet's data; without it, one is written for PyBullet from the robot's own model.
    """

    name: str
    model: ModelFile
    tool: str
    joint_names: tuple[str, ...]
    chain: Chain
    home: tuple[float, ...]
    speed: tuple[float, ...]
    torque: tuple[float, ...]
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]
    workspace: Box
    goal_box: Box
    held_quaternion: tuple[float, ...]
    mass: float
    payload: float
    isolation: Isolation
    sources: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    shares: Mapping[str, float] = field(default_factory=dict)
    notices: tuple[str, ...] = ()
    pybullet: PybulletModel | None = None

    def spec(self, *, pictures: bool = True) -> mujoco.MjSpec:
        """A new spec of the arm, whose only joints are the chain's, in its order, each with a position servo.

        Without `pictures` it has no meshes, but those that inertias follow from.
        """
        spec = self.model.spec(pictures=pictures)
        apply(spec, self.isolation)
        return spec

    @functools.cached_property
    def capsules(self) -> Capsules:
        """Capsules that contain its links, found when they are first asked for, once, in a second or two."""
        from reachlab.robots.capsules import find_capsules

        return find_capsules(self)

    @functools.cached_property
    def floors(self) -> tuple[float, ...]:
        """Height above which each capsule that its joints move has to stay [m]; minus infinity if it may be anywhere.

        The latter is so of those that are in the table at home already.
        """
        from reachlab.robots.capsules import find_floors

        return find_floors(self)

    @property
    def scale(self) -> float:
        """Size of the workspace in those of the tutorial's, by their diagonals; 1 for the tutorial's arm.

        It is rounded to six significant digits.
        """
        return significant(_diagonal(self.workspace) / _diagonal(TUTORIAL_WORKSPACE))

    def placed(self, point: tuple[float, ...] | np.ndarray) -> np.ndarray:
        """Where a point `[..., 3]` m of the tutorial's scene lies in this arm's: in proportion to their workspaces."""
        return np.asarray(point) * self.scale + (_ground(self.workspace) - self.scale * _ground(TUTORIAL_WORKSPACE))

    def workspace_edges(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The twelve edges of the workspace box, each from one corner to another [m]."""
        corners = np.array(list(itertools.product(*zip(*self.workspace, strict=True))))
        return [(a, b) for a, b in itertools.combinations(corners, 2) if np.count_nonzero(a != b) == 1]


def _diagonal(box: Box) -> float:
    return float(np.linalg.norm(np.subtract(box[1], box[0])))


def _ground(box: Box) -> np.ndarray:
    """Middle of a box's lower face `[3]` m."""
    low, high = np.array(box)
    return np.array([*((low + high) / 2)[:2], low[2]])
