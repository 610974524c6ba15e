"""Where goals are: points on the table or in a box, poses there, and any pose that the arm has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.spatial.transform import Rotation

from reachlab.control.situation import Goal
from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.kinematics.forward import Pose, forward_kinematics
from reachlab.robots.kinematics.inverse import inverse_kinematics
from reachlab.robots.shapes.clearance import free_of_contact
from reachlab.settings.tables import Table
from reachlab.tasks.task import Bounds, TaskSetup

Tree = TypeVar("Tree")

WXYZ, XYZW = (3, 0, 1, 2), (1, 2, 3, 0)
"""Where the numbers of a quaternion are found in one of the other order."""

STARTS = 8
"""Random joints from which a pose is solved for, beside those it is to be near to."""

ITERATIONS = 30
"""Steps of the solver from each; from nine starts fewer than one pose in a thousand takes more."""

POSITION_TOLERANCE, ANGLE_TOLERANCE = 1e-4, 5e-4
"""Errors with which a pose counts as solved [m, rad]. The goal becomes the solution's own pose, so they do not stay."""

DRAWS = 100
"""Poses drawn at most until one can be reached; where none can, none of the arm's goals could be."""


@dataclass(frozen=True)
class Targets:
    """Goals by name.

    Attributes:
        summary: where they are, in words.
        corners: lower and upper corner `[3]` m of the box that holds them.
        sample: a goal, of a random key.
    """

    summary: str
    corners: Callable[[TaskSetup], Bounds]
    sample: Callable[[TaskSetup, Array], Goal]


# --- boxes ----------------------------------------------------------------------------------------


def _table_corners(setup: TaskSetup) -> Bounds:
    """The workspace's x and y, at the configured height."""
    low, high = np.array(setup.robot.workspace, np.float32)
    low[2] = high[2] = setup.rules.target_height
    return low, high


def box_corners(setup: TaskSetup) -> Bounds:
    """Corners `[3]` m of the configured box, by default the robot's."""
    given = (setup.rules.target_low, setup.rules.target_high)
    low, high = (own if one is None else one for one, own in zip(given, setup.robot.goal_box, strict=True))
    return np.array(low, np.float32), np.array(high, np.float32)


def _reach_corners(setup: TaskSetup) -> Bounds:
    """The box above the table that holds every point the tool can reach."""
    high = np.full(3, setup.robot.chain.longest, np.float32)
    low = -high
    low[2] = setup.robot.workspace[0][2]
    return low, high


def sample_point(setup: TaskSetup, key: Array) -> Array:
    """Point `[3]`, uniform in the box of goals."""
    low, high = TARGETS[setup.rules.targets].corners(setup)
    wide = low < high
    sampled = jax.random.uniform(key, (int(wide.sum()),), minval=low[wide], maxval=high[wide])
    return jnp.array(low).at[np.flatnonzero(wide)].set(sampled)


def _sample_in_box(setup: TaskSetup, key: Array) -> Goal:
    """A point or, where an orientation is asked for, a pose that can be reached."""
    if not setup.rules.asks_orientation:
        return Goal.at(sample_point(setup, key))
    return first_reached(lambda key: _turned_pose(setup, key), setup, key)


# --- poses ----------------------------------------------------------------------------------------


class Drawn(NamedTuple):
    """A goal that was drawn, the joints `[n]` at which the tool comes nearest to it, and whether it is there."""

    key: Array
    q: Array
    reached: Array
    draws: Array


def first_reached(draw: Callable[[Array], Drawn], setup: TaskSetup, key: Array) -> Goal:
    """The first goal drawn that the arm can reach and be at freely; exactly the pose of the joints that were found."""
    nothing = Drawn(key, *of_key(key, (jnp.array(setup.robot.home), jnp.zeros((), bool), jnp.zeros((), jnp.int32))))

    def again(before: Drawn) -> Drawn:
        drawn = draw(before.key)
        free = free_of_contact(setup.robot.chain, setup.robot.capsules, drawn.q[None])[0]
        return drawn._replace(reached=drawn.reached & free, draws=before.draws + 1)

    found = jax.lax.while_loop(lambda drawn: ~drawn.reached & (drawn.draws < DRAWS), again, nothing)
    pose = forward_kinematics(setup.robot.chain, found.q)
    return Goal.at(pose.position, quaternion=pose.quaternion, joints=found.q)


def of_key(key: Array, tree: Tree) -> Tree:
    """The same numbers, of a batch where the key is of one, to begin a loop with.

    JAX traces a loop's body anew for the parts of what it carries that turn out to be of a batch.
    """
    zero = jax.random.key_data(key).ravel()[0] & 0
    return jax.tree.map(lambda x: x + zero.astype(x.dtype), tree)


def _turned_pose(setup: TaskSetup, key: Array) -> Drawn:
    """A point of the box, and there the held orientation turned by a random roll, pitch and yaw."""
    key, for_point, for_turn, for_starts = jax.random.split(key, 4)
    most, home = jnp.array(setup.rules.target_turn), jnp.array(setup.robot.home)
    turn = Rotation.from_euler("xyz", jax.random.uniform(for_turn, (3,), minval=-most, maxval=most))
    held = Rotation.from_quat(jnp.array(setup.robot.held_quaternion)[jnp.array(XYZW)])
    pose = Pose(sample_point(setup, for_point), (turn * held).as_quat()[jnp.array(WXYZ)])
    return Drawn(key, *nearest_joints(setup, pose, home, home, for_starts), jnp.zeros((), jnp.int32))


def _any_pose(setup: TaskSetup, key: Array) -> Drawn:
    """The pose of random joints."""
    key, for_joints, for_starts = jax.random.split(key, 3)
    chain, home = setup.robot.chain, jnp.array(setup.robot.home)
    q = jax.random.uniform(for_joints, (chain.n,), minval=jnp.array(chain.lower), maxval=jnp.array(chain.upper))
    nearest, reached = nearest_joints(setup, forward_kinematics(chain, q), home, q, for_starts)
    return Drawn(key, nearest, reached, jnp.zeros((), jnp.int32))


def nearest_joints(
    setup: TaskSetup, pose: Pose, near: Array, start: Array, key: Array, chain: Chain | None = None
) -> tuple[Array, Array]:
    """Joints `[n]` of a pose: of all solutions that are found that soonest reached from `near [n]`; and if any was.

    Solved for from there, from `start [n]` and from random joints. How soon is told by the joint that takes longest at
    full speed. An arm with fewer than six joints has the position and the tilt of the pose alone, but by a `chain` that
    is asked for poses.
    """
    chain = chain or setup.robot.chain
    random = jax.random.uniform(key, (STARTS, chain.n), minval=jnp.array(chain.lower), maxval=jnp.array(chain.upper))
    starts = jnp.concatenate([near[None], start[None], random])
    found = inverse_kinematics(
        chain,
        Pose(*(jnp.broadcast_to(part, (len(starts), *part.shape)) for part in pose)),
        starts,
        key,
        restarts=0,
        iterations=ITERATIONS,
        position_tolerance=POSITION_TOLERANCE,
        angle_tolerance=ANGLE_TOLERANCE,
    )
    # A hinge with more than a turn of play is in the same place a turn away.
    turns = jnp.where(jnp.array(chain.slides), 0.0, 2 * jnp.pi)
    back = found.q - turns * jnp.round((found.q - near) / (2 * jnp.pi))
    q = jnp.where((back >= jnp.array(chain.lower)) & (back <= jnp.array(chain.upper)), back, found.q)
    duration = (jnp.abs(q - near) / jnp.array(setup.robot.speed)).max(axis=-1)
    best = jnp.where(found.converged, duration, jnp.inf).argmin()
    return q[best], found.converged.any()


TARGETS: dict[str, Targets] = Table(
    {
        "table": Targets("on the table", _table_corners, _sample_in_box),
        "box": Targets("in a box, of target_low and target_high or the arm's own", box_corners, _sample_in_box),
        "any": Targets(
            "wherever random joints bring the tool",
            _reach_corners,
            lambda setup, key: first_reached(lambda key: _any_pose(setup, key), setup, key),
        ),
    }
)
"""Goals by name."""


def solved_for(setup: TaskSetup) -> bool:
    """Whether goals are drawn until joints are found that have them, which takes far longer than drawing a point."""
    return "joints" in setup.rules.gives
