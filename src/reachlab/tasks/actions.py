"""What a policy commands: displacements of the tool or of the joints, and what inverse kinematics would do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.inverse_kinematics import ik_displace, ik_point_step
from reachlab.robots.kinematics import forward_kinematics, norm
from reachlab.tasks.avoidance import keep_clear
from reachlab.tasks.task import Bounds, Situation, TaskSetup, gap

TINY = 1e-6
"""Divides in place of a smaller number."""


@dataclass(frozen=True)
class Action:
    """An action design.

    Attributes:
        summary: what it moves.
        bounds: its box, lower and upper bounds `[a]`.
        command: next joint command `[B, n]` in a situation for an action `[B, a]`; within the joint limits.
        towards: the action `[B, a]` with which inverse kinematics goes to the target, in a situation and in what it
            believes of that situation.
        scale: the setting by which an action of 1 is multiplied, if there is one.
        turns: whether it can bring the tool into any orientation.
    """

    summary: str
    bounds: Callable[[TaskSetup], Bounds]
    command: Callable[[TaskSetup, Situation, Array], Array]
    towards: Callable[[TaskSetup, Situation, Situation], Array]
    scale: str | None = None
    turns: bool = True


def _tool_box(setup: TaskSetup) -> Bounds:
    """The tutorial's box: x and y in ±0.4, z in -0.6 to 0.3."""
    del setup
    return np.array([-0.4, -0.4, -0.6], np.float32), np.array([0.4, 0.4, 0.3], np.float32)


def _unit_box(setup: TaskSetup) -> Bounds:
    del setup
    return -np.ones(3, np.float32), np.ones(3, np.float32)


def _move_tool(setup: TaskSetup, now: Situation, action: Array) -> Array:
    """Joint command whose tool point is displaced by the action, the tool held in its orientation."""
    displacement = action * setup.rules.tool_scale
    held = jnp.broadcast_to(jnp.array(setup.robot.held_quaternion), (*action.shape[:-1], 4))
    return ik_displace(setup.robot.chain, now.target_q, displacement, held)


def _tool_towards(setup: TaskSetup, now: Situation, believed: Situation) -> Array:
    """Straight line to the target at the box's full speed."""
    del now
    wanted = (believed.goal.position - believed.tool_position) / setup.rules.tool_scale
    low, high = ACTIONS[setup.rules.action].bounds(setup)
    excess = jnp.where(wanted > 0, wanted / high, wanted / low).max(axis=-1, keepdims=True)
    return wanted / jnp.maximum(excess, 1.0)


def _joint_box(setup: TaskSetup) -> Bounds:
    ones = np.ones(setup.robot.chain.n, np.float32)
    return -ones, ones


def joint_scale(setup: TaskSetup) -> np.ndarray:
    """Displacement of each joint for an action of 1 `[n]` [rad or m]."""
    scale, full_speed = setup.rules.joint_scale, np.array(setup.robot.speed, np.float32) * setup.period
    return full_speed if scale is None else np.full_like(full_speed, scale)


def _move_joints(setup: TaskSetup, now: Situation, action: Array) -> Array:
    """Joint command displaced by the action, as far as obstacles allow."""
    chain, step = setup.robot.chain, action * joint_scale(setup)
    if now.obstacles is not None:
        # Limits that contradict each other, as where an obstacle is moved into the arm, may ask for anything.
        step = jnp.clip(keep_clear(setup, now, step), -joint_scale(setup), joint_scale(setup))
    return jnp.clip(now.target_q + step, jnp.array(chain.lower), jnp.array(chain.upper))


NEAR_GAIN, FAR_GAIN = 0.5, 2.5
"""Shares of the way to the target that inverse kinematics command in a time of the servos' lag: at the target and from
`APPROACH` on. With more at the target an arm whose servos lag swings about it; far from it their lag is foreseen."""

APPROACH = 0.05
"""Distance from which on the gain falls to that at the target, and the lag is foreseen less and less [m]: it is found
from measured speeds, whose noise would be felt at the target."""

TOOL_SPEED = 1.5
"""Speed at which inverse kinematics send the tool at most [m/s]: with more, most joints are at their own limit, and the
arm jerks for little gain."""


def _joints_towards(setup: TaskSetup, now: Situation, believed: Situation) -> Array:
    """Joint displacement that brings the tool to the target: to the joints of a pose, or to a point that may move."""
    del now
    if believed.goal.joints is not None:
        return _towards_joints(setup, believed)
    return (_towards_point if believed.goal.velocity is None else _with_point)(setup, believed)


JOINT_NEAR, JOINT_FAR = 0.5, 1.0
"""The same shares for a joint on its way to where it is known to have to be."""

APPROACH_ANGLE = 0.1
"""And the distance from which on the share falls [rad or m]."""

FORESIGHT = 0.4
"""Share of what its servo's lag will cost a joint in speed that is commanded at once, far from the target. With more it
arrives hardly sooner, and jerks twice as much."""


def _towards_joints(setup: TaskSetup, believed: Situation) -> Array:
    """Joint displacement that brings every joint to where the goal has it, each by itself.

    Its speed is proportional to its own way, up to its limit: no Jacobian is singular, and no limit lies in between.
    """
    assert believed.goal.joints is not None, "asked before"  # noqa: S101
    lag, most = np.array(setup.lag), jnp.array(setup.robot.speed)
    way = believed.goal.joints - believed.q
    far = jnp.minimum(jnp.abs(way) / APPROACH_ANGLE, 1.0)
    rate = jnp.minimum((JOINT_NEAR + far * (JOINT_FAR - JOINT_NEAR)) / np.maximum(lag, TINY), 1 / setup.period)
    speed = jnp.clip(rate * way, -most, most)
    step = setup.period * speed + far * FORESIGHT * lag * (speed - believed.qd)
    return jnp.clip(step / joint_scale(setup), *_joint_box(setup))


def _towards_point(setup: TaskSetup, believed: Situation) -> Array:
    """Joint displacement that brings the tool to the target in whatever orientation, by resolved-rate control.

    Each step goes a share of the way (Whitney, "Resolved motion rate control of manipulators and human prostheses",
    IEEE Trans. Man-Machine Systems 10(2), 1969) from where the arm will be once it has caught up with its command.
    """
    chain, lag, period = setup.robot.chain, np.array(setup.lag), setup.period
    way = believed.goal.position - believed.tool_position
    far = jnp.minimum(norm(way)[..., None] / APPROACH, 1.0)
    caught_up = believed.q + far * jnp.array(lag) * believed.qd
    way = believed.goal.position - forward_kinematics(chain, caught_up).position
    share = jnp.minimum((NEAR_GAIN + far * (FAR_GAIN - NEAR_GAIN)) * period / max(lag.max(), TINY), 1.0)
    return _point_step(setup, believed, caught_up, share * way)


LEAD = 0.9
"""Control periods by which the command is ahead of that, because it is followed from the next one on."""


def _with_point(setup: TaskSetup, believed: Situation) -> Array:
    """Joint displacement that keeps the tool at a point that moves, whose velocity is fed forward.

    The command goes to where the point will be once the arm has caught up with its command. With less than all of that
    in a step the arm would lag where the velocity changes.
    """
    assert believed.goal.velocity is not None, "asked before"  # noqa: S101
    chain, lag, period = setup.robot.chain, np.array(setup.lag), setup.period
    caught_up = believed.q + jnp.array(lag) * believed.qd
    ahead = believed.goal.position + (lag.max() + LEAD * period) * believed.goal.velocity
    return _point_step(setup, believed, caught_up, ahead - forward_kinematics(chain, caught_up).position)


def _point_step(setup: TaskSetup, believed: Situation, caught_up: Array, wanted: Array) -> Array:
    """Action that displaces the tool as is `wanted [B, 3]` m, up to `TOOL_SPEED`, from joints `caught_up [B, n]`."""
    most = TOOL_SPEED * setup.period / (norm(wanted)[..., None] + TINY)
    step = ik_point_step(setup.robot.chain, caught_up, believed.target_q, wanted * jnp.minimum(most, 1.0))
    return jnp.clip(step / joint_scale(setup), *_joint_box(setup))


CORRECTION, CORRECTION_FADE = 2.0, 0.02
"""Displacement that a correction of 1 adds, in those of inverse kinematics at most: enough to turn one round; and the
distance from which on corrections fade, to nothing at the target [m]: with its square, so that near the target the pull
of inverse kinematics, which is proportional to the distance, outweighs them."""

POSE_CORRECTION = 0.3
"""The same to the joints of a pose: not enough to turn one round, for they need no way round anything."""

CLUTTER_CORRECTION = 1.0
"""The same among obstacles: enough to stop, and with the dampers to be led round."""

MOVING_CORRECTION = 0.05
"""The same to a target that moves: never faded, for the tool is never just there, and as much as its errors take."""


def _worth(setup: TaskSetup, now: Situation) -> Array:
    """What a correction of 1 is worth in a situation `[B, 1]`."""
    if now.goal.velocity is not None:
        return jnp.full((len(now.q), 1), MOVING_CORRECTION)
    away = now.goal.distance(now.tool_position)
    if (angle := now.goal.angle(now.tool_quaternion)) is not None:
        away = gap(setup.rules, away, angle)
    most = CORRECTION if now.goal.joints is None else POSE_CORRECTION
    if now.obstacles is not None:
        most = CLUTTER_CORRECTION
    return most * jnp.minimum(jnp.square(away[:, None] / CORRECTION_FADE), 1.0)


def _correct_joints(setup: TaskSetup, now: Situation, action: Array) -> Array:
    """Joint command displaced by what inverse kinematics would do, and by the action, which fades at the target.

    Residual policy learning: Silver et al., arXiv:1812.06298; Johannink et al., arXiv:1812.03201.
    """
    corrected = _joints_towards(setup, now, now) + _worth(setup, now) * action
    return _move_joints(setup, now, jnp.clip(corrected, *_joint_box(setup)))


def _correction_towards(setup: TaskSetup, now: Situation, believed: Situation) -> Array:
    """Nothing, but where the situation is believed to be another."""
    correction = _joints_towards(setup, believed, believed) - _joints_towards(setup, now, now)
    return jnp.clip(correction / jnp.maximum(_worth(setup, now), TINY), *_joint_box(setup))


ACTIONS: dict[str, Action] = {
    "tool_delta": Action(
        "a displacement of the tool, its orientation held", _tool_box, _move_tool, _tool_towards, "tool_scale", False
    ),
    "tool_step": Action(
        "the same in a box of -1 to 1 in each direction", _unit_box, _move_tool, _tool_towards, "tool_scale", False
    ),
    "joint_delta": Action("a displacement of every joint", _joint_box, _move_joints, _joints_towards, "joint_scale"),
    "joint_residual": Action(
        "a displacement of every joint, added to that of inverse kinematics and fading at the target",
        _joint_box,
        _correct_joints,
        _correction_towards,
        "joint_scale",
    ),
}
"""Action designs by name."""

OWN = dict(ACTIONS)
"""Those that come with reachlab, beside which users add others, or replace one."""


def bounded(setup: TaskSetup, action: Array) -> Array:
    """The action `[B, a]` that is taken: clipped to its box, where the task clips."""
    return jnp.clip(action, *ACTIONS[setup.rules.action].bounds(setup)) if setup.rules.clip_actions else action


def command(setup: TaskSetup, now: Situation, action: Array) -> Array:
    """Next joint command `[B, n]` in a situation, for a bounded action `[B, a]`."""
    return ACTIONS[setup.rules.action].command(setup, now, action)
