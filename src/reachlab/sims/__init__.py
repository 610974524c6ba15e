"""Who moves the arm: what the environment asks of a simulator, and the table of those there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import jax
import numpy as np
from jax import Array

from reachlab.render.marks import Marks
from reachlab.render.view_randomisation import Views
from reachlab.robots.kinematics import Pose
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.settings.tables import Lazy
from reachlab.settings.validation import InputError, choose
from reachlab.tasks.obstacles import Obstacles
from reachlab.tasks.task import Goal


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ArmState:
    """A batch of arms.

    Attributes:
        q: joint positions `[B, n]` [rad or m].
        qd: joint speeds `[B, n]` [rad/s or m/s].
        tool_position: `[B, 3]` [m].
        tool_quaternion: `[B, 4]`, wxyz.
        engine: whatever else an engine needs to continue exactly from here, `[B, m]` uint32, the bits of its numbers.
        contact: whether the arm touched something in the last control period, or touches it after a reset `[B]`; None
            where nothing can be touched.
    """

    q: Array
    qd: Array
    tool_position: Array
    tool_quaternion: Array
    engine: Array | None = None
    contact: Array | None = None

    @property
    def tool(self) -> Pose:
        """The tool's pose."""
        return Pose(self.tool_position, self.tool_quaternion)


class Moved(NamedTuple):
    """Where a step took a batch of arms; like `ArmState`, but for the tool.

    Attributes:
        q, qd: see `ArmState`.
        tool: its pose; None where it is that of the joints by forward kinematics, which is left to the caller to
            compute, together with what it computes next.
        engine, contact: see `ArmState`.
    """

    q: Array
    qd: Array
    tool: Pose | None = None
    engine: Array | None = None
    contact: Array | None = None


BatchArray = Array | np.ndarray
"""A batch, on either side of JAX."""

Kind = Literal["traced", "host"]
"""How a simulator steps: in functions that JAX can trace, all its state being the `ArmState`; or outside JAX."""


class Simulator(Protocol):
    """A batch of arms that follow joint commands.

    `lag [n]` is the time by which each joint follows a steadily moving command [s]: 0 where joints are set.
    """

    kind: Kind
    lag: tuple[float, ...]

    def reset(
        self,
        state: ArmState | None,
        q: BatchArray,
        goal: Goal,
        mask: BatchArray | None,
        dynamics: BatchArray | None = None,
        obstacles: Obstacles | None = None,
    ) -> ArmState:
        """State with the arms of `mask [B]` at rest at `q [B, n]`, each with its goal beside it.

        Without a state (the first time) every arm is set. Where dynamics vary, `dynamics [B, 2 n + 1]` in -1 to 1
        decides which arm it becomes: the gain of each servo, the damping of each joint, and the payload.
        Where there are obstacles, `obstacles [B, K, ...]` decides which lie around it; without them they stay, and at
        first none is there.
        """
        ...

    def rearrange(self, state: ArmState, obstacles: Obstacles) -> ArmState:
        """State with the obstacles `[B, K, ...]` where these are; only asked for where there are some."""
        ...

    def step(self, state: ArmState | Moved, target_q: BatchArray) -> Moved:
        """Where the arms are one control period later, with the joints commanded to `target_q [B, n]`."""
        ...

    def render(self, state: ArmState, goal: Goal, index: int, marks: Marks) -> np.ndarray:
        """Picture of one arm for people, `[height, width, 3]` uint8, with marks where the simulator draws them."""
        ...

    def render_observations(self, q: np.ndarray, goal: Goal, views: Views, indices: np.ndarray) -> np.ndarray:
        """Pictures of the observation camera, `[m, SIZE, SIZE]` uint8.

        Of joints `q [m, n]`, goals and views; `indices [m]` are the numbers of their environments.
        """
        ...

    def close(self) -> None:
        """Give back what the engine holds. May be called twice."""
        ...


@dataclass(frozen=True)
class SimulatorEntry(Lazy):
    """A simulator of the table; its class, and with it the engine, is imported when it is loaded.

    Attributes:
        real_time: joints take time to move, so that a command may change no faster than they can.
        dynamics: arms can differ from each other, see `RunConfig.randomise`.
        obstacles: there can be obstacles, and contacts are told.
        most_envs: arms that it can hold; None for any number.
        draws_anything: its observation camera draws any goal, not only the one that lies beside an arm now.
    """

    real_time: bool = False
    dynamics: bool = False
    obstacles: bool = False
    most_envs: int | None = None
    draws_anything: bool = True


SIMULATORS: dict[str, SimulatorEntry] = {
    "kinematic": SimulatorEntry(
        "joints follow their commands exactly; batched in JAX", "reachlab.sims.kinematic:KinematicSimulator"
    ),
    "mujoco": SimulatorEntry(
        "full dynamics: gravity, inertia, position servos with torque limits; batched on all cores",
        "reachlab.sims.mujoco:MujocoSimulator",
        real_time=True,
        dynamics=True,
        obstacles=True,
    ),
    "pybullet": SimulatorEntry(
        "the tutorial's own: joints are set, an object falls; at most 16 environments, needs the extra 'pybullet'",
        "reachlab.sims.pybullet:PybulletSimulator",
        most_envs=16,
        draws_anything=False,
    ),
}
"""Simulators by name. Adding one takes its file and its line here."""


def make_simulator(
    name: str,
    robot: Robot,
    config: SimConfig,
    num_envs: int,
    threads: int = 0,
    *,
    randomise_dynamics: bool = False,
    obstacles: int = 0,
) -> Simulator:
    """Simulator of that name with `num_envs` arms, which differ where their dynamics vary.

    One that is outside JAX steps them on so many threads if it can, 0 for one a core.

    With at most so many `obstacles` around each arm it tells contacts, see `ArmState.contact`; with 0 there are none.

    Raises:
        InputError: there is none of that name, or it cannot be used so.
    """
    entry = SIMULATORS[choose("simulator", name, SIMULATORS)]
    if obstacles and not entry.obstacles:
        able = " or ".join(f"--sim {other}" for other, one in SIMULATORS.items() if one.obstacles)
        raise InputError(f"simulator {name!r} has no obstacles: use {able}.")
    varied = randomise_dynamics and entry.dynamics
    return entry.load()(robot, config, num_envs, threads=threads, randomise_dynamics=varied, obstacles=obstacles)
