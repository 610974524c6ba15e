"""Kinds of scene: random furniture with a pose of the tool on one side of it and another on the other side.

Lengths are for the iiwa 14, and for others in proportion to their workspace, from where it begins; x is forward, z up.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from reachlab.control.bodies import Shape
from reachlab.robots.robot import Robot
from reachlab.settings.reading import MOST_TEXT, read_regular
from reachlab.settings.tables import Table
from reachlab.settings.validation import InputError, choose

THICK = 0.01
"""Half the thickness of walls and boards [m]."""

BEGINS = 0.2
"""Where the workspace of the iiwa 14 begins [m]."""

DOWN, FORWARD = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])
"""Where a tool points."""


ROOM = 0.17
"""No box on the table is nearer to where the tool starts or ends, seen from above [m]."""


class Body(NamedTuple):
    """A body: numbers as those of `Bodies`, upright and turned by `yaw` rad."""

    kind: Shape
    position: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0


class Place(NamedTuple):
    """Position [m] and direction of a tool, as far as it is tilted at random from it [rad]."""

    position: tuple[float, float, float]
    direction: np.ndarray
    tilt: float


class Drawn(NamedTuple):
    """A scene that was drawn; without a start the arm begins at home."""

    bodies: list[Body]
    start: Place | None
    goal: Place


@dataclass(frozen=True)
class Kind:
    """A kind of scene.

    Attributes:
        summary: in words.
        bodies: for so many there is room.
        draw: a scene, of a generator.
        scale: the arm's workspace in proportion to that for which its lengths are.
        ahead: by how much everything is moved forward [m].
        turn, base: of the arm: where its front is, about the vertical from x [rad], and where it stands `[3]` [m].
        content: of the file that it was read from.
    """

    summary: str
    bodies: int
    draw: Callable[[Generator], Drawn]
    scale: float = 1.0
    ahead: float = 0.0
    turn: float = 0.0
    base: tuple[float, ...] = (0.0, 0.0, 0.0)
    content: str = ""

    def place(self, position: Any) -> np.ndarray:
        """Where positions `[..., 3]` are on the arm [m]."""
        return self.turned(self.scale * np.asarray(position, float) + [self.ahead, 0.0, 0.0]) + self.base

    def turned(self, direction: Any) -> np.ndarray:
        """Where directions `[..., 3]` point on the arm: it is turned by quarters."""
        cos, sin = np.round([np.cos(self.turn), np.sin(self.turn)])
        return np.asarray(direction, float) @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _box(position: Any, half: Any, yaw: float = 0.0) -> Body:
    return Body(Shape.BOX, tuple(position), tuple(half), yaw)


def _side(rng: Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _wall(rng: Generator) -> Drawn:
    height, y, side = rng.uniform(0.15, 0.25), rng.uniform(-0.09, 0.09), _side(rng)

    def beside(side: float) -> Place:
        return Place((rng.uniform(0.38, 0.65), y + side * rng.uniform(0.13, 0.38), rng.uniform(0.13, 0.22)), DOWN, 0.1)

    return Drawn([_box((0.54, y, height), (0.38, THICK, height))], beside(-side), beside(side))


def _shelf(rng: Generator) -> Drawn:
    front, half, deep = rng.uniform(0.52, 0.6), rng.uniform(0.3, 0.43), 0.15
    boards, middle, tall = np.array([0.13, 0.48, 0.86]) + rng.uniform(-0.04, 0.04, 3), front + deep, 0.4
    bodies = [_box((middle, 0.0, z), (deep, half, THICK)) for z in boards]
    bodies += [_box((middle + deep, 0.0, 0.49), (THICK, half, tall))]
    bodies += [_box((middle, side * half, 0.49), (deep, THICK, tall)) for side in (-1, 1)]
    if rng.random() < 0.5:
        bodies.append(_box((middle, rng.uniform(-0.1, 0.1), 0.49), (deep, THICK, tall)))
    level = int(rng.integers(2))

    def inside(level: int, least: float) -> Place:
        y = rng.uniform(0.1 - half, half - 0.1)
        return Place((front + rng.uniform(least, 0.08), y, boards[level] + rng.uniform(0.1, 0.24)), FORWARD, 0.15)

    return Drawn(bodies, inside(1 - level, -0.02) if rng.random() < 0.5 else None, inside(level, 0.0))


def _bin(rng: Generator) -> Drawn:
    x, y = rng.uniform(0.45, 0.6), rng.uniform(-0.27, 0.27)
    height, a, b = rng.uniform(0.11, 0.17), rng.uniform(0.17, 0.22), rng.uniform(0.17, 0.22)
    bodies = [_box((x + side * a, y, height), (THICK, b, height)) for side in (-1, 1)]
    bodies += [_box((x, y + side * b, height), (a, THICK, height)) for side in (-1, 1)]
    inside = (x + rng.uniform(0.1 - a, a - 0.1), y + rng.uniform(0.1 - b, b - 0.1), rng.uniform(0.13, 0.22))
    away = y - np.copysign(b + rng.uniform(0.13, 0.27), y)
    beside = (x + rng.uniform(-0.1, 0.1), away, rng.uniform(0.13, 0.27))
    places = [Place(beside, DOWN, 0.1), Place(inside, DOWN, 0.1)]
    return Drawn(bodies, *(places if rng.random() < 0.5 else places[::-1]))


def _posts(rng: Generator) -> Drawn:
    bodies = []
    for _ in range(rng.integers(4, 9)):
        radius, half = rng.uniform(0.016, 0.032), rng.uniform(0.17, 0.28)
        x, y = rng.uniform(0.32, 0.7), rng.uniform(-0.24, 0.24)
        bodies.append(Body(Shape.CAPSULE, (x, y, half), (radius, half, 0.0)))
    side = _side(rng)

    def beside(side: float) -> Place:
        return Place((rng.uniform(0.38, 0.6), side * rng.uniform(0.27, 0.48), rng.uniform(0.13, 0.3)), DOWN, 0.2)

    return Drawn(bodies, beside(-side), beside(side))


def _table(rng: Generator) -> Drawn:
    side = _side(rng)

    def low(side: float) -> Place:
        return Place((rng.uniform(0.38, 0.65), side * rng.uniform(0.2, 0.4), rng.uniform(0.12, 0.2)), DOWN, 0.2)

    ends, bodies = (low(-side), low(side)), []
    for _ in range(rng.integers(6, 11)):
        half = rng.uniform(0.03, 0.08, 3) * [1.0, 1.0, 2.2]
        place = np.array([rng.uniform(0.3, 0.75), rng.uniform(-0.25, 0.25), half[2]])
        if all(np.hypot(*(place - end.position)[:2]) > ROOM for end in ends):
            bodies.append(_box(place, half, rng.uniform(0.0, np.pi)))
    return Drawn(bodies, *ends)


KINDS: dict[str, Kind] = Table(
    {
        "wall": Kind("a wall across the table between start and goal", 1, _wall),
        "shelf": Kind("a shelf of two levels, with back and sides, to reach into", 7, _shelf),
        "bin": Kind("a bin to reach into or out of", 4, _bin),
        "posts": Kind("four to eight posts between start and goal", 8, _posts),
        "table": Kind("up to ten boxes on the table, between start and goal near it", 10, _table),
    }
)
"""Kinds of scene by name, beside `balls`."""


BOX = (0.25, -0.5, 0.05), (0.75, 0.5, 0.8)
"""Corners of a box that holds all their goals [m]."""

MOST_BODIES = 16
"""Bodies of a file at most."""

FARTHEST = 100.0
"""Their size, and how far from the origin they are, at most [m]."""

SHAPES = {"ball": (Shape.BALL, 1), "capsule": (Shape.CAPSULE, 2), "box": (Shape.BOX, 3)}
"""Shapes of a file's bodies and how many numbers their size has: a radius; a radius and half a length; half sides."""


def kind_of(name: str, robot: Robot) -> Kind:
    """The kind of a name, or of a file of bodies, on an arm.

    Raises:
        InputError: there is none, or the file says something else.
    """
    if name.endswith(".json"):
        return _of_file(Path(name), robot)
    first, floor = robot.chain.frames[0][1], robot.workspace[0][2]
    base = float(first[0]), float(first[1]), float(floor)
    kind = replace(KINDS[choose("scene", name, KINDS)], scale=robot.scale, turn=robot.front, base=base)
    forward = kind.turned([1.0, 0.0, 0.0])
    begins = min((np.array(corner) - base) @ forward for corner in robot.workspace)
    return replace(kind, ahead=begins - BEGINS * robot.scale)


def _of_file(file: Path, robot: Robot) -> Kind:
    """Bodies that are always the same, with start and goal anywhere in the arm's box of goals."""
    if not file.exists():
        raise InputError(f"scene {str(file)!r} does not exist: put it there, or name another one.")
    try:
        content = read_regular(file, MOST_TEXT)[0].decode()
        said = json.loads(content)
        if not isinstance(said, dict) or not isinstance(said.get("bodies"), list):
            raise TypeError("there is no list of bodies")
        bodies = [_read(one) for one in said["bodies"]]
        if unknown := sorted(said.keys() - {"bodies"}):
            raise ValueError(f"nothing is called {', '.join(unknown)}")
    except KeyError as error:
        raise InputError(f"scene {str(file)!r} cannot be read: a body has no {error}.") from None
    except (OSError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise InputError(
            f'scene {str(file)!r} cannot be read ({error}): it must be JSON as {{"bodies": [{{"shape": "box",'
            ' "position": [0.5, 0, 0.2], "size": [0.3, 0.01, 0.2], "yaw": 0}]}, in metres and radians, with half the'
            f" lengths of a box; shapes are {', '.join(SHAPES)}."
        ) from None
    if not 0 < len(bodies) <= MOST_BODIES:
        raise InputError(f"scene {str(file)!r} has {len(bodies)} bodies: 1 to {MOST_BODIES} are allowed.")

    def draw(rng: Generator) -> Drawn:
        places = [Place(tuple(rng.uniform(*robot.goal_box)), DOWN, 1.0) for _ in range(2)]
        return Drawn(bodies, *places)

    return Kind(f"the bodies of {file.name}", len(bodies), draw, content=content)


def _read(one: dict[str, Any]) -> Body:
    shape, count = SHAPES[choose("shape", one["shape"], SHAPES)]
    size, position = one["size"], one["position"]
    if not isinstance(size, list) or not isinstance(position, list):
        raise TypeError(f"a {one['shape']} needs a list of 3 numbers as its position, and one of {count} as its size")
    if not all(type(part) in (int, float) for part in (*size, *position, one.get("yaw", 0))):
        raise TypeError("a size, position or yaw is not of numbers")
    if unknown := sorted(one.keys() - {"shape", "size", "position", "yaw"}):
        raise ValueError(f"nothing of a body is called {', '.join(unknown)}")
    size, position, yaw = np.array(size, float), np.array(position, float), float(one.get("yaw", 0.0))
    if size.shape != (count,) or position.shape != (3,) or not np.isfinite([*size, *position, yaw]).all():
        raise ValueError(f"a {one['shape']} needs a position of 3 numbers and a size of {count}")
    if max(np.abs(position).max(), size.max()) > FARTHEST:
        raise ValueError(f"a body is larger than {FARTHEST:g} m, or farther away")
    if size.min() <= 0:
        raise ValueError("a size is not positive")
    padded: Any = (*size, *[0.0] * (3 - count))
    return Body(shape, tuple(position), padded, yaw)
