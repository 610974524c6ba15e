"""Home and boxes of an arm that nobody states, derived once and kept in the user's cache."""

from __future__ import annotations

import logging
from collections.abc import Callable

import mujoco
import numpy as np

from reachlab.robots.arm import Arm
from reachlab.robots.cache import kept
from reachlab.robots.isolation import apply
from reachlab.robots.model_file import ModelFile
from reachlab.robots.workspace import Derived, derive

logger = logging.getLogger(__name__)

VERSION = 8
"""Of the derivation: what an older one left in the cache is derived again."""

RANDOM_POSES = 30
"""Random joint vectors that show which parts of an arm overlap by design."""

ALWAYS = 0.5
"""Parts that touch in so large a share of them do."""

DEPTH = 2e-3
"""Parts that overlap by less do not touch [m]."""


def derived(file: ModelFile, arm: Arm, speed: tuple[float, ...]) -> Derived:
    """Home and boxes of an arm; from the cache if they were derived before."""
    asked = (VERSION, file.digest, arm.tool, arm.isolation.joints, arm.chain, arm.home, speed)

    def find() -> Derived:
        logger.warning("reachlab: finding home and workspace of %s: a few seconds, once.", file.file.name)
        return derive(arm.chain, np.array(speed), arm.base, arm.home, untouching(file, arm))

    return kept("robots", asked, find, Derived, Derived._asdict)


def untouching(file: ModelFile, arm: Arm) -> Callable[[np.ndarray], bool]:
    """Function that tells whether the arm does not touch itself at a joint vector `[n]`, by its file's shapes."""
    spec = file.spec()
    apply(spec, arm.isolation)
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model = spec.compile()
    data = mujoco.MjData(model)
    order = model.jnt_qposadr

    def touching(q: np.ndarray) -> set[tuple[int, int]]:
        data.qpos[order] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        contacts = data.contact
        bodies = model.geom_bodyid[contacts.geom[contacts.dist < -DEPTH]]
        return {(min(pair), max(pair)) for pair in bodies.tolist()}

    lower, upper = np.array(arm.chain.lower), np.array(arm.chain.upper)
    random = np.random.default_rng(0).uniform(lower, upper, (RANDOM_POSES, arm.chain.n))
    seen = [pair for q in random for pair in touching(q)]
    always = {pair for pair in set(seen) if seen.count(pair) >= ALWAYS * RANDOM_POSES}
    return lambda q: touching(q) <= always
