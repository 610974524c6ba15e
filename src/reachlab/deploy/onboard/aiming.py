"""The goal of a controller: taken as it is given, refused where it cannot be one, and the joints that it needs."""

from __future__ import annotations

from collections.abc import Callable, Generator
from math import cos, isfinite
from typing import Any

import numpy as np

from reachlab.deploy.onboard.bodies import UNIT
from reachlab.deploy.onboard.reading import in_words

ROUNDS_A_STEP, ROUNDS_OF_POSES = 32, 4
"""Rounds in which the joints of a goal are looked for in a control step, so that none waits for them. Those of a pose
are looked for from many joints at once: a round takes 0.4 ms, and that of a point 0.02."""

NEARBY = 0.1
"""How far outside the box of the goals that were trained a goal may be [m]."""

RARE = 1.5
"""Times between two places of a goal that moves after which, without another, it stands."""

SEEN = 0.25
"""Time between two places of it from which a velocity follows, at most [s]."""

THERE = 0.01
"""How far from a goal the tool may be at the joints that are given for it [m]."""

TURNED = 0.05
"""How far from it the tool may be turned at them [rad]."""

BESIDE, BESIDE_TURN = 0.05, 0.2
"""How far from a goal the next may be, and how far turned, for the joints of the one to count until those of the other
are found [m, rad]. What measures a goal gives a new one in every step."""

DROPPED = 10
"""Goals in a row that went further before their joints were found: then that is a problem."""

Goal = dict[str, Any]
"""Numbers by name: `position [3]` m and, as needed, `quaternion [4]` wxyz, `velocity [3]` m/s and `joints [n]`."""

UNSEEN: Goal = {"position": None, "velocity": [0.0, 0.0, 0.0]}
"""A goal that was seen before, of a policy that was trained with such: it is observed where the tool is."""


class Aim:
    """What the tool is asked to do.

    Attributes:
        goal: the goal, or the last one beside it whose joints are found; None where there is none.
        box: lower and upper corner `[2, 3]` of the goals that were trained [m].
        poses: goals are poses.
        hides: a goal may not be seen at times.
    """

    def __init__(
        self, facts: dict[str, Any], limits: tuple[np.ndarray, np.ndarray], step: dict[str, Callable[..., Any]]
    ) -> None:
        """Of a policy's facts about its goals, for joints within limits `[n]`; its functions are those of its step."""
        self._facts, self.poses, self._limits, self._step = facts, bool(facts["orientation"]), limits, step
        self.box, self.hides = np.array([facts["low"], facts["high"]], float), bool(facts.get("hidden", False))
        self.clear()

    def clear(self) -> None:
        """Have no goal."""
        self.goal: Goal | None = None
        self._given: tuple[Any, ...] | None = None
        self._sought: np.ndarray | None = None
        self._search: Generator[None, None, Any] | None = None
        self._refused, self._dropped = "", 0
        self._seen: tuple[np.ndarray, float, float, np.ndarray] | None = None

    @property
    def seeks(self) -> bool:
        """Joints of the goal that was asked for are still looked for."""
        return self._search is not None

    def take(self, goal: Any, time: float, velocity: Any, joints: Any, near: np.ndarray) -> str:
        """Take a goal, and give why it is refused, if it is.

        Args:
            goal: numbers as `read_numbers` gives them, or None.
            time: of this control step [s].
            velocity: of the goal, likewise.
            joints: at which the tool is there, likewise.
            near: joints `[n]` next to which others are looked for.
        """
        if goal is None:
            hidden = self.goal is not None and self.hides
            self.clear()
            self.goal = UNSEEN if hidden else None
            return ""
        joints = joints if self._facts["joints"] else None
        given = tuple(one if one is None or isinstance(one, str) else one.tobytes() for one in (goal, joints))
        # One that is asked for again was found right when it came.
        if (given != self._given or velocity is not None) and (wrong := self._wrong(goal, velocity, joints)):
            return wrong
        if self._facts["moves"]:
            known = self._seen_velocity(goal[:3], time) if velocity is None else velocity
            self.goal = {"position": goal[:3].tolist(), "velocity": known.tolist()}
            return ""
        if given != self._given:
            self._change(given, goal, joints, near)
        return self._look_for_joints()

    def _change(self, given: tuple[Any, ...], goal: np.ndarray, joints: np.ndarray | None, near: np.ndarray) -> None:
        """Aim at another goal; at one beside the one before, once the joints of that one are found."""
        beside = joints is None and self._is_beside(goal)
        if beside and self._search:
            return
        if not beside:
            self._dropped += self._search is not None
            self.goal, self._search, self._refused = None, None, ""
        self._given, self._sought = given, goal
        near = near if self.goal is None else np.array(self.goal.get("joints", near))
        self.goal = self._set(goal, joints, near) or self.goal

    def _is_beside(self, goal: np.ndarray) -> bool:
        before = self._sought
        if before is None or np.linalg.norm(goal[:3] - before[:3]) > BESIDE:
            return False
        return not self.poses or _alike(goal[3:], before[3:]) >= cos(BESIDE_TURN / 2)

    def _wrong(self, goal: Any, velocity: Any, joints: Any) -> str:
        wanted = {
            "goal": (goal, 7 if self.poses else 3),
            "goal's velocity": (velocity, 3),
            "goal's joints": (joints, len(self._limits[0])),
        }
        for name, (numbers, size) in wanted.items():
            if isinstance(numbers, str):
                return f"the {name} must be {size} finite numbers, and is {numbers}"
            if numbers is not None and (numbers.shape != (size,) or not all(map(isfinite, numbers.tolist()))):
                return f"the {name} must be {size} finite numbers, got {in_words(numbers)}"
        low, high = self.box.tolist()
        if not all(a - NEARBY <= one <= b + NEARBY for one, a, b in zip(goal.tolist(), low, high)):
            near = f"{in_words(self.box[0])} to {in_words(self.box[1])} m, by more than {NEARBY:g} m"
            return f"the goal {in_words(goal[:3])} is out of the workspace, {near}"
        if self._facts["moves"] and velocity is not None and np.linalg.norm(velocity) > self._facts["fastest"]:
            fastest = f"{self._facts['fastest']:g} m/s at most"
            return f"the goal's velocity is {in_words(velocity)} m/s, and the policy knows {fastest}: is it in mm/s?"
        if self.poses and abs(np.linalg.norm(goal[3:]) - 1) > UNIT:
            return f"the goal's quaternion must have length 1, got {in_words(goal[3:])}"
        return ""

    def _set(self, goal: np.ndarray, joints: np.ndarray | None, near: np.ndarray) -> Goal | None:
        """The goal, or None where its joints have to be looked for."""
        turned = {"quaternion": (goal[3:] / np.linalg.norm(goal[3:])).tolist()} if self.poses else {}
        if not self._facts["joints"]:
            return {"position": goal[:3].tolist(), **turned}
        if joints is not None:
            position, quaternion = self._step["tool"](joints.tolist())
            self._refused = self._elsewhere(goal, joints, np.array(position), np.array(quaternion))
            if self._refused:
                return None
            return {"position": position, "quaternion": quaternion, "joints": joints.tolist()}
        self._search = self._step["place"](near=near.tolist(), position=goal[:3].tolist(), **turned)
        return None

    def _elsewhere(self, goal: np.ndarray, joints: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> str:
        """Why joints `[n]`, at which the tool is there, are none of the goal."""
        low, high = self._limits
        if not ((low <= joints) & (joints <= high)).all():
            return f"the goal's joints {in_words(joints)} are out of the limits, {in_words(low)} to {in_words(high)}"
        if float(np.linalg.norm(goal[:3] - position)) > THERE:
            return f"the goal's joints have the tool at {in_words(position)}, and not at the goal"
        if self.poses and _alike(goal[3:], quaternion) < cos(TURNED / 2):
            return f"the goal's joints have the tool turned to {in_words(quaternion)}, and not as the goal"
        return ""

    def _seen_velocity(self, place: np.ndarray, time: float) -> np.ndarray:
        """Velocity `[3]` m/s of a goal that is now at `[3]` m; nothing of one that has jumped or stands.

        It follows from the last two places that differ: goals may come less often than control steps.
        """
        before, then, usual, velocity = self._seen or (place, time, 0.0, np.zeros(3))
        passed = time - then
        if (place != before).any():
            velocity = (place - before) / passed if 0.0 < passed <= SEEN else np.zeros(3)
            velocity = velocity * (np.sqrt(velocity @ velocity) <= self._facts["fastest"])
            before, then, usual = place, time, passed
        elif passed > RARE * usual:
            velocity = np.zeros(3)
        self._seen = before, then, usual, velocity
        return velocity

    def _look_for_joints(self) -> str:
        """Take some rounds of the search, and give why the goal is refused where it ends without joints."""
        if self._search is None:
            return self._refused
        if self._dropped > DROPPED:
            self._refused = f"the goal moves by more than {BESIDE:g} m before its joints are found, again and again"
        try:
            for _ in range(ROUNDS_OF_POSES if self.poses else ROUNDS_A_STEP):
                next(self._search)
        except StopIteration as ended:
            self._search, placed = None, dict(zip(self._facts["placed"], ended.value))
            self.goal, self._refused, self._dropped = None, "", 0
            if placed.pop("reached")[0]:
                self.goal = placed
            else:
                self._refused = "the goal is out of reach: no joints are found at which the tool is there freely"
        return self._refused


def _alike(one: np.ndarray, other: np.ndarray) -> float:
    """Cosine of half the angle between orientations, quaternions `[4]` of about unit length."""
    return abs(float(one @ other)) / float(np.linalg.norm(one) * np.linalg.norm(other))
