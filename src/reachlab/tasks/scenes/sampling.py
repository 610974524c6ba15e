"""An episode among bodies: drawn as it begins, or one of those that were drawn before."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from reachlab.control.bodies import Bodies
from reachlab.control.evading import after
from reachlab.control.situation import Goal
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.tasks.scenes import balls, bank, moving
from reachlab.tasks.scenes.kinds import BOX, KINDS, kind_of
from reachlab.tasks.targets import box_corners
from reachlab.tasks.task import Bounds, Keys, Sampled, Scene, TaskSetup, sample_apart


def drawn_anew(scene: tuple[str, ...]) -> bool:
    """Whether a scene is drawn as its episode begins."""
    return scene in ((balls.NAME,), (moving.NAME,))


def room(setup: TaskSetup) -> int:
    """Bodies for which scenes have room."""
    scene = setup.rules.scene
    return balls.places(setup) if drawn_anew(scene) else max(kind_of(name, setup.robot).bodies for name in scene)


def scene(setup: TaskSetup) -> Scene:
    """What may be beside the arm."""
    if setup.rules.scene == (moving.NAME,):
        return Scene(moved=moving.MOST, contacts=True)
    return Scene(fixed=room(setup), contacts=True)


def sample_bodies(setup: TaskSetup, key: Array, start: Array, goal: Goal) -> Bodies:
    """What is beside the arm in an episode whose scene is drawn as it begins."""
    draw = moving.sample_scene if setup.rules.scene == (moving.NAME,) else balls.sample_scene
    return draw(setup, key, start, goal)


def move(setup: TaskSetup, goal: Goal, bodies: Bodies, _clock: Array) -> tuple[Goal, Bodies]:
    """The goal as it is, and bodies a control period later."""
    return goal, after(bodies, setup.period) if scene(setup).moved else bodies


def goal_box(setup: TaskSetup) -> Bounds:
    """Corners `[3]` m of the box that holds all goals."""
    if not set(setup.rules.scene) <= KINDS.keys():
        return box_corners(setup)
    low, high = np.sort(kind_of(setup.rules.scene[0], setup.robot).place(BOX), axis=0).astype(np.float32)
    return low, high


def prepare(setup: TaskSetup) -> bank.Bank | None:
    """The scenes of the rules' kinds, each kind's in turn."""
    if drawn_anew(setup.rules.scene):
        return None
    count, banks = room(setup), [bank.bank_of(setup.robot, name) for name in setup.rules.scene]
    return jax.tree.map(lambda *x: np.stack(x, axis=1), *[one.with_room(count) for one in banks])


def sample(setup: TaskSetup, keys: Keys, goal: Goal | None, held_out: Array | bool) -> Sampled:
    """Start, goal and bodies of an episode; of a `goal` that is given the others are as likely as without."""
    if drawn_anew(setup.rules.scene):
        return sample_apart(setup, keys, goal, held_out)
    one = _one(setup, keys.goal, held_out)
    return Sampled(one.start, _goal(setup, one) if goal is None else goal, one.bodies)


def sample_goal(setup: TaskSetup, key: Array) -> Goal:
    """A goal of those scenes."""
    if drawn_anew(setup.rules.scene):
        return balls.sample_free_goal(setup, key)
    return _goal(setup, _one(setup, key, False))


def _one(setup: TaskSetup, key: Array, held_out: Array | bool) -> Any:
    """One of the scenes to train in, or of those that are held out."""
    count, kinds = setup.prepared.start.shape[:2]
    for_kind, for_number = jax.random.split(key)
    first, last = jnp.where(held_out, bank.TRAINING, 0), jnp.where(held_out, count, bank.TRAINING)
    number, kind = jax.random.randint(for_number, (), first, last), jax.random.randint(for_kind, (), 0, kinds)
    return jax.tree.map(lambda rows: jnp.asarray(rows)[number, kind], setup.prepared)


def _goal(setup: TaskSetup, one: Any) -> Goal:
    return balls.goal_of(setup, forward_kinematics(setup.robot.chain, one.joints), one.joints)
