"""Reaching a point or a pose: touching it, as the tutorial asks, or holding the tool there."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.robots.kinematics import Pose, added
from reachlab.settings.rules import Rules
from reachlab.settings.validation import InputError
from reachlab.tasks.targets import TARGETS
from reachlab.tasks.task import Bounds, Goal, Outcome, Progress, Situation, Task, TaskSetup, gap, outside_workspace

AT_GOAL = {
    "end": "success ends the episode",
    "continue": "the policy acts until the time limit; success is judged on the last step",
    "hold": "as continue, but the joint command stays while the tool is within the success distance",
}
"""What may happen at the goal, by name."""


# --- goals and starts -----------------------------------------------------------------------------


def _goal_box(setup: TaskSetup) -> Bounds:
    return TARGETS[setup.rules.targets].corners(setup)


def _sample_goal(setup: TaskSetup, key: Array) -> Goal:
    return TARGETS[setup.rules.targets].sample(setup, key)


def _sample_start(setup: TaskSetup, key: Array) -> Array:
    """The robot's home `[n]`, and noise where the rules say so."""
    chain, noise = setup.robot.chain, setup.rules.start_noise
    home = jnp.array(setup.robot.home)
    if not noise:
        return home
    start = home + jax.random.uniform(key, home.shape, minval=-noise, maxval=noise)
    return jnp.clip(start, jnp.array(chain.lower), jnp.array(chain.upper))


# --- success and the end --------------------------------------------------------------------------


def _begin(setup: TaskSetup, goal: Goal, tool: Pose) -> Progress:
    """Nothing is held yet."""
    distance, angle = goal.distance(tool.position), goal.angle(tool.quaternion)
    if not (steps := setup.rules.hold_steps):
        return Progress(distance, angle)
    nothing = jnp.zeros((len(distance), steps))
    return Progress(distance, angle, nothing, None if angle is None else nothing, nothing.astype(bool))


def _remember(setup: TaskSetup, before: Progress, now: Situation) -> Progress:
    """The errors of the last steps, this one's included."""
    distance, angle = now.goal.distance(now.tool_position), now.goal.angle(now.tool_quaternion)
    if before.recent is None or before.still is None:
        return Progress(distance, angle)

    def pushed(recent: Array | None, latest: Array | None) -> Array | None:
        if recent is None or latest is None:
            return None
        return jnp.concatenate([recent[:, 1:], latest[:, None]], axis=1)

    still = jnp.abs(now.qd).max(axis=-1) < setup.rules.hold_speed
    held = pushed(before.recent, distance), pushed(before.recent_angle, angle), pushed(before.still, still)
    return Progress(distance, angle, *held)


def _judge(setup: TaskSetup, before: Progress, now: Situation, clock: Array) -> Outcome:
    return outcome(setup, before, _remember(setup, before, now), now, clock)


def outcome(setup: TaskSetup, before: Progress, after: Progress, now: Situation, clock: Array) -> Outcome:
    """What a step led to, of what is remembered before and after it; see `Task.judge`.

    Leaving the workspace outranks success, and where success ends the episode it outranks a time-out on the same step.
    Where the goal has to be held, leaving the workspace does not end the episode.
    """
    rules = setup.rules
    outside = jnp.zeros_like(after.distance, bool)
    if rules.ends_outside:
        outside = outside_workspace(setup.robot, now.tool_position)
    if rules.end_on_contact and now.contact is not None:
        outside |= now.contact
    success = ~outside & after.solved(rules)
    timeout = ~outside & (clock >= rules.max_steps)
    gained, terminated = success.astype(after.distance.dtype), outside
    if rules.at_goal == "end":
        timeout, terminated = timeout & ~success, outside | success
    else:
        gained = gained - before.solved(rules)
    speed = jnp.abs(now.qd).max(axis=-1)
    effort = added(jnp.square(now.last_action)) / now.last_action.shape[-1]
    return Outcome(
        gap_before=gap(rules, before.distance, before.angle),
        gap=gap(rules, after.distance, after.angle),
        progress=after,
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
    return progress.near(setup.rules) if setup.rules.at_goal == "hold" else None


def _check(setup: TaskSetup) -> None:
    for axis, low, high in zip("xyz", *_goal_box(setup), strict=True):
        if low > high:
            raise InputError(f"target_low is above target_high in {axis}, {low:g} against {high:g} m: exchange them.")


# --- words ----------------------------------------------------------------------------------------


def _asks(rules: Rules, period: float) -> str:
    steps = f"{rules.max_steps:,} steps ({rules.max_steps * period:.2g} s)"
    box = f"the box from {rules.target_low} to {rules.target_high} m" if rules.target_low else "the arm's box"
    where = f"in {box}" if rules.targets == "box" else TARGETS[rules.targets].summary
    what = "a pose" if rules.asks_orientation else "a point"
    if not rules.hold_steps:
        return f"touch {what} {where}: the tool comes {_near(rules)} of it, in at most {steps}"
    return f"hold {what} {where}: {_held(rules, period)}; an episode has {steps}"


def _succeeds(rules: Rules, period: float) -> str:
    if rules.hold_steps:
        held = _held(rules, period)
        return f"{held}, which ends the episode" if rules.at_goal == "end" else f"at the end {held}"
    near = f"{_near(rules)} of the target"
    return (
        f"the tool comes {near}, which ends the episode" if rules.at_goal == "end" else f"at the end the tool is {near}"
    )


def _near(rules: Rules) -> str:
    turned = f" and {rules.success_angle:.4g} rad" if rules.asks_orientation else ""
    return f"within {1000 * rules.success_distance:.4g} mm{turned}"


def _held(rules: Rules, period: float) -> str:
    return (
        f"the tool has been {_near(rules)} for {rules.hold_steps} steps"
        f" ({rules.hold_steps * period:.2g} s), no joint faster than {rules.hold_speed:g} rad/s"
    )


def _reach(tool: str) -> Task:
    """Reaching with one of a robot's tool frames; whether touching is enough is said by the rules."""
    return Task(
        tool=tool,
        goal_box=_goal_box,
        sample_goal=_sample_goal,
        sample_obstacles=None,
        move=None,
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

POSE = PRECISE
"""The flange is held in a pose; the rules say in which."""
