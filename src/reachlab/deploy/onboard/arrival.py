"""How far what a policy moves is from its goal, and whether it has come there, as training judged it."""

from __future__ import annotations

from collections.abc import Callable
from math import acos, dist, inf
from typing import Any

import numpy as np

from reachlab.deploy.onboard.watching import Watch

TRIED, NEARER = 3.0, 0.002
"""Time in which what is moved has to come so much nearer to its goal [s, m], or it is said that it does not."""

SLOW = 0.05
"""Speed below which joints rest, where facts say none [rad/s or m/s]."""


class Arrival:
    """Whether the tool or, of a policy that moves an object, the object is at the goal.

    Attributes:
        distance: from the goal, as it was measured last [m]; infinite where there is no goal, or nothing is measured.
        angle: the same of a pose's orientation [rad]; 0 where any will do.
        reached: both are within those of a success, for as long and with joints as slow as training asked for.
    """

    def __init__(self, facts: dict[str, Any], tool: Callable[[list[float]], Any]) -> None:
        """Of a policy's facts, for an arm whose tool is where `tool` says."""
        goal = facts["goal"]
        self._tool, self._near, self._turn = tool, float(goal["success_distance"]), float(goal.get("success_turn", 0.0))
        self._most = self._near / self._turn if self._turn else inf
        self._hold, self._slow = goal.get("held", (0.0, SLOW))
        self._handles, self._moves = bool(facts.get("objects")), bool(goal["moves"])
        self.clear()

    def clear(self) -> None:
        """Be nowhere."""
        self.distance, self.angle, self.reached = inf, inf, False
        self._since: float | None = None
        self._place: list[float] | None = None
        self._nearest, self._came, self._said = inf, 0.0, ""

    def look(self, watch: Watch, goal: Any, objects: Any, time: float | None, *, waits: bool) -> str:
        """What is wrong, where the goal is not come nearer to for long; empty where nothing is.

        Args:
            watch: it knows how the joints were measured last.
            goal: as `read_numbers` gives it; None where there is none.
            objects: as `read_bodies` gives them.
            time: of this control step, as `read_seconds` gives it [s].
            waits: the arm is held for another reason.
        """
        if time is None or not isinstance(goal, np.ndarray) or goal.shape != (7 if self._turn else 3,):
            self.clear()
            return ""
        place = goal[:3].tolist()
        self._measure(watch.q, goal, objects)
        slow = bool((np.abs(watch.qd) < self._slow).all())
        near = self.distance < self._near and self.angle < self._most
        if near and (slow or not self._hold):
            self._since = time if self._since is None else min(self._since, time)
        else:
            self._since = None
        self.reached = self._since is not None and time - self._since >= self._hold - 1e-9
        return self._stuck(place, time, near=near, fine=self._since is not None or waits or self._moves)

    def _stuck(self, place: list[float], time: float, *, near: bool, fine: bool) -> str:
        """What is said where a goal, at a place `[3]` m, is not come nearer to, or not to rest when near enough."""
        same = self._place is not None and dist(place, self._place) < self._near
        far = self.distance + self._turn * self.angle
        if fine or not same or far < self._nearest - NEARER or time < self._came:
            self._place = self._place if same else place
            self._nearest, self._came, self._said = far, time, ""
        elif time - self._came >= TRIED and not self._said:
            what, turned = (
                "the object" if self._handles else "the tool",
                f" and {self.angle:.2g} rad" * bool(self._turn),
            )
            away = f"{1000 * self.distance:.3g} mm{turned}"
            self._said = (
                f"{what} does not come to rest, {away} from the goal"
                if near
                else f"{what} comes no nearer to the goal, {away} away: is it out of reach, or is something in the way?"
            )
        return self._said

    def _measure(self, q: np.ndarray, goal: np.ndarray, objects: Any) -> None:
        place, quaternion = self._tool(q.tolist())
        if self._handles:
            seen = objects[0].get("position") if isinstance(objects, list) and objects else None
            place = seen.tolist() if isinstance(seen, np.ndarray) and seen.shape == (3,) else [inf] * 3
        self.distance = dist(place, goal[:3].tolist())
        alike = abs(float(np.dot(quaternion, goal[3:]))) if self._turn else 1.0
        self.angle = 2.0 * acos(min(alike, 1.0))
