"""What the environment asks of a simulator: arms that follow commands, and their state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import Bodies
from reachlab.control.situation import Goal
from reachlab.render.marks import Marks
from reachlab.render.view_randomisation import Views
from reachlab.robots.kinematics.forward import Pose, norm
from reachlab.robots.robot import Robot
from reachlab.settings.config import SimConfig
from reachlab.settings.validation import InputError, choose
from reachlab.sims import SIMULATORS
from reachlab.tasks.task import EMPTY, Scene


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SimState:
    """A batch of arms, and what is beside them.

    Attributes:
        q: joint positions `[B, n]` [rad or m].
        qd: joint speeds `[B, n]` [rad/s or m/s].
        tool_position: `[B, 3]` [m].
        tool_quaternion: `[B, 4]`, wxyz.
        bodies: what is beside each arm, `[B, K]`; the only copy.
        contact: whether the arm touched something in the last control period, or touches it after a reset `[B]`;
            without numbers, `[B, 0]`, where contacts are not judged.
        opening: of the gripper `[B, 1]` [m]; `[B, 0]` where none is driven.
        engine: whatever else an engine needs to continue exactly from here, `[B, m]` uint32, the bits of its numbers.
        wrench: force and torque at the wrist `[B, 6]` [N, Nm], mean of the last control period, or as they are after a
            reset, see `sims.wrench`; None where they are not measured.
    """

    q: Array
    qd: Array
    tool_position: Array
    tool_quaternion: Array
    bodies: Bodies
    contact: Array
    opening: Array
    engine: Array | None = None
    wrench: Array | None = None

    @property
    def actuated(self) -> Array:
        """Where what can be commanded is, `[B, m]`: joints, and the gripper's opening."""
        return jnp.concatenate([self.q, self.opening], axis=-1)

    @property
    def tool(self) -> Pose:
        """The tool's pose."""
        return Pose(self.tool_position, self.tool_quaternion)

    @property
    def force(self) -> Any:
        """How large the force at the wrist is `[B]` [N]; None where it is not measured."""
        return None if self.wrench is None else norm(self.wrench[:, :3])


class Moved(NamedTuple):
    """Where a step took a batch of arms; like `SimState`, but for the tool.

    Attributes:
        q, qd, bodies, contact, opening, engine, wrench: see `SimState`.
        tool: its pose; None where it is that of the joints by forward kinematics, which is left to the caller to
            compute, together with what it computes next.
    """

    q: Array
    qd: Array
    bodies: Bodies
    contact: Array
    opening: Array
    tool: Pose | None = None
    engine: Array | None = None
    wrench: Array | None = None


class Begin(NamedTuple):
    """What `B` episodes begin with.

    Attributes:
        key: `[B]`, of the environments' next episodes.
        q: joints `[B, n]` [rad or m].
        goal: what is asked for.
        bodies: what is beside the arms `[B, K]`.
        dynamics: which arms they are `[B, 2 n + 2]` in -1 to 1: the gain of each servo, the damping of each joint, the
            payload and the lag; then which objects, by the mass and the friction of all; without what does not vary.
    """

    key: Array
    q: Array
    goal: Goal
    bodies: Bodies
    dynamics: Array


BatchArray = Array | np.ndarray
"""A batch, on either side of JAX."""

Kind = Literal["traced", "host"]
"""How a simulator steps: in functions that JAX can trace, all its state being the `SimState`; or outside JAX."""


class Simulator(Protocol):
    """A batch of arms that follow joint commands.

    `lag [n]` is the time by which each joint follows a steadily moving command [s]: 0 where joints are set.
    """

    kind: Kind
    lag: tuple[float, ...]

    def reset(self, state: SimState | None, begin: Begin, mask: BatchArray | None) -> SimState:
        """State in which the arms of `mask [B]` are at rest as they begin; without a state (the first time) all are."""
        ...

    def step(self, state: SimState | Moved, command: BatchArray) -> Moved:
        """Where the arms are one control period later, their actuators commanded to `command [B, m]`.

        Bodies that do not move are where the state has them.
        """
        ...

    def render(self, state: SimState, goal: Goal, index: int, marks: Marks) -> np.ndarray:
        """Picture of one arm for people, `[height, width, 3]` uint8, with marks where the simulator draws them."""
        ...

    def render_observations(self, state: SimState, goal: Goal, views: Views, indices: np.ndarray) -> np.ndarray:
        """Pictures of the observation camera, `[m, SIZE, SIZE]` uint8.

        Of arms with what is beside them, goals and views, all of NumPy; `indices [m]` are the numbers of their
        environments.
        """
        ...

    def close(self) -> None:
        """Give back what the engine holds. May be called twice."""


def chosen(mask: BatchArray | None, new: Any, old: Any) -> Any:
    """A pytree of batches with the rows of `new` where `mask [B]` says so; `new` without a mask. In NumPy or JAX."""
    if mask is None or old is None:
        return new
    xp: Any = np if isinstance(mask, np.ndarray) else jnp

    def pick(a: Any, b: Any) -> Any:
        return a if a is b else xp.where(mask.reshape(mask.shape + (1,) * (a.ndim - 1)), a, b)

    return jax.tree.map(pick, new, old)


def make_simulator(
    name: str,
    robot: Robot,
    config: SimConfig,
    num_envs: int,
    threads: int = 0,
    *,
    randomise: Sequence[str] = (),
    scene: Scene = EMPTY,
) -> Simulator:
    """Simulator of that name with `num_envs` arms, which differ in what `randomise` names, see `RunConfig.randomise`.

    One that is outside JAX steps them on so many threads if it can, 0 for one a core. The scene says what may be beside
    each arm.

    Raises:
        InputError: there is none of that name, or it cannot be used so.
    """
    entry = SIMULATORS[choose("simulator", name, SIMULATORS)]
    asked = {"contacts": (scene.contacts, "judges no contacts"), "wrench": (scene.wrench, "measures no wrench")}
    for word, (wanted, lacking) in asked.items():
        if wanted and word not in entry.gives:
            able = " or ".join(f"--sim {other}" for other, one in SIMULATORS.items() if word in one.gives)
            raise InputError(f"simulator {name!r} {lacking}: use {able}.")
    varied = tuple(randomise) if "dynamics" in entry.gives else ()
    return entry.load()(robot, config, num_envs, threads=threads, randomise=varied, scene=scene)
