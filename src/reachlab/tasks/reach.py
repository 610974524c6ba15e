"""What tasks of reaching share: starts, errors, what is held, and words."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from reachlab.control.situation import Goal, Situation
from reachlab.robots.kinematics.forward import angle_between
from reachlab.settings.validation import InputError
from reachlab.tasks.targets import TARGETS
from reachlab.tasks.task import Bounds, Errors, TaskSetup, within_distance

# --- goals and starts -----------------------------------------------------------------------------


def goal_box(setup: TaskSetup) -> Bounds:
    """Corners `[3]` m of the box that holds all goals."""
    return TARGETS[setup.rules.targets].corners(setup)


def sample_goal(setup: TaskSetup, key: Array) -> Goal:
    """A goal where the settings have them."""
    return TARGETS[setup.rules.targets].sample(setup, key)


def sample_start(setup: TaskSetup, key: Array) -> Array:
    """The robot's home `[n]`, and noise where the rules say so."""
    chain, home = setup.robot.chain, jnp.array(setup.robot.home)
    if not setup.rules.start_noise:
        return home
    noise = chain.noise(setup.rules.start_noise)
    start = home + jax.random.uniform(key, home.shape, minval=-noise, maxval=noise)
    return jnp.clip(start, jnp.array(chain.lower), jnp.array(chain.upper))


# --- success --------------------------------------------------------------------------------------


def pose_errors(_setup: TaskSetup, now: Situation) -> Errors:
    """Errors of a tool that is asked for in a pose."""
    return Errors(now.goal.distance(now.tool_position), angle_between(now.tool_quaternion, now.goal.quaternion))


def pose_gap(rules: Any, errors: Errors) -> Any:
    """Distance and angle as one number `[...]` [m]."""
    return errors.distance + rules.angle_weight * errors.angle


def near_pose(rules: Any, errors: Errors) -> Any:
    """Whether both errors are those of a success `[...]`."""
    return within_distance(rules, errors) & (errors.angle < rules.success_angle)


class Held(NamedTuple):
    """The last steps of an episode `[B, hold_steps]`: the errors after them, and whether every joint was slow."""

    errors: Errors
    still: Array


def begin(setup: TaskSetup, errors: Errors) -> Held | tuple[()]:
    """Nothing is held yet; nothing is remembered where touching the goal is enough."""
    if not setup.rules.holds:
        return ()
    steps = setup.rules.hold_steps
    recent = (jnp.zeros((len(error), steps, *error.shape[1:])) for error in errors)
    return Held(Errors(*recent), jnp.zeros((len(errors.distance), steps), bool))


def update(setup: TaskSetup, before: Held, errors: Errors, now: Situation, _clock: Array) -> Held | tuple[()]:
    """The last steps, this one included."""
    if not setup.rules.holds:
        return ()
    still = jnp.abs(now.qd).max(axis=-1) < setup.rules.hold_speed
    return jax.tree.map(
        lambda recent, latest: jnp.concatenate([recent[:, 1:], latest[:, None]], axis=1), before, Held(errors, still)
    )


def counted(errors: Errors, held: Held | tuple[()]) -> Errors:
    """Where the goal has to be held the largest errors after the last steps, infinite if a joint was not still."""
    if not held:
        return errors

    def worst(recent: Array) -> Array:
        still = held.still.reshape(held.still.shape + (1,) * (recent.ndim - 2))
        return jnp.where(still, recent, jnp.inf).max(axis=1)

    return Errors(*map(worst, held.errors))


def check(setup: TaskSetup) -> None:
    """Make sure that the box of goals is one.

    Raises:
        InputError: it is not.
    """
    for axis, low, high in zip("xyz", *goal_box(setup), strict=True):
        if low > high:
            raise InputError(f"target_low is above target_high in {axis}, {low:g} against {high:g} m: exchange them.")


# --- words ----------------------------------------------------------------------------------------


def asks(rules: Any, period: float) -> str:
    """What is asked for, in words."""
    steps = f"{rules.max_steps:,} steps ({rules.max_steps * period:.2g} s)"
    box = f"the box from {rules.target_low} to {rules.target_high} m" if rules.target_low else "the arm's box"
    where = f"in {box}" if rules.targets == "box" else TARGETS[rules.targets].summary
    what = "a pose" if rules.asks_orientation else "a point"
    if not rules.holds:
        return f"touch {what} {where}: the tool comes {_near(rules)} of it, in at most {steps}"
    return f"hold {what} {where}: {_held(rules, period)}; an episode has {steps}"


def succeeds(rules: Any, period: float) -> str:
    """What an episode has to come to, in words."""
    if rules.holds:
        held = _held(rules, period)
        return f"{held}, which ends the episode" if rules.at_goal == "end" else f"at the end {held}"
    near = f"{_near(rules)} of the target"
    return (
        f"the tool comes {near}, which ends the episode" if rules.at_goal == "end" else f"at the end the tool is {near}"
    )


def _near(rules: Any) -> str:
    turned = f" and {rules.success_angle:.4g} rad" if rules.asks_orientation else ""
    return f"within {1000 * rules.success_distance:.4g} mm{turned}"


def _held(rules: Any, period: float) -> str:
    return (
        f"the tool has been {_near(rules)} for {rules.hold_steps} steps"
        f" ({rules.hold_steps * period:.2g} s), no joint faster than {rules.hold_speed:g} rad/s"
    )
