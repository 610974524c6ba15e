"""The reach task as pure functions in tables: observations, actions, rewards, targets, and its end.

Functions take arrays with a batch of lanes in front and never a simulator or a generator, so that each is
written once, traced for the pure simulator and compiled for the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.config import TaskConfig, choose
from reachlab.kinematics import Pose, forward_kinematics, ik_displace, ik_step
from reachlab.robots import Robot

OUTSIDE_REWARD = -0.1
"""Reward of leaving the workspace (the tutorial's)."""

TIMEOUT_REWARD = -0.1
"""Reward of running out of time (the tutorial's)."""

SUCCESS_REWARD = 1.0
"""Reward of reaching the target (the tutorial's)."""

LOWEST_TARGET = -0.05
"""Bottom of the observed box [m]: the settled target lies just below the workspace."""

Bounds = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Reach:
    """The task on a robot; constants known while tracing."""

    config: TaskConfig
    robot: Robot


class Situation(NamedTuple):
    """What observations and baselines may look at, in lanes.

    `q, target_q [B, n]` rad, `qd [B, n]` rad/s, `tool_position, target [B, 3]` m, `last_action [B, a]`.
    """

    q: Array
    qd: Array
    tool_position: Array
    target: Array
    target_q: Array
    last_action: Array


class Outcome(NamedTuple):
    """What a step led to, `[B]` each; distances from tool to target in metres."""

    distance_before: Array
    distance: Array
    outside: Array
    success: Array
    timeout: Array


# --- targets and starts ---------------------------------------------------------------------------


def draw_target(reach: Reach, key: Array) -> Array:
    """Target `[3]`: x and y uniform in the workspace, at the configured height."""
    (low_x, low_y, _), (high_x, high_y, _) = reach.robot.workspace
    xy = jax.random.uniform(key, (2,), minval=jnp.array([low_x, low_y]), maxval=jnp.array([high_x, high_y]))
    return jnp.append(xy, reach.config.target_height)


def draw_start(reach: Reach, key: Array) -> Array:
    """Joint vector `[n]` in which an episode starts: the robot's home."""
    del key
    return jnp.array(reach.robot.home)


# --- observations ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Observation:
    """An observation design: what it holds, its bounds `[k]` and the function that gives `[B, k]`."""

    summary: str
    bounds: Callable[[Reach], Bounds]
    observe: Callable[[Reach, Situation], Array]


def _target_bounds(reach: Reach) -> Bounds:
    low, high = np.array(reach.robot.workspace, np.float32)
    low[2] = min(low[2], LOWEST_TARGET, reach.config.target_height)
    high[2] = max(high[2], reach.config.target_height)
    return low, high


def _tool_bounds(reach: Reach) -> Bounds:
    """A cube that holds every point the arm can reach: all its offsets and slides in one line."""
    chain = reach.robot.chain
    offsets = sum(float(np.linalg.norm(np.array(offset))) for _, offset in chain.frames)
    slides = sum(
        max(abs(low), abs(high)) for low, high, s in zip(chain.lower, chain.upper, chain.slides, strict=True) if s
    )
    corner = np.full(3, offsets + slides, np.float32)
    return -corner, corner


def _join(*parts: Bounds) -> Bounds:
    low, high = zip(*parts, strict=True)
    return np.concatenate(low), np.concatenate(high)


OBSERVATIONS: dict[str, Observation] = {
    "target": Observation("the target's position [m]", _target_bounds, lambda _, now: now.target),
    "target+tool": Observation(
        "the target's and the tool's positions [m]",
        lambda reach: _join(_target_bounds(reach), _tool_bounds(reach)),
        lambda _, now: jnp.concatenate([now.target, now.tool_position], axis=-1),
    ),
}
"""Observation designs by name."""


def observe(reach: Reach, now: Situation) -> Array:
    """Observation `[B, k]` of a situation."""
    return OBSERVATIONS[reach.config.observation].observe(reach, now)


# --- actions --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Action:
    """An action design.

    Attributes:
        summary: what it moves.
        bounds: its box, lower and upper bounds `[a]`.
        command: next joint command `[B, n]` from the last one and an action `[B, a]`; within the joint limits.
        towards: the action `[B, a]` with which inverse kinematics goes straight to the target.
    """

    summary: str
    bounds: Callable[[Reach], Bounds]
    command: Callable[[Reach, Array, Array], Array]
    towards: Callable[[Reach, Situation], Array]


def _tool_box(reach: Reach) -> Bounds:
    """The tutorial's box: x and y in ±0.4, z in -0.6 to 0.3."""
    del reach
    return np.array([-0.4, -0.4, -0.6], np.float32), np.array([0.4, 0.4, 0.3], np.float32)


def _move_tool(reach: Reach, target_q: Array, action: Array) -> Array:
    """Joint command whose tool point is displaced by the action, the tool held in its orientation."""
    displacement = action * reach.config.tool_scale
    held = jnp.broadcast_to(jnp.array(reach.robot.held_quaternion), (*action.shape[:-1], 4))
    return ik_displace(reach.robot.chain, target_q, displacement, held)


def _tool_towards(reach: Reach, now: Situation) -> Array:
    """Straight line to the target at the box's full speed."""
    wanted = (now.target - now.tool_position) / reach.config.tool_scale
    low, high = _tool_box(reach)
    excess = jnp.where(wanted > 0, wanted / high, wanted / low).max(axis=-1, keepdims=True)
    return wanted / jnp.maximum(excess, 1.0)


def _joint_box(reach: Reach) -> Bounds:
    ones = np.ones(reach.robot.chain.n, np.float32)
    return -ones, ones


def _move_joints(reach: Reach, target_q: Array, action: Array) -> Array:
    """Joint command displaced by the action."""
    chain = reach.robot.chain
    return jnp.clip(target_q + action * reach.config.joint_scale, jnp.array(chain.lower), jnp.array(chain.upper))


def _joints_towards(reach: Reach, now: Situation) -> Array:
    """Joint displacement of one inverse-kinematics step to the target, the tool's orientation kept."""
    chain = reach.robot.chain
    pose = forward_kinematics(chain, now.target_q)
    moved = ik_step(chain, now.target_q, Pose(now.target, pose.quaternion))
    wanted = (moved - now.target_q) / reach.config.joint_scale
    return wanted / jnp.maximum(jnp.abs(wanted).max(axis=-1, keepdims=True), 1.0)


ACTIONS: dict[str, Action] = {
    "tool_delta": Action("a displacement of the tool, its orientation held", _tool_box, _move_tool, _tool_towards),
    "joint_delta": Action("a displacement of every joint", _joint_box, _move_joints, _joints_towards),
}
"""Action designs by name."""


def command(reach: Reach, target_q: Array, action: Array) -> Array:
    """Next joint command `[B, n]` from the last one `[B, n]` and an action `[B, a]`."""
    design = ACTIONS[reach.config.action]
    if reach.config.clip_actions:
        action = jnp.clip(action, *design.bounds(reach))
    return design.command(reach, target_q, action)


# --- rewards and end ------------------------------------------------------------------------------


def _sparse(config: TaskConfig, outcome: Outcome) -> dict[str, Array]:
    """1 for reaching the target, -0.1 for leaving the workspace or running out of time: the tutorial's."""
    del config
    return {
        "reach": SUCCESS_REWARD * outcome.success,
        "outside": OUTSIDE_REWARD * outcome.outside,
        "timeout": TIMEOUT_REWARD * outcome.timeout,
    }


def _dense(config: TaskConfig, outcome: Outcome) -> dict[str, Array]:
    """As sparse, and for every metre that the tool comes closer."""
    approach = config.approach_weight * (outcome.distance_before - outcome.distance)
    return {**_sparse(config, outcome), "approach": approach}


REWARDS: dict[str, Callable[[TaskConfig, Outcome], dict[str, Array]]] = {"sparse": _sparse, "dense": _dense}
"""Rewards by name; each gives named terms `[B]` whose sum is the reward."""


def judge(reach: Reach, distance_before: Array, tool_position: Array, target: Array, clock: Array) -> Outcome:
    """Outcome of a step that brought the tool to `tool_position [B, 3]` as step number `clock [B]`.

    Leaving the workspace outranks success, and success a time-out on the same step.
    """
    low, high = (jnp.array(corner) for corner in reach.robot.workspace)
    outside = ((tool_position < low) | (tool_position > high)).any(axis=-1)
    distance = jnp.linalg.norm(tool_position - target, axis=-1)
    success = ~outside & (distance < reach.config.success_distance)
    timeout = ~outside & ~success & (clock >= reach.config.max_steps)
    return Outcome(distance_before, distance, outside, success, timeout)


def make_reach(config: TaskConfig, robot: Robot) -> Reach:
    """The task on a robot.

    Raises:
        InputError: an observation, action or reward that does not exist.
    """
    for kind, name, table in (
        ("observation", config.observation, OBSERVATIONS),
        ("action", config.action, ACTIONS),
        ("reward", config.reward, REWARDS),
    ):
        choose(kind, name, table)
    return Reach(config, robot)
