"""The reach task as pure functions in tables: observations, actions, rewards, targets, and its end.

Functions take arrays with a batch of lanes in front and never a simulator or a generator, so that each is
written once, traced for the pure simulator and compiled for the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.robots.kinematics import forward_kinematics, ik_displace, ik_point_step
from reachlab.robots.loading import Robot
from reachlab.settings.config import TaskConfig
from reachlab.settings.validation import InputError, choose

SIZE = 84
"""Height and width of a picture [pixels]; the tutorial's."""

Observed = Any
"""An observation: a vector `[..., k]`, a picture `[..., SIZE, SIZE]` uint8, or a dict of them."""

OUTSIDE_REWARD = -0.1
"""Reward of leaving the workspace (the tutorial's)."""

TIMEOUT_REWARD = -0.1
"""Reward of running out of time (the tutorial's)."""

SUCCESS_REWARD = 1.0
"""Reward of reaching the target (the tutorial's)."""

LOWEST_TARGET = -0.05
"""Bottom of the observed box [m]: the settled target lies just below the workspace."""

Bounds = tuple[np.ndarray, np.ndarray]
ObservationBounds = tuple[Any, Any]
"""Lower and upper bounds of an observation, in its form."""


@dataclass(frozen=True)
class Reach:
    """The task on a robot; constants known while tracing.

    Attributes:
        config: the rules.
        robot: the arm.
        period: from one command to the next [s].
        lag: time by which each joint follows its command `[n]` [s].
    """

    config: TaskConfig
    robot: Robot
    period: float
    lag: tuple[float, ...]


class Situation(NamedTuple):
    """What observations and baselines may look at, in lanes.

    `q, target_q [B, n]` rad, `qd [B, n]` rad/s, `tool_position, target [B, 3]` m, `last_action [B, a]`; the camera's
    `picture [B, SIZE, SIZE]` uint8 where the observation holds one.
    """

    q: Array
    qd: Array
    tool_position: Array
    target: Array
    target_q: Array
    last_action: Array
    picture: Array | None = None


class Outcome(NamedTuple):
    """What a step led to, `[B]` each.

    Distances from tool to target in metres: before the step, after it, and held: the largest of the steps of which the
    task speaks, infinite where a joint moved. Speed is the fastest joint's [rad/s or m/s], effort the mean
    square of the action. Progress is what success pays for: 1 on the step on which it is reached and, where the
    episode goes on, -1 on the step on which it is lost.
    """

    distance_before: Array
    distance: Array
    held: Array
    speed: Array
    effort: Array
    outside: Array
    success: Array
    timeout: Array
    progress: Array


# --- targets and starts ---------------------------------------------------------------------------


def _table_corners(reach: Reach) -> Bounds:
    """The workspace's x and y, at the configured height."""
    low, high = np.array(reach.robot.workspace, np.float32)
    low[2] = high[2] = reach.config.target_height
    return low, high


def _box_corners(reach: Reach) -> Bounds:
    """The configured box."""
    return np.array(reach.config.target_low, np.float32), np.array(reach.config.target_high, np.float32)


TARGETS: dict[str, Callable[[Reach], Bounds]] = {"table": _table_corners, "box": _box_corners}
"""Boxes of targets by name: lower and upper corner `[3]` m."""


def draw_target(reach: Reach, key: Array) -> Array:
    """Target `[3]`, uniform in its box."""
    low, high = TARGETS[reach.config.targets](reach)
    wide = low < high
    drawn = jax.random.uniform(key, (int(wide.sum()),), minval=low[wide], maxval=high[wide])
    return jnp.array(low).at[np.flatnonzero(wide)].set(drawn)


def draw_start(reach: Reach, key: Array) -> Array:
    """Joint vector `[n]` in which an episode starts: the robot's home, and noise where the task has it."""
    chain, noise = reach.robot.chain, reach.config.start_noise
    home = jnp.array(reach.robot.home)
    if not noise:
        return home
    start = home + jax.random.uniform(key, home.shape, minval=-noise, maxval=noise)
    return jnp.clip(start, jnp.array(chain.lower), jnp.array(chain.upper))


# --- observations ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Observation:
    """An observation design: what it holds, its bounds `[k]` and the function that gives `[B, k]`.

    `pictured` says that the camera's picture is in it; such an observation may be a dict of arrays, as its bounds are.
    """

    summary: str
    bounds: Callable[[Reach], ObservationBounds]
    observe: Callable[[Reach, Situation], Observed]
    pictured: bool = False


def _target_bounds(reach: Reach) -> Bounds:
    if reach.config.targets == "box":
        return _box_corners(reach)
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


NEAR = 0.02
"""Distance at which the near form of the way to the target is half as long as a far one [m]."""


def _state(reach: Reach, now: Situation) -> Array:
    del reach
    way = now.target - now.tool_position
    near = way / (jnp.linalg.norm(way, axis=-1, keepdims=True) + NEAR)
    parts = (now.q, now.qd, now.target_q - now.q, now.tool_position, now.target, way, near, now.last_action)
    return jnp.concatenate(parts, axis=-1)


def _state_bounds(reach: Reach) -> Bounds:
    def within(size: np.ndarray | Sequence[float]) -> Bounds:
        size = np.asarray(size, np.float32)
        return -size, size

    chain, speed = reach.robot.chain, np.array(reach.robot.speed)
    lower, upper = np.array(chain.lower, np.float32), np.array(chain.upper, np.float32)
    tool, target = _tool_bounds(reach), _target_bounds(reach)
    way = np.maximum(np.abs(target[0] - tool[1]), np.abs(target[1] - tool[0]))
    # Joints swing past their limits for moments, and past their rated speeds when an arm is overloaded.
    swing, rush = within(np.full(chain.n, 0.1)), within(10 * speed)
    joints = (lower + swing[0], upper + swing[1])
    action = within(np.abs(ACTIONS[reach.config.action].bounds(reach)).max(axis=0))
    return _join(joints, rush, within(upper - lower), tool, target, within(way), within(np.ones(3)), action)


def _picture_bounds(reach: Reach) -> Bounds:
    del reach
    return np.zeros((SIZE, SIZE), np.uint8), np.full((SIZE, SIZE), 255, np.uint8)


def _picture(reach: Reach, now: Situation) -> Array:
    del reach
    assert now.picture is not None, "the environment hands the picture over"  # noqa: S101
    return now.picture


def _picture_and_tool_bounds(reach: Reach) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    pictures, tools = _picture_bounds(reach), _tool_bounds(reach)
    low, high = ({"image": pictures[i], "tool": tools[i]} for i in (0, 1))
    return low, high


OBSERVATIONS: dict[str, Observation] = {
    "target": Observation("the target's position [m]", _target_bounds, lambda _, now: now.target),
    "target+tool": Observation(
        "the target's and the tool's positions [m]",
        lambda reach: _join(_target_bounds(reach), _tool_bounds(reach)),
        lambda _, now: jnp.concatenate([now.target, now.tool_position], axis=-1),
    ),
    "state": Observation(
        "joints, their speeds and lag, tool, target, the way between them far and near, and the last action",
        _state_bounds,
        _state,
    ),
    "image": Observation("a camera's picture, 84 × 84 grey", _picture_bounds, _picture, pictured=True),
    "image+tool": Observation(
        "a camera's picture and the tool's position [m], as a dict",
        _picture_and_tool_bounds,
        lambda reach, now: {"image": _picture(reach, now), "tool": now.tool_position},
        pictured=True,
    ),
}
"""Observation designs by name."""


def pictured_situation(picture: Array, tool_position: Array) -> Situation:
    """Situation of which nothing is known but what an observation with a picture may hold."""
    unknown = jnp.full((), jnp.nan)
    return Situation(unknown, unknown, tool_position, unknown, unknown, unknown, picture)


def observe(reach: Reach, now: Situation) -> Observed:
    """Observation `[B, k]` of a situation."""
    return OBSERVATIONS[reach.config.observation].observe(reach, now)


# --- actions --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Action:
    """An action design.

    Attributes:
        summary: what it moves.
        bounds: its box, lower and upper bounds `[a]`.
        command: next joint command `[B, n]` in a situation for an action `[B, a]`; within the joint limits.
        towards: the action `[B, a]` with which inverse kinematics goes to the target, in a situation and in what it
            believes of that situation.
    """

    summary: str
    bounds: Callable[[Reach], Bounds]
    command: Callable[[Reach, Situation, Array], Array]
    towards: Callable[[Reach, Situation, Situation], Array]


def _tool_box(reach: Reach) -> Bounds:
    """The tutorial's box: x and y in ±0.4, z in -0.6 to 0.3."""
    del reach
    return np.array([-0.4, -0.4, -0.6], np.float32), np.array([0.4, 0.4, 0.3], np.float32)


def _move_tool(reach: Reach, now: Situation, action: Array) -> Array:
    """Joint command whose tool point is displaced by the action, the tool held in its orientation."""
    displacement = action * reach.config.tool_scale
    held = jnp.broadcast_to(jnp.array(reach.robot.held_quaternion), (*action.shape[:-1], 4))
    return ik_displace(reach.robot.chain, now.target_q, displacement, held)


def _tool_towards(reach: Reach, now: Situation, believed: Situation) -> Array:
    """Straight line to the target at the box's full speed."""
    del now
    wanted = (believed.target - believed.tool_position) / reach.config.tool_scale
    low, high = _tool_box(reach)
    excess = jnp.where(wanted > 0, wanted / high, wanted / low).max(axis=-1, keepdims=True)
    return wanted / jnp.maximum(excess, 1.0)


def _joint_box(reach: Reach) -> Bounds:
    ones = np.ones(reach.robot.chain.n, np.float32)
    return -ones, ones


def _move_joints(reach: Reach, now: Situation, action: Array) -> Array:
    """Joint command displaced by the action."""
    chain = reach.robot.chain
    return jnp.clip(now.target_q + action * reach.config.joint_scale, jnp.array(chain.lower), jnp.array(chain.upper))


NEAR_GAIN, FAR_GAIN = 0.5, 2.5
"""Shares of the way to the target that inverse kinematics command in a time of the servos' lag: at the target and from
`APPROACH` on. With more at the target an arm whose servos lag swings about it; far from it their lag is foreseen."""

APPROACH = 0.05
"""Distance from which on the gain falls to that at the target, and the lag is foreseen less and less [m]: it is found
from measured speeds, whose noise would be felt at the target."""

TOOL_SPEED = 1.5
"""Speed at which inverse kinematics send the tool at most [m/s]: with more, most joints are at their own limit, and the
arm jerks for little gain."""


def _joints_towards(reach: Reach, now: Situation, believed: Situation) -> Array:
    """Joint displacement that brings the tool to the target in whatever orientation, by resolved-rate control.

    Each step goes a share of the way (Whitney, "Resolved motion rate control of manipulators and human prostheses",
    IEEE Trans. Man-Machine Systems 10(2), 1969) from where the arm will be once it has caught up with its command.
    """
    del now
    chain, lag, period = reach.robot.chain, np.array(reach.lag), reach.period
    way = believed.target - believed.tool_position
    far = jnp.minimum(jnp.linalg.norm(way, axis=-1, keepdims=True) / APPROACH, 1.0)
    caught_up = believed.q + far * jnp.array(lag) * believed.qd
    way = believed.target - forward_kinematics(chain, caught_up).position
    share = jnp.minimum((NEAR_GAIN + far * (FAR_GAIN - NEAR_GAIN)) * period / max(lag.max(), TINY), 1.0)
    wanted = share * way
    wanted *= jnp.minimum(TOOL_SPEED * period / (jnp.linalg.norm(wanted, axis=-1, keepdims=True) + TINY), 1.0)
    step = ik_point_step(chain, caught_up, believed.target_q, wanted) / reach.config.joint_scale
    return jnp.clip(step, *_joint_box(reach))


CORRECTION, CORRECTION_FADE = 2.0, 0.02
"""Displacement that a correction of 1 adds, in those of inverse kinematics at most: enough to turn one round; and the
distance from which on corrections fade, to nothing at the target [m]: with its square, so that near the target the pull
of inverse kinematics, which is proportional to the distance, outweighs them."""


def _fade(now: Situation) -> Array:
    """What a correction of 1 is worth in a situation `[B, 1]`."""
    distance = jnp.linalg.norm(now.target - now.tool_position, axis=-1, keepdims=True)
    return CORRECTION * jnp.minimum(jnp.square(distance / CORRECTION_FADE), 1.0)


def _correct_joints(reach: Reach, now: Situation, action: Array) -> Array:
    """Joint command displaced by what inverse kinematics would do, and by the action, which fades at the target.

    Residual policy learning: Silver et al., arXiv:1812.06298; Johannink et al., arXiv:1812.03201.
    """
    corrected = _joints_towards(reach, now, now) + _fade(now) * action
    return _move_joints(reach, now, jnp.clip(corrected, *_joint_box(reach)))


def _correction_towards(reach: Reach, now: Situation, believed: Situation) -> Array:
    """Nothing, but where the situation is believed to be another."""
    correction = _joints_towards(reach, believed, believed) - _joints_towards(reach, now, now)
    return jnp.clip(correction / jnp.maximum(_fade(now), TINY), *_joint_box(reach))


TINY = 1e-6
"""Divides in place of a smaller number."""


ACTIONS: dict[str, Action] = {
    "tool_delta": Action("a displacement of the tool, its orientation held", _tool_box, _move_tool, _tool_towards),
    "joint_delta": Action("a displacement of every joint", _joint_box, _move_joints, _joints_towards),
    "joint_residual": Action(
        "a displacement of every joint, added to that of inverse kinematics and fading at the target",
        _joint_box,
        _correct_joints,
        _correction_towards,
    ),
}
"""Action designs by name."""


def bounded(reach: Reach, action: Array) -> Array:
    """The action `[B, a]` that is taken: clipped to its box, where the task clips."""
    return jnp.clip(action, *ACTIONS[reach.config.action].bounds(reach)) if reach.config.clip_actions else action


def command(reach: Reach, now: Situation, action: Array) -> Array:
    """Next joint command `[B, n]` in a situation, for a bounded action `[B, a]`."""
    return ACTIONS[reach.config.action].command(reach, now, action)


# --- rewards and end ------------------------------------------------------------------------------


def _sparse(config: TaskConfig, outcome: Outcome) -> dict[str, Array]:
    """1 for reaching the target, -0.1 for leaving the workspace or running out of time: the tutorial's.

    Where the episode goes on at the target, losing it costs 1 again: a difference of potentials, so that coming and
    going pays nothing (Ng, Harada and Russell, "Policy invariance under reward transformations", ICML 1999).
    """
    del config
    return {
        "reach": SUCCESS_REWARD * outcome.progress,
        "outside": OUTSIDE_REWARD * outcome.outside,
        "timeout": TIMEOUT_REWARD * (outcome.timeout & ~outcome.success),
    }


def _dense(config: TaskConfig, outcome: Outcome) -> dict[str, Array]:
    """As sparse, and for every metre that the tool comes closer."""
    approach = config.approach_weight * (outcome.distance_before - outcome.distance)
    return {**_sparse(config, outcome), "approach": approach}


def _precise(config: TaskConfig, outcome: Outcome) -> dict[str, Array]:
    """For coming closer, for being within millimetres, for being still there, and against effort."""
    close = config.closeness_scale / (config.closeness_scale + outcome.distance)
    still = config.hold_speed / (config.hold_speed + outcome.speed)
    return {
        "approach": config.approach_weight * (outcome.distance_before - outcome.distance),
        "closeness": config.closeness_weight * close,
        "stillness": config.closeness_weight * close * still,
        "effort": -config.effort_weight * outcome.effort,
    }


REWARDS: dict[str, Callable[[TaskConfig, Outcome], dict[str, Array]]] = {
    "sparse": _sparse,
    "dense": _dense,
    "precise": _precise,
}
"""Rewards by name; each gives named terms `[B]` whose sum is the reward."""


AT_GOAL = {
    "end": "success ends the episode",
    "continue": "the policy acts until the time limit; success is judged on the last step",
    "hold": "as continue, but the joint command stays while the tool is within the success distance",
}
"""What may happen at the target, by name."""


def held_error(distance: Array, recent: Array | None) -> Array:
    """The error that counts `[B]` [m]: the distance, or the largest recent one where the tool has to be held."""
    return distance if recent is None else recent.max(axis=-1)


def rests(reach: Reach, distance: Array) -> Array | None:
    """Whether the joint command stays as it is, for the tool is at the target `[B]`; None where no rule says so."""
    return distance < reach.config.success_distance if reach.config.at_goal == "hold" else None


def is_outside(reach: Reach, tool_position: Array) -> Array:
    """Whether the tool, at `[B, 3]` m, has left the workspace `[B]`."""
    low, high = (jnp.array(corner) for corner in reach.robot.workspace)
    return ((tool_position < low) | (tool_position > high)).any(axis=-1)


def judge(
    reach: Reach,
    distance_before: Array,
    recent: Array | None,
    now: Situation,
    clock: Array,
    held_before: Array | None = None,
) -> Outcome:
    """Outcome of a step, number `clock [B]` of its episode, that led to a situation.

    Args:
        reach: the task.
        distance_before: tool to target before the step `[B]` [m].
        recent: the errors of the last steps `[B, hold_steps]`, see `remember`; None if touching is enough.
        now: the situation.
        clock: number of the step.
        held_before: the error that counted before the step `[B]` [m]; by default `distance_before`.

    Leaving the workspace outranks success, and where success ends the episode it outranks a time-out on the same step.
    Where the tool has to be held, leaving the workspace is no end.
    """
    rules = reach.config
    distance = jnp.linalg.norm(now.tool_position - now.target, axis=-1)
    held = held_error(distance, recent)
    outside = jnp.zeros_like(distance, bool)
    if recent is None:
        outside = is_outside(reach, now.tool_position)
    success = ~outside & (held < rules.success_distance)
    timeout = ~outside & (clock >= rules.max_steps)
    if rules.at_goal == "end":
        timeout, progress = timeout & ~success, success.astype(distance.dtype)
    else:
        before = (distance_before if held_before is None else held_before) < rules.success_distance
        progress = success.astype(distance.dtype) - before
    speed, effort = jnp.abs(now.qd).max(axis=-1), jnp.square(now.last_action).mean(axis=-1)
    return Outcome(distance_before, distance, held, speed, effort, outside, success, timeout, progress)


def remember(reach: Reach, recent: Array | None, now: Situation) -> Array | None:
    """Errors of the last steps `[B, hold_steps]` [m], this one's included: infinite where a joint was not still."""
    if recent is None:
        return None
    distance = jnp.linalg.norm(now.tool_position - now.target, axis=-1)
    still = jnp.abs(now.qd).max(axis=-1) < reach.config.hold_speed
    return jnp.concatenate([recent[:, 1:], jnp.where(still, distance, jnp.inf)[:, None]], axis=1)


def nothing_held(reach: Reach, lanes: int) -> Array | None:
    """Errors `[B, hold_steps]` at the start of an episode."""
    return jnp.full((lanes, reach.config.hold_steps), jnp.inf) if reach.config.hold_steps else None


def make_reach(config: TaskConfig, robot: Robot, period: float, lag: tuple[float, ...]) -> Reach:
    """The task on a robot.

    Raises:
        InputError: an observation, action or reward that does not exist, or rules that do not fit together.
    """
    for kind, name, table in (
        ("observation", config.observation, OBSERVATIONS),
        ("action", config.action, ACTIONS),
        ("reward", config.reward, REWARDS),
        ("targets", config.targets, TARGETS),
        ("at_goal", config.at_goal, AT_GOAL),
    ):
        choose(kind, name, table)
    if config.at_goal == "hold" and config.hold_steps:
        raise InputError(
            f"at_goal 'hold' holds the arm at the target, and hold_steps {config.hold_steps} asks the policy to do so:"
            " set at_goal to 'continue', or hold_steps to 0."
        )
    return Reach(config, robot, period, lag)
