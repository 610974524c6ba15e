"""What an arm can touch in MuJoCo: itself, the table and bodies that differ between simulations."""

from __future__ import annotations

import functools
import logging
from collections.abc import Sequence
from typing import Any

import jax
import mujoco
import numpy as np
from mujoco.batch import Batch

from reachlab.control.bodies import Bodies
from reachlab.control.planning.arm import Arm
from reachlab.control.planning.collision import BODY, Geoms, add_capsule, add_surroundings, geoms_of
from reachlab.control.planning.following import SHORTEST
from reachlab.robots.files.model_file import IN_MILLIMETRES
from reachlab.robots.files.pictures import without_shapes
from reachlab.robots.robot import Robot
from reachlab.robots.shapes.clearance import Capsules
from reachlab.settings.validation import InputError

FOLLOWED = 0.45
"""Largest acceleration of a planned motion, in full speeds in a time of the servos' lag: more would take too fast
commands."""

log = logging.getLogger(__name__)

HUGE = 5.0
"""Radius of a capsule that no link has of an arm of the tutorial's size, and of others in proportion [m]."""

_Bit: Any = mujoco.mjtDisableBit


def shapes_of(robot: Robot) -> Capsules:
    """The capsules that contain a robot's links; of links without any it is said, once.

    Raises:
        InputError: it has no shapes.
    """
    shapes = robot.capsules
    if not any(shapes.links):
        raise InputError(
            f"robot {robot.name!r} has no shapes that could be read, and what it touches cannot be told: give its links"
            f" shapes, or choose a task that judges none; `reachlab robot {robot.model.file}` names files that were"
            " not found."
        )
    if max(shapes.radii) > HUGE * robot.scale:
        raise InputError(
            f"robot {robot.name!r} has a link that is {2 * max(shapes.radii):.3g} m thick by its shapes, and what it"
            f" touches cannot be told: {IN_MILLIMETRES}."
        )
    for link in {*range(1, robot.chain.n + 1)} - {*shapes.links}:
        moved = f"the link that joint {robot.joint_names[link - 1]!r} moves has no shapes that could be read"
        _warn(f"reachlab: robot {robot.name!r}: {moved}, and what it touches is not noticed.")
    of_base = {number for number, link in enumerate(shapes.links) if not link}
    if of_base and not of_base & {number for pair in shapes.pairs for number in pair}:
        thick = f"one capsule around its base is {2 * max(shapes.radii[number] for number in of_base):.2g} m thick"
        _warn(f"reachlab: robot {robot.name!r}: {thick}, and that the arm touches its base is not noticed.")
    return shapes


@functools.cache
def _warn(sentence: str) -> None:
    log.warning(sentence)


def add_contacts(spec: mujoco.MjSpec, robot: Robot, count: int) -> None:
    """Add the arm's capsules, the table and `count` bodies that do not move, and what of them may not meet.

    These are capsules of moving links and bodies, those capsules and the table, and `Capsules.pairs`. Nothing else
    collides: the file's own shapes are taken out where no inertia follows from them. The table is the plane of its top,
    without an edge. What `Capsules.floors` allows to be anywhere does not touch it.

    Contacts have no friction, and the Jacobian is dense: 4.0.0 solves sparse ones wrongly.

    Raises:
        InputError: the robot has no shapes.
    """
    shapes_of(robot)
    spec.option.disableflags &= ~int(_Bit.mjDSBL_CONTACT | _Bit.mjDSBL_CONSTRAINT)
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    for pair in spec.pairs:
        spec.delete(pair)
    without_shapes(spec)
    _add_capsules(spec, robot)
    add_surroundings(spec, robot.capsules, np.isfinite(robot.capsules.floors), robot.table_top, count)


def _add_capsules(spec: mujoco.MjSpec, robot: Robot) -> None:
    model, capsules, joints = robot.spec(pictures=False).compile(), robot.capsules, spec.joints
    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[: robot.chain.n]] = robot.home
    mujoco.mj_kinematics(model, data)
    frames = robot.chain.links_at(robot.home)
    for number, link in enumerate(capsules.links):
        body = int(model.jnt_bodyid[link - 1]) if link else 0
        holder = joints[link - 1].parent if link else spec.worldbody
        turn, place = data.xmat[body].reshape(3, 3), data.xpos[body]
        ends = [frames[link] @ (*end, 1.0) for end in (capsules.starts[number], capsules.ends[number])]
        start, end = ((end[:3] - place) @ turn for end in ends)
        add_capsule(holder, number, start, end, capsules.radii[number])


def arm_of(robot: Robot, lag: Sequence[float] = (), period: float = 0.02) -> Arm:
    """What planning has to know of a robot whose joints follow commands, a period [s] apart, by times `[n]` [s].

    Raises:
        InputError: the robot has no shapes.
    """
    chain, capsules, speed = robot.chain, shapes_of(robot), np.array(robot.speed)
    late = np.array(lag or np.zeros(chain.n))
    return Arm(
        frames=chain.between,
        slides=np.array(chain.slides),
        lower=np.array(chain.lower),
        upper=np.array(chain.upper),
        speed=speed,
        acceleration=np.minimum(robot.acceleration, FOLLOWED * speed / np.maximum(late, SHORTEST)),
        smooth=0.0,
        lag=late,
        home=np.array(robot.home),
        approach=np.array(chain.approach),
        table=robot.table_top,
        scale=robot.scale,
        period=period,
        links=np.array(capsules.links),
        starts=np.array(capsules.starts),
        ends=np.array(capsules.ends),
        radii=np.array(capsules.radii),
        pairs=np.array(capsules.pairs).reshape(-1, 2),
        floors=np.isfinite(capsules.floors),
    )


class FixedBodies:
    """Bodies that differ between simulations, and do not move in them.

    Attributes:
        geoms: their numbers in the model.
    """

    def __init__(self, batch: Batch) -> None:
        """None of them is there yet."""
        model = batch.model
        self.geoms = [geom for geom in range(model.ngeom) if model.geom(geom).name.startswith(BODY)]
        self._arrays = [batch.expand(name) for name in Geoms._fields] if self.geoms else []
        self._before = Geoms(*[np.zeros(0)] * len(Geoms._fields))

    def become(self, bodies: Bodies) -> None:
        """Put the first of bodies `[B, K]`, in NumPy, where they are."""
        if not (count := len(self.geoms)):
            return
        now = geoms_of(jax.tree.map(lambda x: x[:, :count], bodies))
        if all(map(np.array_equal, now, self._before)):
            return
        self._before = now
        for array, numbers in zip(self._arrays, now, strict=True):
            array[:, self.geoms] = numbers
