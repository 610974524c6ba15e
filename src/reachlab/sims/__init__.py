"""Simulators: what the environment asks of one, and the table of those there are."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

import jax
import numpy as np
from jax import Array

from reachlab.render.marks import Marks
from reachlab.render.view_randomisation import Views
from reachlab.robots.loading import Robot
from reachlab.settings.config import SimConfig
from reachlab.settings.validation import choose


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ArmState:
    """A batch of arms.

    Attributes:
        q: joint positions `[B, n]` [rad or m].
        qd: joint speeds `[B, n]` [rad/s or m/s].
        tool_position: `[B, 3]` [m].
        tool_quaternion: `[B, 4]`, wxyz.
        engine: whatever else an engine needs to go on exactly from here, `[B, m]` uint32, the bits of its numbers.
    """

    q: Array
    qd: Array
    tool_position: Array
    tool_quaternion: Array
    engine: Array | None = None


BatchArray = Array | np.ndarray
"""A batch, on either side of JAX."""


class Simulator(Protocol):
    """A batch of arms that follow joint commands.

    `pure` says that all its state is the `ArmState`, so that `reset` and `step` can be traced by JAX. `lag [n]` is the
    time by which each joint follows a steadily moving command [s]: 0 where joints are set.
    """

    pure: bool
    lag: tuple[float, ...]

    def reset(
        self,
        state: ArmState | None,
        q: BatchArray,
        target: BatchArray,
        mask: BatchArray | None,
        chance: BatchArray | None = None,
    ) -> ArmState:
        """State with the lanes of `mask [B]` at rest at `q [B, n]`, their target drawn at `target [B, 3]`.

        Without a state (the first time) every lane is set. Where arms are perturbed, `chance [B, 2 n + 1]`,
        drawn in -1 to 1, decides which arm a lane gets.
        """
        ...

    def step(self, state: ArmState, target_q: BatchArray) -> ArmState:
        """State one control period later, with the joints commanded to `target_q [B, n]`."""
        ...

    def render(self, state: ArmState, target: Array, lane: int, marks: Marks) -> np.ndarray:
        """Picture of one lane, `[height, width, 3]` uint8, with marks where the simulator draws them."""
        ...

    def see(self, q: np.ndarray, target: np.ndarray, views: Views, lanes: np.ndarray) -> np.ndarray:
        """What the observation camera sees of some lanes, `[m, SIZE, SIZE]` uint8.

        Of their joints `q [m, n]`, targets `[m, 3]` and views; `lanes [m]` are their numbers.
        """
        ...

    def close(self) -> None:
        """Give back what the engine holds. May be called twice."""
        ...


@dataclass(frozen=True)
class Entry:
    """A simulator of the table: what it is, and where its class lies; its engine is imported when it is made."""

    summary: str
    module: str
    name: str
    real_time: bool = False
    """Joints take time to move: a command may change no faster than they can."""


SIMULATORS: dict[str, Entry] = {
    "kinematic": Entry(
        "joints follow their commands exactly; batched in JAX", "reachlab.sims.kinematic", "KinematicSimulator"
    ),
    "mujoco": Entry(
        "full dynamics: gravity, inertia, position servos with torque limits; batched on all cores",
        "reachlab.sims.mujoco",
        "MujocoSimulator",
        real_time=True,
    ),
    "pybullet": Entry(
        "the tutorial's own: joints are set, an object falls; at most 16 lanes, needs the extra 'pybullet'",
        "reachlab.sims.pybullet",
        "PybulletSimulator",
    ),
}
"""Simulators by name. Adding one takes its file and its line here."""


def make_simulator(name: str, robot: Robot, config: SimConfig, num_envs: int) -> Simulator:
    """Simulator of that name with `num_envs` arms.

    Raises:
        InputError: there is none of that name.
    """
    entry = SIMULATORS[choose("simulator", name, SIMULATORS)]
    return vars(import_module(entry.module))[entry.name](robot, config, num_envs)
