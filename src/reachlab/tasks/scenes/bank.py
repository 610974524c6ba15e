"""Scenes of a kind that are drawn once for an arm, each with a way through it that a planner has found."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax
import numpy as np
import safetensors.numpy
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from reachlab.control.bodies import FAR, Bodies, Shape
from reachlab.control.contact_model import arm_of
from reachlab.control.planning.branches import branches, free_branches
from reachlab.control.planning.collision import CollisionChecker
from reachlab.control.planning.search import Search
from reachlab.control.planning.workers import Workers
from reachlab.robots.robot import Robot
from reachlab.settings.cache import cache_folder
from reachlab.settings.validation import InputError, installing
from reachlab.tasks.scenes import kinds
from reachlab.tasks.scenes.kinds import Body, Drawn, Kind, Place, kind_of

log = logging.getLogger(__name__)

TRAINING, HELD_OUT = 2000, 2000
"""Scenes to train in, and others to evaluate in."""

CLEAR = 0.015
"""Least distance of the arm from bodies at start and goal and on the way [m], in proportion to its workspace."""

OWN = 0.003
"""Least distance of its links from each other [m]: by their capsules some arms come as near as 5 mm."""

TOGETHER = 64
"""Scenes that are drawn together."""

ROUNDS = 500
"""Rounds of a search after which a scene counts as one without a way."""

RADIUS = 0.04
"""Of a body that is not there [m]."""

OPPOSITE = 1e-6
"""Length of the sum of two unit vectors that are opposite."""

MOST_DRAWN, PATIENCE = 100, 20
"""A kind is given up once so many times as many scenes were drawn as were found, and these more."""


NOTHING = Kind("nothing", 0, lambda _: Drawn([], None, Place((0.0, 0.0, 0.0), kinds.DOWN, 0.0)))
"""No kind of scene."""


class Bank(NamedTuple):
    """Scenes of `count` episodes, in NumPy.

    Attributes:
        start: joints in which they start `[count, n]` [rad or m].
        joints: those at their goals `[count, n]`.
        bodies: what is beside the arm `[count, K]`.
    """

    start: np.ndarray
    joints: np.ndarray
    bodies: Bodies

    def with_room(self, count: int) -> Bank:
        """The same with room for so many bodies."""
        more = _bodies([], count - self.bodies.kind.shape[1], NOTHING)
        rows = jax.tree.map(lambda x: np.broadcast_to(x, (len(self.start), *x.shape)), more)
        return self._replace(bodies=jax.tree.map(lambda a, b: np.concatenate([a, b], axis=1), self.bodies, rows))


def bank_of(robot: Robot, scene: str) -> Bank:
    """The scenes of a kind for an arm: `TRAINING` to train in, and after them those to evaluate in.

    They are kept in the user's cache, and the same wherever they are drawn but for the last bits of joints.

    Raises:
        InputError: the kind does not exist, does not fit the arm, or OMPL is not installed.
    """
    kind = kind_of(scene, robot)
    sources = [Path(file).read_bytes() for file in (__file__, kinds.__file__)]
    asked = repr((TRAINING, HELD_OUT, scene, kind.content, robot, hashlib.sha256(b"".join(sources)).hexdigest()))
    name = hashlib.sha256(asked.encode()).hexdigest()[:32]
    if name not in _banks:
        _banks[name] = _kept(robot, scene, name)
    return _banks[name]


_banks: dict[str, Bank] = {}


def _kept(robot: Robot, scene: str, name: str) -> Bank:
    file = cache_folder() / "scenes" / f"{name}.safetensors"
    with contextlib.suppress(Exception):  # whatever is wrong with it, it is made anew
        arrays: dict[str, Any] = safetensors.numpy.load(file.read_bytes())
        del arrays["bodies"]
        return Bank(arrays.pop("start"), arrays.pop("joints"), Bodies(**arrays))
    bank = _drawn(robot, scene)
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{os.getpid()}.part")
        part.write_bytes(safetensors.numpy.save({**bank._asdict(), **vars(bank.bodies)} | {"bodies": np.zeros(0)}))
        part.replace(file)
    return bank


def _drawn(robot: Robot, scene: str) -> Bank:
    from rich.console import Console
    from rich.progress import track

    count = TRAINING + HELD_OUT
    about = f"{count} scenes {scene!r} for {robot.name}, kept for later"
    console, seen = Console(stderr=True), sys.stderr.isatty()
    if not seen:
        log.warning("reachlab: drawing %s, in one to five minutes.", about)
    scenes = track(drawn_scenes(robot, scene, count), about, count, console=console, disable=not seen)
    start, joints, bodies = zip(*scenes, strict=True)
    together = jax.tree.map(lambda *rows: np.stack(rows), *bodies)
    return Bank(np.array(start, np.float32), np.array(joints, np.float32), together)


# --- drawing --------------------------------------------------------------------------------------


def drawn_scenes(
    robot: Robot, scene: str, count: int, seed: int = 0
) -> Iterator[tuple[np.ndarray, np.ndarray, Bodies]]:
    """Scenes with joints at start and goal, as many as are asked for; those of the bank have seed 0."""
    found = 0
    try:
        workers = Workers(Finder, robot, scene, seed, most=count // TOGETHER)
    except ModuleNotFoundError:
        raise InputError(f"scene {scene!r} needs OMPL: {installing('planner')}.") from None
    with contextlib.closing(workers.map(itertools.count())) as batches:
        for batch, ways in enumerate(batches, 1):
            yield from ways[: count - found]
            found += len(ways)
            if found >= count:
                return
            if batch * TOGETHER > MOST_DRAWN * (found + PATIENCE):
                raise InputError(
                    f"scene {scene!r} does not fit robot {robot.name!r}: only {found} of {batch * TOGETHER:,} that were"
                    " drawn have a start and a goal in the open, and a way between them that is not straight: choose"
                    " bodies that stand in the arm's way, and neither around it nor out of its reach."
                )


class Finder:
    """Draws scenes of a kind, and finds out which of them have a start, a goal and a way between them."""

    def __init__(self, robot: Robot, scene: str, seed: int) -> None:
        """For an arm; which are drawn follows from the seed.

        Raises:
            InputError: the kind does not exist.
            ModuleNotFoundError: OMPL is not installed.
        """
        self._arm, self._kind, self._seed = arm_of(robot), kind_of(scene, robot), seed
        self._checker = CollisionChecker(self._arm, self._kind.bodies)
        self._checker.keep(CLEAR * robot.scale, OWN)
        self._search = Search(self._checker, self._arm.lower, self._arm.upper)

    def __call__(self, batch: int) -> list[tuple[np.ndarray, np.ndarray, Bodies]]:
        """Those of a batch of scenes that have all of that: joints at start and goal, and bodies."""
        rng = np.random.default_rng([self._seed, batch])
        drawn = [self._kind.draw(rng) for _ in range(TOGETHER)]
        goals, starts = (self.joints([getattr(one, end) for one in drawn], rng) for end in ("goal", "start"))
        ways = [self.way(*one) for one in zip(drawn, starts, goals, strict=True)]
        return [way for way in ways if way is not None]

    def joints(self, places: Sequence[Place | None], rng: Generator) -> list[np.ndarray]:
        """Joint vectors `[k, n]` that have each place; home where there is none."""
        some = [Place((0.5, 0.0, 0.5), kinds.DOWN, 0.0) if place is None else place for place in places]
        position = self._kind.place([place.position for place in some])
        rotation = np.array([self._pointing(place, rng) for place in some])
        found = branches(self._arm, position, rotation, rng)
        return [self._arm.home[None] if place is None else one for place, one in zip(places, found, strict=True)]

    def _pointing(self, place: Place, rng: Generator) -> np.ndarray:
        """An orientation `[3, 3]` of the tool, turned at random about where it points, which is tilted."""
        approach, way = self._arm.approach, self._kind.turned(place.direction) + rng.normal(0.0, place.tilt, 3)
        way /= np.linalg.norm(way)
        halfway = approach + way
        if np.linalg.norm(halfway) < OPPOSITE:
            halfway = np.cross(approach, np.roll(approach, 1))
        halfway /= np.linalg.norm(halfway)
        angle = rng.uniform(-np.pi, np.pi)
        # Half a turn about what lies halfway takes the one to the other.
        return Rotation.from_rotvec(angle * way).as_matrix() @ (2.0 * np.outer(halfway, halfway) - np.eye(3))

    def way(self, drawn: Drawn, starts: np.ndarray, goals: np.ndarray) -> tuple[np.ndarray, np.ndarray, Bodies] | None:
        """Joints at start and goal and the bodies, if there is a way and it is not straight to any branch."""
        bodies = _bodies(drawn.bodies, self._kind.bodies, self._kind)
        self._checker.place(bodies)
        start = next(filter(self._checker.free, starts), None)
        if start is None:
            return None
        goals = free_branches(self._checker, self._arm, goals, start)
        if not len(goals) or any(self._checker.straight(start, goal) for goal in goals):
            return None
        rounds = iter(range(ROUNDS))
        path = self._search.path(start, goals, lambda: next(rounds, None) is None, short=False)
        return None if path is None else (start, path[-1], bodies)


def _bodies(drawn: Sequence[Body], room: int, kind: Kind) -> Bodies:
    """Bodies `[room]` of a scene, with what there is room for beyond them out of the way."""
    count = len(drawn)
    turn = (np.array([body.yaw for body in drawn]) + kind.turn) / 2
    position, size = np.tile(FAR, (room, 1)), np.tile([RADIUS, 0.0, 0.0], (room, 1))
    quaternion, shape = np.tile([1.0, 0.0, 0.0, 0.0], (room, 1)), np.full(room, Shape.BALL, np.int32)
    if count:
        position[:count] = kind.place([body.position for body in drawn])
        size[:count] = kind.scale * np.array([body.size for body in drawn])
        quaternion[:count] = np.stack([np.cos(turn), 0 * turn, 0 * turn, np.sin(turn)], axis=1)
        shape[:count] = [body.kind for body in drawn]
    parts = {"position": position, "quaternion": quaternion, "velocity": np.zeros((room, 6)), "size": size}
    arrays: dict[str, Any] = {name: part.astype(np.float32) for name, part in parts.items()}
    return Bodies(**arrays, kind=cast("Any", shape))
