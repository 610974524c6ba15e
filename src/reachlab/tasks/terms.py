"""Terms of observations: what a policy may observe, with units and bounds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.situation import Situation
from reachlab.robots.kinematics.forward import components, norm, stack
from reachlab.robots.kinematics.inverse import MAX_JOINT_STEP, rotation_error
from reachlab.robots.kinematics.scalars import rotation_from_quaternion
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.schema import GOALS, Term
from reachlab.tasks.task import Bounds, TaskSetup

LOWEST_GOAL = -0.05
"""Bottom of the observed box [m]: the tutorial's settled object lies just below the workspace."""

FASTEST = 5
"""On a smooth path the goal is faster than its mean speed: at times 2.5 times as fast, and never so many times."""

GRAVITY, RANGE, LEVER = 9.81, 2.0, 0.1
"""Gravity [m/s²]; up to how many times the weight of the arm with its payload a force at the wrist is measured, and the
share of the arm's length that makes a torque of it. A UR5e's are 400 N and 52 Nm; Robotiq's FT 300 has 300 and 30."""

APART = 1e-5
"""Distance from the tool up to which a target counts as one that is not seen: it is observed where the tool is [m]."""

NEAR = 0.02
"""Distance at which the near form of the way to the goal is half as long as a far one [m]."""


# --- terms ----------------------------------------------------------------------------------------


def _goal_bounds(setup: TaskSetup) -> Bounds:
    """The box of goals; of goals on the table the workspace above it too."""
    if setup.rules.hides_goal:  # at times it is observed where the tool is
        return _tool_bounds(setup)
    low, high = setup.task.goal_box(setup)
    if (low < high).all() and "object" not in setup.rules.gives:  # smaller objects lie lower
        return low, high
    inner, outer = np.array(setup.robot.workspace, np.float32)
    low[2] = min(inner[2], LOWEST_GOAL, low[2])
    high[2] = max(outer[2], high[2])
    return low, high


def _goal_constant(setup: TaskSetup) -> np.ndarray:
    low, high = setup.task.goal_box(setup)
    return (low == high) & (not setup.rules.hides_goal)


def _tool_bounds(setup: TaskSetup) -> Bounds:
    """A cube that holds every point the arm can reach: all its offsets and slides in one line."""
    return within(np.full(3, setup.robot.chain.longest))


def within(size: np.ndarray | Sequence[float]) -> Bounds:
    """Bounds of numbers that are at most so large either way."""
    size = np.asarray(size, np.float32)
    return -size, size


def _joint_bounds(setup: TaskSetup) -> Bounds:
    """The limits; joints swing past them for moments."""
    lower, upper = (np.array(limit, np.float32) for limit in (setup.robot.chain.lower, setup.robot.chain.upper))
    swing = np.float32(0.1)
    return lower - swing, upper + swing


def _speed_bounds(setup: TaskSetup) -> Bounds:
    """What an overloaded arm, or one whose joints are set, comes to: inverse kinematics take two bounded steps."""
    longest = max(2 * MAX_JOINT_STEP, setup.rules.joint_scale or 0.0)
    return within(np.maximum(10 * np.array(setup.robot.speed), longest / setup.period))


def _lag_bounds(setup: TaskSetup) -> Bounds:
    lower, upper = (np.array(limit, np.float32) for limit in (setup.robot.chain.lower, setup.robot.chain.upper))
    return within(upper - lower)


def _joint_way_bounds(setup: TaskSetup) -> Bounds:
    low, high = _joint_bounds(setup)
    return low - high, high - low


def way_bounds(setup: TaskSetup) -> Bounds:
    """Bounds of the way between any place of the tool and any goal."""
    tool, goal = _tool_bounds(setup), _goal_bounds(setup)
    return within(np.maximum(np.abs(goal[0] - tool[1]), np.abs(goal[1] - tool[0])))


def _action_bounds(setup: TaskSetup) -> Bounds:
    return within(np.abs(ACTIONS[setup.rules.action].bounds(setup)).max(axis=0))


def _way(_setup: TaskSetup, now: Situation) -> Array:
    return now.goal.position - now.tool_position


def near_form(way: Array, near: float = NEAR) -> Array:
    """A way `[B, k]` drawn together, so that its last millimetres count: half as long as a far one at `near`."""
    return way / (norm(way)[..., None] + near)


def _seen(setup: TaskSetup, now: Situation) -> Array:
    return (norm(_way(setup, now)) > APART)[..., None].astype(jnp.float32)


def _achieved(setup: TaskSetup, now: Situation) -> Array:
    """Where what is moved truly is, so that rewards can be recomputed."""
    place = now.achieved.position
    return _posed(place, now.achieved.quaternion) if setup.rules.asks_orientation else place


def _desired(_setup: TaskSetup, now: Situation) -> Array:
    return _posed(now.goal.position, now.goal.quaternion)


def _posed(position: Array, quaternion: Array) -> Array:
    """A pose as one row, whose quaternion is within its bounds however it was rounded."""
    return jnp.concatenate([position, jnp.clip(quaternion, -1.0, 1.0)], axis=-1)


def _or_pose(bounds: Callable[[TaskSetup], Bounds]) -> Callable[[TaskSetup], Bounds]:
    """Bounds of a position or, where an orientation is asked for, of a pose."""

    def of(setup: TaskSetup) -> Bounds:
        low, high = bounds(setup)
        numbers = np.ones(4 * setup.rules.asks_orientation, np.float32)
        return np.concatenate([low, -numbers]), np.concatenate([high, numbers])

    return of


def _desired_constant(setup: TaskSetup) -> np.ndarray:
    return np.concatenate([_goal_constant(setup), np.zeros(4 * setup.rules.asks_orientation, bool)])


def axes(quaternion: Array) -> Array:
    """First two axes `[..., 6]` of an orientation `[..., 4]`: the same for both quaternions of it, and continuous.

    Zhou et al., "On the continuity of rotation representations in neural networks", CVPR 2019.
    """
    turned = rotation_from_quaternion(*components(quaternion))
    return jnp.stack([jnp.asarray(number) for axis in turned[:2] for number in axis], axis=-1)


def _turn(_setup: TaskSetup, now: Situation) -> Array:
    """From the tool's orientation to the goal's: twice the sine of half the angle, times the axis."""
    tool, goal = (rotation_from_quaternion(*components(q)) for q in (now.tool_quaternion, now.goal.quaternion))
    return stack(rotation_error(tool, goal), now.tool_position)


def _turn_near(setup: TaskSetup, now: Situation) -> Array:
    return near_form(_turn(setup, now), NEAR / setup.rules.angle_weight)


def _goal_velocity(_setup: TaskSetup, now: Situation) -> Array:
    return now.goal.velocity


def _goal_velocity_bounds(setup: TaskSetup) -> Bounds:
    return within(np.full(3, FASTEST * setup.rules.goal_speed[1]))


def _goal_velocity_constant(setup: TaskSetup) -> np.ndarray:
    """It is always zero where it is not told, or nothing but jumps."""
    rules = setup.rules
    moves = rules.goal_velocity and rules.goal_speed[1] > 0 and any(name != "jumps" for name in rules.goal_paths)
    return np.full(3, not moves)


GOAL = Term("goal", "m", lambda _, now: now.goal.position, _goal_bounds, _goal_constant)
TOOL = Term("tool", "m", lambda _, now: now.tool_position, _tool_bounds)
IMAGE = Term(
    "image",
    "grey",
    lambda _, now: now.picture,
    lambda _: (np.zeros(1, np.uint8), np.full(1, 255, np.uint8)),
    picture=True,
)

ARM = (
    Term("joints", "rad or m", lambda _, now: now.q, _joint_bounds),
    Term("joint_speeds", "rad/s or m/s", lambda _, now: now.qd, _speed_bounds),
    Term(
        "lag",
        "rad or m",
        lambda _, now: now.command[..., : now.q.shape[-1]] - now.q,
        _lag_bounds,
        lambda setup: np.array(setup.lag) == 0.0,
    ),
    TOOL,
)
"""Joints, their speeds and how far they are behind their commands, and the tool."""

LAST_ACTION = Term("last_action", "1", lambda _, now: now.last_action, _action_bounds)

STATE = (
    *ARM,
    GOAL,
    Term("way", "m", _way, way_bounds),
    Term("way_near", "1", lambda setup, now: near_form(_way(setup, now)), lambda _: within(np.ones(3))),
    LAST_ACTION,
)
"""The arm, the goal, the way to it from the tool and the same drawn together, and the last action."""

JOINT_WAY = Term("joint_way", "rad or m", lambda _, now: now.goal.joints - now.q, _joint_way_bounds)

TOOL_AXES = Term("tool_axes", "1", lambda _, now: axes(now.tool_quaternion), lambda _: within(np.ones(6)))

POSE = (
    *STATE,
    TOOL_AXES,
    Term("goal_axes", "1", lambda _, now: axes(now.goal.quaternion), lambda _: within(np.ones(6))),
    Term("turn", "rad", _turn, lambda _: within(np.full(3, 2.0))),
    Term("turn_near", "1", _turn_near, lambda _: within(np.ones(3))),
    JOINT_WAY,
)
"""The same with both orientations, the turn between them, and the way of the joints to a solution of the goal."""

TRACK = (*STATE, Term("goal_velocity", "m/s", _goal_velocity, _goal_velocity_bounds, _goal_velocity_constant))
"""The same as `STATE`, and how fast the goal moves."""


def _wrench_bounds(setup: TaskSetup) -> Bounds:
    robot = setup.robot
    force = RANGE * GRAVITY * (robot.mass + robot.payload)
    return within([force] * 3 + [LEVER * robot.chain.longest * force] * 3)


def _wrench(setup: TaskSetup, now: Situation) -> Array:
    """Force and torque as far as a sensor reaches."""
    return jnp.clip(jnp.asarray(now.wrench), *_wrench_bounds(setup))


WRIST = Term("wrench", "N and Nm", _wrench, _wrench_bounds)
"""Force [N] and torque [Nm] at the wrist, see `sims.wrench`."""

SEEN = Term(
    "seen",
    "1",
    _seen,
    lambda _: (np.zeros(1, np.float32), np.ones(1, np.float32)),
    lambda setup: np.full(1, not setup.rules.hides_goal),
)
"""1 where the target is seen, or else 0."""

ACHIEVED_AND_DESIRED = (
    Term(GOALS[0], "m", _achieved, _or_pose(_tool_bounds)),
    Term(GOALS[1], "m", _desired, _or_pose(_goal_bounds), _desired_constant),
)
"""Where the tool is, and where it is asked to be: positions, or poses with a quaternion wxyz."""
