"""Which links of an arm touch, by MuJoCo's own contacts of what is drawn of them."""

from __future__ import annotations

import mujoco
import numpy as np

from reachlab.robots.robot import Robot


def link_of(model: mujoco.MjModel, body: int) -> int:
    """Number of the link that a body is part of: of the last joint on the way to it."""
    while body and not model.body_jntnum[body]:
        body = model.body_parentid[body]
    return int(model.body_jntadr[body] + model.body_jntnum[body]) if body else 0


def contacts(robot: Robot, q: np.ndarray) -> list[set[tuple[int, int]]]:
    """Pairs of links that MuJoCo finds to touch, by what is drawn of them, at each of `q [B, n]`."""
    spec = robot.spec()
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for geom in spec.geoms:
        drawn = geom.contype == geom.conaffinity == 0
        geom.contype = geom.conaffinity = int(drawn)
    model = spec.compile()
    data, found = mujoco.MjData(model), []
    for one in q:
        data.qpos[:] = one
        mujoco.mj_forward(model, data)
        bodies = model.geom_bodyid[data.contact.geom[data.contact.dist < 0]]
        found.append({tuple(sorted(link_of(model, body) for body in pair)) for pair in bodies})
    return found
