"""How far what a policy moves is from its goal, and whether it has come there, as its task judges it."""

from __future__ import annotations

from collections.abc import Callable
from math import dist, inf
from typing import Any

import numpy as np

from reachlab.deploy.onboard.aiming import BESIDE

TRIED, NEARER = 3.0, 0.002
"""Time in which what is moved has to come so much nearer to its goal [s, m], or it is said that it does not."""


class Arrival:
    """Whether the tool or, of a policy that moves an object, the object is at the goal.

    Attributes:
        distance: from the goal, as it was measured last [m]; infinite without a goal, and while the arm has to brake.
        angle: the same of a pose's orientation [rad]; 0 where any will do.
        reached: an episode would end in success now. A goal that moves is never reached.
    """

    def __init__(self, facts: dict[str, Any], judge: Callable[..., Any] | None, slower: float) -> None:
        """Of a policy's facts and the `judge` of its step; limits that were lowered make the arm so much slower."""
        self._judge, self._facts = judge, facts.get("judge") or {}
        self._what = "the object" if facts.get("objects") else "the tool"
        self._moves, self._tried = bool(facts["goal"]["moves"]), TRIED * slower
        self.clear()

    def clear(self) -> None:
        """Be nowhere."""
        self.distance, self.angle, self.reached = inf, inf, False
        self._kept = dict(self._facts.get("begun", {}))
        self._goal: list[float] | None = None
        self._nearest, self._came = inf, 0.0

    def look(self, given: dict[str, Any], time: float, *, sure: bool, waits: bool) -> str:
        """What is wrong, where the goal is not come nearer to for long; empty where nothing is.

        Args:
            given: what the policy decides by.
            time: of this control step [s].
            sure: the goal is the one that was asked for, and not one beside it.
            waits: something else than the policy may hold the arm.
        """
        if self._judge is None:
            return ""
        given = {**given, **self._kept}
        found = dict(zip(self._facts["outputs"], self._judge(**{name: given[name] for name in self._facts["inputs"]})))
        self._kept = {name: found[name] for name in self._kept}
        (self.distance,), (self.angle,), (far,), (near,) = (
            found.get(name, [0.0]) for name in ("distance", "angle", "gap", "near")
        )
        self.reached = bool(found["success"][0]) and sure and not self._moves
        place = given["goal_position"]
        other = self._goal is None or dist(place, self._goal) > BESIDE
        fine = near if self._moves else self.reached or other or far < self._nearest - NEARER
        if fine or waits or time < self._came:
            self._goal = place if other else self._goal
            self._nearest, self._came = far, time
        if time - self._came < self._tried:
            return ""
        away = f"{1000 * self.distance:.3g} mm" + (f" and {self.angle:.2g} rad" if "angle" in found else "")
        if near:
            return f"{self._what} does not come to rest, {away} from the goal"
        return f"{self._what} comes no nearer to the goal, {away} away: is it out of reach, or is something in the way?"


def slowness(limits: dict[str, np.ndarray], widest: dict[str, np.ndarray]) -> float:
    """How many times as long motions take within limits as within the widest, of speed, acceleration and jerk `[n]`."""
    powers = {"speed": 1.0, "acceleration": 1 / 2, "jerk": 1 / 3}
    return max(float(((widest[name] / limits[name]) ** power).max()) for name, power in powers.items())
