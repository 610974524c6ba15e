"""Bodies beside the arm, as a caller gives them and as the printed step takes them."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, isfinite, nan
from typing import Any

import numpy as np

from reachlab.deploy.onboard.reading import in_words

SHAPES = {"position": (3,), "quaternion": (4,), "half": (3,), "radius": (), "velocity": (3,), "time": ()}
"""What a body is made of, and of how many numbers."""

OLD = 0.1
"""Age of a measurement of an object from which on it is not believed [s]."""

GONE = 0.5
"""Age of a measurement of an obstacle that moves from which on it is not believed [s]."""

USUAL = {"quaternion": [1.0, 0.0, 0.0, 0.0], "half": [0.0] * 3, "radius": 0.0, "velocity": [0.0] * 3}
"""What a body has where nothing else is given."""

UNIT = 0.01
"""How far from 1 a quaternion's length may be."""

BALL, CAPSULE, BOX = 2, 3, 6
"""Kinds of bodies."""

FAR = [0.0, 0.0, -10.0]
"""Where bodies are that are not there [m]."""

ABSENT = {"position": FAR, "quaternion": [1.0, 0.0, 0.0, 0.0], "velocity": [0.0] * 6, "size": [0.0] * 3, "kind": [BALL]}
"""Numbers of one of them."""


FARTHEST = 100.0
"""Largest number of a body [m or m/s], as in scenes of one's own; millimetres are larger."""

FASTEST = 1.0
"""Speed from which on an obstacle counts as another than the one that was in its place of the list [m/s]."""


class Followed:
    """Where obstacles were, and how fast they are by that; each is known by its place in the list."""

    def __init__(self) -> None:
        """None has been seen."""
        self.clear()

    def clear(self) -> None:
        """Forget where they were."""
        self._last: dict[int, tuple[np.ndarray, float, np.ndarray]] = {}

    def fill(self, around: dict[str, list[float]], obstacles: Any, seconds: float) -> None:
        """Put velocities into the numbers of `placed` of those obstacles that are given without one.

        They are those between the last two places that differ, or nothing where these are more than `OLD` apart.

        Raises:
            ValueError: one was measured too long before these seconds.
        """
        last, self._last = self._last, {}
        for number, one in enumerate(obstacles):
            place, time = one["position"], float(one.get("time", seconds))
            if seconds - time > GONE:
                raise ValueError(f"obstacle {number + 1} was measured more than {GONE:g} s ago, and they move")
            if time - seconds > OLD:
                raise ValueError(f"obstacle {number + 1} was measured later than now: give times of the same clock")
            before, then, known = last.get(number, (place, time, np.zeros(3)))
            if (place != before).any() or time - then > OLD:
                known = (place - before) / (time - then) if 0.0 < time - then <= OLD else np.zeros(3)
                known, before, then = known * (np.sqrt(known @ known) <= FASTEST), place, time
            self._last[number] = before, then, known
            if "velocity" not in one:
                around["velocity"][6 * number : 6 * number + 3] = known.tolist()


class Beside:
    """What a policy is told of bodies."""

    def __init__(self, facts: dict[str, Any]) -> None:
        """By its facts."""
        self._room = facts["inputs"].get("bodies_kind", [0])[0]
        self._objects = facts.get("objects", []), facts.get("object_size")
        self._moving, self._sees = bool(facts.get("object_velocity", False)), bool(facts["observation"]["pictured"])
        self._followed = Followed() if facts.get("obstacle_velocity", False) else None

    def clear(self) -> None:
        """Forget what was."""
        if self._followed:
            self._followed.clear()

    def unknown(self, obstacles: Any) -> str:
        """Whether obstacles are given to a policy that knows of none, and has no picture of them either."""
        return "" if self._room or self._sees or not obstacles else "the policy knows of no obstacles: it meets them"

    def numbers(self, obstacles: Any, objects: Any, seconds: float) -> dict[str, list[float]]:
        """Inputs of the printed step, of what `read_bodies` gives; none of a policy that does not observe bodies.

        Raises:
            ValueError: see `placed`.
        """
        if not self._room:
            return {}
        around = placed(obstacles, self._room, objects, *self._objects, moving=self._moving, seconds=seconds)
        if self._followed:
            self._followed.fill(around, obstacles, seconds)
        return {f"bodies_{name}": numbers for name, numbers in around.items()}


def placed(
    obstacles: Any,
    room: int,
    objects: Any = (),
    free: Sequence[int] = (),
    size: Sequence[float] | None = None,
    *,
    moving: bool = False,
    seconds: float = 0.0,
) -> dict[str, list[float]]:
    """Numbers of `room` bodies by name, of which the last ones are objects of kinds `free` and, by default, a size.

    Obstacles and objects are as `read_bodies` gives them: boxes swept by a ball. Without half sizes one is a ball, with
    that along z alone a capsule. A box is made larger by its radius.

    Raises:
        ValueError: one of them is none, obstacles are None, there are more of them, not all objects, or of one it is
            not known where it is, since it was measured too long before `seconds`, or how it is `moving`.
    """
    if isinstance(obstacles, str) or isinstance(objects, str):
        raise ValueError("obstacles and objects are not lists of dicts of numbers")
    fixed, moved = room - len(free), len(free)
    if obstacles is None and fixed:
        raise ValueError("it is not known what is beside the arm: give obstacles, [] where there are none")
    obstacles = obstacles or []
    if len(obstacles) > fixed:
        raise ValueError(
            f"there are {len(obstacles)} obstacles, and the policy knows {fixed} at most: give the nearest"
        )
    if len(objects) != moved:
        raise ValueError(
            f"there are {len(objects)} objects, and the policy moves {moved}: give where they are measured"
        )
    for number, one in enumerate(objects, 1):
        if moving and "velocity" not in one:
            raise ValueError(f"object {number} has no velocity, and the policy goes by it: give it in m/s")
        age = seconds - float(one.get("time", seconds))
        if abs(age) > OLD:
            when = f"more than {OLD:g} s ago" if age > 0.0 else "later than now: give times of the same clock"
            raise ValueError(f"object {number} was measured {when}")
    parts: dict[str, list[float]] = {name: [] for name in ABSENT}
    _add(parts, obstacles, "obstacle")
    for name, numbers in ABSENT.items():
        parts[name] += numbers * (fixed - len(obstacles))
    if size is not None:
        usual = {"radius": np.array(size[0])} if BALL in free else {"half": np.array(size)}
        objects = [one if {"half", "radius"} & set(one) else {**usual, **one} for one in objects]
    _add(parts, objects, "object")
    parts["kind"][fixed:] = free
    return parts


def _add(parts: dict[str, list[float]], bodies: Any, what: str) -> None:
    for number, one in enumerate(bodies, 1):
        if wrong := _wrong_body(one, what):
            raise ValueError(f"{what} {number} {wrong}")
        body = {**USUAL, **{name: part.tolist() for name, part in one.items()}}
        half, radius, turn = body["half"], body["radius"], body["quaternion"]
        kind, length = BOX if half[0] or half[1] else CAPSULE if half[2] else BALL, hypot(*turn)
        size = [side + radius for side in half] if kind == BOX else [radius, half[2], 0.0]
        parts["position"] += body["position"]
        parts["quaternion"] += [part / length for part in turn]
        parts["velocity"] += [*body["velocity"], 0.0, 0.0, 0.0]
        parts["size"] += size
        parts["kind"].append(kind)


def _wrong_body(body: dict[str, Any], what: str) -> str:
    """What is wrong with an obstacle or an object, empty where nothing is."""
    if unknown := [name for name in body if name not in SHAPES]:
        return f"has {unknown[0]!r}, and an {what} is made of {', '.join(SHAPES)}"
    if "position" not in body:
        return "has no position"
    for name, numbers in body.items():
        plain = numbers.ravel().tolist() if isinstance(numbers, np.ndarray) and numbers.shape == SHAPES[name] else [nan]
        if not all(map(isfinite, plain)):
            return f"must have a {name} of {max(sum(SHAPES[name]), 1)} finite numbers, got {in_words(numbers)}"
        if name != "time" and max(map(abs, plain)) > FARTHEST:
            unit = "m/s" if name == "velocity" else "m"
            return f"must have a {name} within {FARTHEST:g} {unit}, got {in_words(numbers)}: is it in m{unit}?"
        if name in ("half", "radius") and min(plain) < 0.0:
            return f"must have a {name} of at least 0 m, got {in_words(numbers)}"
        if name == "quaternion" and not abs(hypot(*plain) - 1.0) <= UNIT:
            return f"must have a quaternion of length 1, got {in_words(numbers)}"
    sized = what != "obstacle" or {"half", "radius"} & set(body)
    return "" if sized else "has no size: give its radius, or its half lengths"
