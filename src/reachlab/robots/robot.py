"""What is known of an arm."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import mujoco
import numpy as np

from reachlab.robots.derive.isolation import Isolation, apply
from reachlab.robots.files.gripper import Gripper
from reachlab.robots.files.model_file import ModelFile
from reachlab.robots.kinematics.chain import Chain, significant

if TYPE_CHECKING:
    from jax import Array

    from reachlab.robots.shapes.clearance import Capsules

Box = tuple[tuple[float, ...], tuple[float, ...]]
"""Lower and upper corner of a box [m]."""

FILE, CATALOGUE, DERIVED, DEFAULT = "model file", "catalogue", "derived", "default"
"""Where a figure of a robot may come from."""

TUTORIAL_WORKSPACE: Box = ((0.2, -0.3, 0.0), (0.7, 0.3, 0.55))
"""The box in which the tutorial's arm works [m]; lengths of its task are meant in proportion to it."""


GRIPPER = "gripper"
"""Name of the gripper among what can be commanded."""

UP = 1e-6
"""Angle to the vertical below which a direction is straight up [rad], about."""

TABLE_TOP = -0.03
"""Height of the tutorial's table [m]: there its object, 2 cm thick, comes to rest."""


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


class CommandLimits(NamedTuple):
    """Limits of commands `[m]`: of their position [rad or m], and of its changes per s, s² and s³."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]


RAMP_RATE, JERK_RATE = 10.0, 20.0
"""Limits of acceleration and jerk where none are known: full speed in a tenth of a second, and full acceleration in a
twentieth [1/s]."""


def front_of(chain: Chain, workspace: Box) -> float:
    """See `Robot.front`."""
    base, (low, high) = np.array(chain.frames[0][1])[:2], (np.array(corner)[:2] for corner in workspace)
    if ((low < base) & (base < high)).all():
        return 0.0
    x, y = (low + high) / 2 - base
    return float(np.round(np.arctan2(y, x) / (np.pi / 2)) * np.pi / 2)


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
        gripper: what is driven beside the arm; None where its fingers are locked, or it has none.
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
    gripper: Gripper | None = None

    def _repr_pretty_(self, printer: Any, _: bool) -> None:
        """What a notebook shows in place of everything that is known of it."""
        printer.text(f"<Robot {self.name}: {self.chain.n} joints, tool {self.tool}, home {list(self.home)}>")

    def spec(self, *, pictures: bool = True) -> mujoco.MjSpec:
        """A new spec of the arm, whose only joints are the chain's, in its order, and then the gripper's.

        Each has a position servo.

        Without `pictures` it has no meshes, but those that inertias follow from.
        """
        spec = self.model.spec(pictures=pictures)
        apply(spec, self.isolation)
        return spec

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names of what can be commanded, in the order of a command `[m]`: the chain's joints, then the gripper."""
        return (*self.joint_names, *[GRIPPER] * bool(self.gripper))

    @property
    def locked(self) -> Robot:
        """The same arm, its fingers locked."""
        return replace(self, isolation=replace(self.isolation, fingers=()), gripper=None)

    @property
    def commands(self) -> CommandLimits:
        """Limits of what can be commanded: of the joints, and then of the opening of the gripper."""
        arm = CommandLimits(self.chain.lower, self.chain.upper, self.speed, self.acceleration, self.jerk)
        if not self.gripper:
            return arm
        speed = self.gripper.speed
        opening = (0.0, self.gripper.widest, speed, RAMP_RATE * speed, JERK_RATE * RAMP_RATE * speed)
        return CommandLimits(*((*limits, own) for limits, own in zip(arm, opening, strict=True)))

    @property
    def at_home(self) -> tuple[float, ...]:
        """Where what can be commanded begins `[m]`: the joints at home, the gripper open."""
        return (*self.home, self.gripper.widest) if self.gripper else self.home

    def posture(self, actuated: np.ndarray) -> np.ndarray:
        """Positions of all joints of its spec, of those of what can be commanded `[m]`."""
        if not self.gripper:
            return actuated
        return np.concatenate([actuated[:-1], self.gripper.fingers(actuated[-1:])])

    @functools.cached_property
    def capsules(self) -> Capsules:
        """Capsules that contain its links, found when they are first asked for, once, in a second or two."""
        from reachlab.robots.shapes.capsules import find_capsules

        floor = self.workspace[0][2]
        return find_capsules(self.model, self.locked.isolation, self.chain, self.tool, self.home, floor)

    @functools.cached_property
    def down(self) -> tuple[float, ...]:
        """Orientation, wxyz, in which a hand works over a table: the tool's at home.

        Of an arm with fewer than six joints, which may be tilted there, it is the nearest that points straight down.
        """
        if self.chain.poses:
            return self.held_quaternion
        turn, out = np.zeros(4), np.zeros(3)
        mujoco.mju_rotVecQuat(out, np.array(self.chain.approach), np.array(self.held_quaternion))
        half = np.array([1 - out[2], -out[1], out[0], 0.0])  # from there to straight down, the shortest way
        half = half / length if (length := np.linalg.norm(half)) > UP else np.array([0.0, 1.0, 0.0, 0.0])
        mujoco.mju_mulQuat(turn, half, np.array(self.held_quaternion))
        return tuple(turn.tolist())

    @property
    def table_top(self) -> float:
        """Height of the table on which it works [m]."""
        return float(self.placed((0.0, 0.0, TABLE_TOP))[2])

    @property
    def scale(self) -> float:
        """Size of the workspace in those of the tutorial's, by their diagonals; 1 for the tutorial's arm.

        It is rounded to six significant digits.
        """
        return significant(_diagonal(self.workspace) / _diagonal(TUTORIAL_WORKSPACE))

    @property
    def front(self) -> float:
        """Quarter turn about the vertical from x to where the workspace lies; 0 where it is all around [rad]."""
        return front_of(self.chain, self.workspace)

    def placed(self, point: tuple[float, ...] | np.ndarray) -> np.ndarray:
        """Where a point `[..., 3]` m of the tutorial's scene lies in this arm's: in proportion to their workspaces."""
        return np.asarray(point) * self.scale + (_ground(self.workspace) - self.scale * _ground(TUTORIAL_WORKSPACE))

    def in_workspace(self, point: Array) -> Array:
        """Point `[..., 3]` m from the workspace's middle, in halves of its edges."""
        low, high = (np.array(corner, np.float32) for corner in self.workspace)
        return (2 * point - high - low) / (high - low)

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
