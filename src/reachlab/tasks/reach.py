"""Reaching a point: touching it, as the tutorial asks, or holding the tool there."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.settings.config import Rules
from reachlab.settings.validation import InputError
from reachlab.tasks.task import Bounds, Goal, Outcome, Progress, Situation, Task, TaskSetup, outside_workspace

AT_GOAL = {
    "end": "success ends the episode",
    "continue": "the policy acts until the time limit; success is judged on the last step",
    "hold": "as continue, but the joint command stays while the tool is within the success distance",
}
"""What may happen at the goal, by name."""


# --- goals and starts -----------------------------------------------------------------------------


def _table_corners(setup: TaskSetup) -> Bounds:
    """The workspace's x and y, at the configured height."""
    low, high = np.array(setup.robot.workspace, np.float32)
    low[2] = high[2] = setup.rules.target_height
    return low, high


def _box_corners(setup: TaskSetup) -> Bounds:
    """The configured box, by default the robot's."""
    given = (setup.rules.target_low, setup.rules.target_high)
    low, high = (own if one is None else one for one, own in zip(given, setup.robot.goal_box, strict=True))
    return np.array(low, np.float32), np.array(high, np.float32)


TARGETS: dict[str, Callable[[TaskSetup], Bounds]] = {"table": _table_corners, "box": _box_corners}
"""Where goals are sampled, by name: lower and upper corner `[3]` m."""


def _goal_box(setup: TaskSetup) -> Bounds:
    return TARGETS[setup.rules.targets](setup)


def _sample_goal(setup: TaskSetup, key: Array) -> Goal:
    """Point `[3]`, uniform in the box."""
    low, high = _goal_box(setup)
    wide = low < high
    sampled = jax.random.uniform(key, (int(wide.sum()),), minval=low[wide], maxval=high[wide])
    return Goal(jnp.array(low).at[np.flatnonzero(wide)].set(sampled))


def _sample_start(setup: TaskSetup, key: Array) -> Array:
    """The robot's home `[n]`, and noise where the rules say so."""
    chain, noise = setup.robot.chain, setup.rules.start_noise
    home = jnp.array(setup.robot.home)
    if not noise:
        return home
    start = home + jax.random.uniform(key, home.shape, minval=-noise, maxval=noise)
    return jnp.clip(start, jnp.array(chain.lower), jnp.array(chain.upper))


# --- success and the end --------------------------------------------------------------------------


def _begin(setup: TaskSetup, distance: Array) -> Progress:
    """Nothing is held yet."""
    if not (steps := setup.rules.hold_steps):
        return Progress(distance)
    return Progress(distance, jnp.zeros((len(distance), steps)), jnp.zeros((len(distance), steps), bool))


def _remember(setup: TaskSetup, before: Progress, now: Situation) -> Progress:
    """The distances of the last steps, this one's included."""
    distance = now.goal.distance(now.tool_position)
    if before.recent is None or before.still is None:
        return Progress(distance)
    still = jnp.abs(now.qd).max(axis=-1) < setup.rules.hold_speed
    return Progress(
        distance,
        jnp.concatenate([before.recent[:, 1:], distance[:, None]], axis=1),
        jnp.concatenate([before.still[:, 1:], still[:, None]], axis=1),
    )


def _judge(setup: TaskSetup, before: Progress, now: Situation, clock: Array) -> tuple[Progress, Outcome]:
    """See `Task.judge`.

    Leaving the workspace outranks success, and where success ends the episode it outranks a time-out on the same step.
    Where the goal has to be held, leaving the workspace does not end the episode.
    """
    rules, after = setup.rules, _remember(setup, before, now)
    distance, error = after.distance, after.error
    outside = jnp.zeros_like(distance, bool)
    if rules.ends_outside:
        outside = outside_workspace(setup.robot, now.tool_position)
    success = ~outside & (error < rules.success_distance)
    timeout = ~outside & (clock >= rules.max_steps)
    gained, terminated = success.astype(distance.dtype), outside
    if rules.at_goal == "end":
        timeout, terminated = timeout & ~success, outside | success
    else:
        gained = gained - (before.error < rules.success_distance)
    speed, effort = jnp.abs(now.qd).max(axis=-1), jnp.square(now.last_action).mean(axis=-1)
    return after, Outcome(
        distance_before=before.distance,
        distance=distance,
        error=error,
        speed=speed,
        effort=effort,
        outside=outside,
        success=success,
        timeout=timeout,
        gained=gained,
        terminated=terminated,
    )


def _rests(setup: TaskSetup, progress: Progress) -> Array | None:
    """At the goal, where the rules say that the arm rests there."""
    return progress.distance < setup.rules.success_distance if setup.rules.at_goal == "hold" else None


def _check(setup: TaskSetup) -> None:
    for axis, low, high in zip("xyz", *_goal_box(setup), strict=True):
        if low > high:
            raise InputError(f"target_low is above target_high in {axis}, {low:g} against {high:g} m: exchange them.")


# --- words ----------------------------------------------------------------------------------------


def _asks(rules: Rules, period: float) -> str:
    steps = f"{rules.max_steps:,} steps ({rules.max_steps * period:.2g} s)"
    box = f"the box from {rules.target_low} to {rules.target_high} m" if rules.target_low else "the arm's box"
    where = f"in {box}" if rules.targets == "box" else f"on the {rules.targets}"
    if not rules.hold_steps:
        near = f"{1000 * rules.success_distance:.4g} mm"
        return f"touch a point {where}: the tool comes within {near} of it, in at most {steps}"
    return f"hold a point {where}: {_held(rules, period)}; an episode has {steps}"


def _succeeds(rules: Rules, period: float) -> str:
    if rules.hold_steps:
        return f"at the end {_held(rules, period)}"
    near = f"within {1000 * rules.success_distance:.4g} mm of the target"
    return (
        f"the tool comes {near}, which ends the episode" if rules.at_goal == "end" else f"at the end the tool is {near}"
    )


def _held(rules: Rules, period: float) -> str:
    return (
        f"the tool has been within {1000 * rules.success_distance:.4g} mm for {rules.hold_steps} steps"
        f" ({rules.hold_steps * period:.2g} s), no joint faster than {rules.hold_speed:g} rad/s"
    )


def _reach(tool: str) -> Task:
    """Reaching with one of a robot's tool frames; whether touching is enough is said by the rules."""
    return Task(
        tool=tool,
        goal_box=_goal_box,
        sample_goal=_sample_goal,
        sample_start=_sample_start,
        begin=_begin,
        judge=_judge,
        rests=_rests,
        check=_check,
        asks=_asks,
        succeeds=_succeeds,
    )


TUTORIAL = _reach(tool="wrist")
"""The tutorial's task: the last link's frame touches a point on the table."""

PRECISE = _reach(tool="flange")
"""The flange is held at a point in the air."""
