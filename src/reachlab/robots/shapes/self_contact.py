"""Whether an arm touches itself, by MuJoCo's own collision of the shapes in its file; meshes are their convex hulls."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from reachlab.robots.derive.arm import Arm
from reachlab.robots.derive.isolation import apply
from reachlab.robots.files.model_file import ModelFile
from reachlab.robots.kinematics.chain import Chain
from reachlab.robots.robot import Robot
from reachlab.robots.shapes.clearance import APART
from reachlab.robots.shapes.solids import links_of_bodies, solid_geoms

RANDOM_POSES = 30
"""Random joint vectors that show which parts of an arm overlap by design."""

ALWAYS = 0.5
"""Parts that touch in so large a share of them do."""

DEPTH = 2e-3
"""Parts of an arm whose home is looked for do not touch if they overlap by less [m]."""

Pairs = set[tuple[int, int]]
"""Pairs of bodies."""


def untouching(file: ModelFile, arm: Arm) -> Callable[[np.ndarray], bool]:
    """Function that tells whether the arm does not touch itself at a joint vector `[n]`, as its file lets collide."""
    spec = file.spec()
    apply(spec, arm.isolation)
    touching = _touching(_colliding(spec), arm.chain, DEPTH)
    return lambda q: not touching(q)


def meeting(robot: Robot) -> Callable[[np.ndarray], bool]:
    """Function that tells whether links of the arm meet at a joint vector `[n]`, by what is solid of them.

    Links that a joint connects do not count, nor what overlaps by design or at home. Where a mesh is flat and has no
    hull the answer is always yes: then the capsules alone judge.
    """
    spec = robot.locked.spec()
    model = spec.compile()
    solid = {geom for geoms in solid_geoms(model, robot.chain.n) for geom in geoms}
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = int(geom.id in solid)
    try:
        model = _colliding(spec)
    except ValueError:
        return lambda _: True
    links, touching = links_of_bodies(model), _touching(model, robot.chain, 0.0)
    at_home = touching(np.array(robot.home))
    return lambda q: any(abs(links[a] - links[b]) >= APART for a, b in touching(q) - at_home)


def _colliding(spec: mujoco.MjSpec) -> mujoco.MjModel:
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return spec.compile()


def _touching(model: mujoco.MjModel, chain: Chain, depth: float) -> Callable[[np.ndarray], Pairs]:
    """Function that gives the bodies that overlap by more than a depth [m] at a joint vector `[n]`, but by design."""
    data = mujoco.MjData(model)

    def touching(q: np.ndarray) -> Pairs:
        data.qpos[model.jnt_qposadr] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        contacts = data.contact
        bodies = model.geom_bodyid[contacts.geom[contacts.dist < -depth]]
        return {(min(pair), max(pair)) for pair in bodies.tolist()}

    random = np.random.default_rng(0).uniform(np.array(chain.lower), np.array(chain.upper), (RANDOM_POSES, chain.n))
    seen = [pair for q in random for pair in touching(q)]
    always = {pair for pair in set(seen) if seen.count(pair) >= ALWAYS * RANDOM_POSES}
    return lambda q: touching(q) - always
