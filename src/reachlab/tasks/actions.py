"""Actions: displacements of the tool or of the joints, corrections of what a controller would do, and what it sees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control import CONTROLLERS
from reachlab.control.bodies import Bodies
from reachlab.control.dampers import damped, hemmed
from reachlab.control.evading import evaded
from reachlab.control.situation import Goal, Situation, up_to_date
from reachlab.robots.kinematics.forward import norm
from reachlab.robots.kinematics.inverse import ik_displace
from reachlab.settings.tables import Table
from reachlab.settings.validation import InputError
from reachlab.tasks.answers import answer
from reachlab.tasks.camera import in_picture, on_table
from reachlab.tasks.task import Bounds, TaskSetup

TINY = 1e-6
"""Divides in place of a smaller number."""

AHEAD = 0.3
"""Length of the way in joint space that a heading of length 1 stands for [rad]."""

SHORT = 0.05
"""Length up to which a heading is not taken for a longer one."""

ARRIVES, THERE = 0.3, 0.05
"""What is left of the way to the goal's joints where the task's controller takes over from headings that lead there
[rad], and from all: a policy that is 0.1 rad off comes no nearer than that by itself, and stands there."""

LEADS = 0.5
"""Cosine from which a heading leads to the goal's joints: where a board is before them it leads round."""

ENDS = 0.2
"""How far beside the goal's joints a heading may end that leads there too [rad]: where a policy is so far off, its
headings are short all about the place that it takes for the goal, and point away from the goal behind it."""

GiveWay = Callable[[TaskSetup, Situation, Array], Array]
"""Dampers: joint displacement `[B, n]` in place of the one that is asked for."""


@dataclass(frozen=True)
class Action:
    """An action design.

    Attributes:
        summary: what it moves.
        bounds: its box, lower and upper bounds `[a]`.
        command: next command `[B, m]` in a situation for an action `[B, a]`; within the joint limits.
        towards: the action `[B, a]` with which the task's controller acts, in a situation and in what it believes of
            that situation.
        gives: `turning`, where it can bring the tool into any orientation; `gripping`, where it moves the gripper.
        needs: what else there has to be, of `reachlab.tasks.WORDS`.
        whole: of a correction of what the controller does, the name of the action that corrects nothing.
        points: of an action that says where in the picture things are, how many.
        method: by which it is learnt, of `reachlab.learn.METHODS`; None: as the configuration says.
    """

    summary: str
    bounds: Callable[[TaskSetup], Bounds]
    command: Callable[[TaskSetup, Situation, Array], Array]
    towards: Callable[[TaskSetup, Situation, Situation], Array]
    gives: frozenset[str] = frozenset({"turning", "gripping"})
    needs: frozenset[str] = frozenset()
    whole: str | None = None
    points: int = 0
    method: str | None = None


def _tool_box(_setup: TaskSetup) -> Bounds:
    """The tutorial's box: x and y in ±0.4, z in -0.6 to 0.3."""
    return np.array([-0.4, -0.4, -0.6], np.float32), np.array([0.4, 0.4, 0.3], np.float32)


def _unit_box(_setup: TaskSetup) -> Bounds:
    return -np.ones(3, np.float32), np.ones(3, np.float32)


def _move_tool(setup: TaskSetup, now: Situation, action: Array) -> Array:
    """Joint command whose tool point is displaced by the action, the tool held in its orientation."""
    displacement = action * setup.rules.tool_scale
    held = jnp.broadcast_to(jnp.array(setup.robot.held_quaternion), (*action.shape[:-1], 4))
    return ik_displace(setup.robot.chain, now.command, displacement, held)


def _tool_towards(setup: TaskSetup, _now: Situation, believed: Situation) -> Array:
    """Straight line to the target at the box's full speed."""
    wanted = (believed.goal.position - believed.tool_position) / setup.rules.tool_scale
    low, high = ACTIONS[setup.rules.action].bounds(setup)
    excess = jnp.where(wanted > 0, wanted / high, wanted / low).max(axis=-1, keepdims=True)
    return wanted / jnp.maximum(excess, 1.0)


def _joint_box(setup: TaskSetup) -> Bounds:
    ones = np.ones(len(setup.robot.actuators), np.float32)
    return -ones, ones


def joint_scale(setup: TaskSetup) -> np.ndarray:
    """Displacement of each joint, and of the gripper, for an action of 1 `[m]` [rad or m]."""
    scale, full_speed = setup.rules.joint_scale, np.array(setup.robot.commands.speed, np.float32) * setup.period
    if scale is not None:
        full_speed[: setup.robot.chain.n] = scale
    return full_speed


def _move_joints(setup: TaskSetup, now: Situation, action: Array, give_way: GiveWay = damped) -> Array:
    """Joint command displaced by the action, as far as the task's dampers allow."""
    limits, step = setup.robot.commands, action * joint_scale(setup)
    if setup.task.control.dampers:
        give_way = evaded if setup.task.scene(setup).moved else give_way
        # Limits that contradict each other, as where a body is moved into the arm, may ask for anything.
        step = jnp.clip(give_way(setup, now, step), -joint_scale(setup), joint_scale(setup))
    return jnp.clip(now.command + step, jnp.array(limits.lower), jnp.array(limits.upper))


def _joints_towards(setup: TaskSetup, _now: Situation, believed: Situation) -> Array:
    """What the task's controller would do in the situation as it is believed."""
    step = _controlled(setup, setup.task.control.controller, believed)
    return jnp.clip(step / joint_scale(setup), *_joint_box(setup))


def _controlled(setup: TaskSetup, name: str, now: Situation) -> Array:
    """Joint displacement `[B, n]` by a controller of the table, from where the joints have come to."""
    entry: Any = CONTROLLERS[name]
    controller = entry.load() if hasattr(entry, "load") else entry  # a notebook may have entered the function itself
    step: Array = answer(f"controller {name!r}", controller, setup, up_to_date(setup, now))
    return step


def _residual_gain(setup: TaskSetup, now: Situation) -> Array:
    """By what a residual action is multiplied `[B, 1]`.

    It fades with the square of the distance, so that near the goal the controller's pull, which is proportional to the
    distance, outweighs it.
    """
    control, task = setup.task.control, setup.task
    if not control.fade:
        return jnp.full((len(now.q), 1), control.residual_gain)
    away = task.gap(setup.rules, task.errors(setup, now))
    return control.residual_gain * jnp.minimum(jnp.square(away[:, None] / control.fade), 1.0)


def _correct_joints(setup: TaskSetup, now: Situation, action: Array) -> Array:
    """Joint command displaced by what the task's controller would do, and by the residual action.

    Residual policy learning: Silver et al., arXiv:1812.06298; Johannink et al., arXiv:1812.03201.
    """
    corrected = _joints_towards(setup, now, now) + _residual_gain(setup, now) * action
    return _move_joints(setup, now, jnp.clip(corrected, *_joint_box(setup)))


def _correction_towards(setup: TaskSetup, now: Situation, believed: Situation) -> Array:
    """Nothing, but where the situation is believed to be another."""
    correction = _joints_towards(setup, believed, believed) - _joints_towards(setup, now, now)
    return jnp.clip(correction / jnp.maximum(_residual_gain(setup, now), TINY), *_joint_box(setup))


def _take_heading(setup: TaskSetup, now: Situation, action: Array) -> Array:
    """Joint command displaced along a heading, as fast as joints and their lag allow; at the goal by the controller.

    Its length is that of `AHEAD` unless it is very short: the mean of two ways is short, and has to be left.
    """
    speed, long = np.array(setup.robot.speed), norm(action)
    way = AHEAD * action / jnp.maximum(long[:, None], SHORT)
    time = jnp.maximum((jnp.abs(way) / speed).max(axis=-1, keepdims=True), max(*setup.lag, TINY))
    left = now.goal.joints - now.q
    distance = norm(left)
    leads = ((left * action).sum(axis=-1) > LEADS * distance * long) | (norm(left - AHEAD * action) < ENDS)
    far = (distance > jnp.where(leads, ARRIVES, THERE))[:, None]
    along = jnp.clip(setup.period * way / time / joint_scale(setup), *_joint_box(setup))
    return _move_joints(setup, now, jnp.where(far, along, _joints_towards(setup, now, now)), hemmed)


def _straight_heading(_setup: TaskSetup, _now: Situation, believed: Situation) -> Array:
    """That to the goal's joints."""
    way = believed.goal.joints - believed.q
    return way / jnp.maximum(norm(way)[:, None], AHEAD)


def _picture_box(_setup: TaskSetup) -> Bounds:
    return -np.ones(4, np.float32), np.ones(4, np.float32)


def _at_points(setup: TaskSetup, now: Situation, action: Array) -> Array:
    """Joint command of the task's controller, where goal and object lie on the table as the action says."""
    step = _controlled(setup, setup.task.control.seen, _seen(setup, now, action))
    return _move_joints(setup, now, jnp.clip(step / joint_scale(setup), *_joint_box(setup)))


def _seen(setup: TaskSetup, now: Situation, action: Array) -> Situation:
    """The situation with nothing but an object of the usual size, and it and the goal where the picture shows them."""
    scene, count = setup.task.scene(setup), len(action)
    goal, place = (on_table(setup.robot, action[:, part]) for part in (np.s_[:2], np.s_[2:]))
    bodies = Bodies(
        position=place[:, None],
        quaternion=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (count, 1, 1)),
        velocity=jnp.zeros((count, 1, 6)),
        size=jnp.tile(jnp.array(scene.size), (count, 1, 1)),
        kind=jnp.full((count, 1), scene.shape, jnp.int32),
    )
    up = bodies.extent[..., 2:] * np.array([0.0, 0.0, 1.0], np.float32)
    return now._replace(goal=Goal.at(goal + up[:, 0]), bodies=replace(bodies, position=bodies.position + up))


def _points_towards(setup: TaskSetup, _now: Situation, believed: Situation) -> Array:
    """Where the goal and the foot of the object are believed to be in the picture."""
    table = np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, setup.robot.table_top])
    places = believed.goal.position, believed.bodies.position[:, -1]
    return jnp.concatenate([in_picture(setup.robot, place * table[0] + table[1]) for place in places], axis=-1)


ACTIONS: dict[str, Action] = Table(
    {
        "tool_delta": Action(
            "a displacement of the tool, its orientation held", _tool_box, _move_tool, _tool_towards, gives=frozenset()
        ),
        "tool_step": Action(
            "the same in a box of -1 to 1 in each direction", _unit_box, _move_tool, _tool_towards, gives=frozenset()
        ),
        "joint_delta": Action("a displacement of every joint", _joint_box, _move_joints, _joints_towards),
        "joint_residual": Action(
            "a displacement of every joint, added to that of the task's controller and fading at the goal",
            _joint_box,
            _correct_joints,
            _correction_towards,
            needs=frozenset({"places"}),
            whole="joint_delta",
        ),
        "heading": Action(
            "a direction of the joints, which they take as fast as they can; at the goal the task's controller acts",
            _joint_box,
            _take_heading,
            _straight_heading,
            gives=frozenset({"turning"}),
            needs=frozenset({"joints", "bodies"}),
            method="imitation",
        ),
        "picture_points": Action(
            "where in the camera's picture goal and object are, on which the task's controller acts",
            _picture_box,
            _at_points,
            _points_towards,
            needs=frozenset({"flat", "picture"}),
            points=2,
        ),
    }
)
"""Action designs by name."""


def bounded(setup: TaskSetup, action: Array) -> Array:
    """The action `[B, a]` that is taken: clipped to its box, where the task clips."""
    return jnp.clip(action, *ACTIONS[setup.rules.action].bounds(setup)) if setup.rules.clip_actions else action


def command(setup: TaskSetup, now: Situation, action: Array) -> Array:
    """Next command `[B, m]` in a situation, for a bounded action `[B, a]`.

    Raises:
        InputError: an action that was added fails, or gives something else.
    """
    who = f"action {setup.rules.action!r}"
    given = answer(who, ACTIONS[setup.rules.action].command, setup, now, action)
    if jnp.shape(given) != now.command.shape:
        raise InputError(
            f"{who} gives a command in shape {jnp.shape(given)}: one number an actuator is needed, with the"
            f" environments in front, {now.command.shape}."
        )
    return given
