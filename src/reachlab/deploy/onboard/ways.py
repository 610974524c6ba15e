"""Who moves the arm: the policy where it gets through, else a motion that a planner in another process has found."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
import weakref
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.control.motion_limits import Motion, MotionLimits
from reachlab.control.planning.following import PATIENCE, PROGRESS, Follower, Trajectory, gap

DEADLINE, LOOK = 5.0, 0.2
"""Times in which a planner has to have planned, and to have looked at a motion again [s]."""

STARTS = 60.0
"""Time in which it has to have started [s]."""

ENDED = "the planner has ended: it needs mujoco, ompl and toppra, and says on standard error what is wrong"

LATE = 1.5
"""Control periods from which on the arm has not been where its motion was."""

PLACED, STILL = 1e-3, 0.02
"""A command rests where a plan begins within the first [rad or m], and slower than the second [rad/s or m/s]."""

ALIKE = 2e-3
"""Goals whose joints are within this are one [rad or m]: what measures them gives another in every step."""


class PlannerProcess:
    """`planner.py` of an exported folder, in a process of its own: it is asked, and answers when it has found out.

    Attributes:
        close: ends it.
    """

    def __init__(self, folder: Path) -> None:
        """Start it, and wait until it is ready, or has ended."""
        pipe, command = subprocess.PIPE, [sys.executable, str(folder / "planner.py"), str(folder)]
        process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, start_new_session=True)  # noqa: S603
        self._process, self._answers, came = process, deque[dict[str, Any]](), threading.Event()
        threading.Thread(target=_read, args=(process.stdout, self._answers, came), daemon=True).start()
        self.close = weakref.finalize(self, _end, process)
        if came.wait(STARTS) and "ready" in self._answers[0]:
            self._answers.popleft()

    def ask(self, request: dict[str, Any]) -> None:
        """Ask it; it never waits, as long as nothing else is asked before the answer has come."""
        with contextlib.suppress(OSError):  # an answer says that it has ended
            print(json.dumps(request), file=self._process.stdin, flush=True)

    def answer(self) -> dict[str, Any] | None:
        """An answer that has come, or None. That it has ended stays its answer."""
        if not self._answers:
            return None
        return self._answers[0] if "ended" in self._answers[0] else self._answers.popleft()


def _read(lines: Any, answers: deque[dict[str, Any]], came: threading.Event) -> None:
    with contextlib.suppress(ValueError):  # who writes anything else is no planner any more
        for line in lines:
            answers.append(json.loads(line))
            came.set()
    answers.append({"ended": True})
    came.set()


def _end(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()
    for pipe in filter(None, (process.stdin, process.stdout)):
        pipe.close()


class Told:
    """Answers of a log, in place of a planner."""

    def __init__(self) -> None:
        """There is none yet."""
        self.next: dict[str, Any] | None = None

    def ask(self, request: dict[str, Any]) -> None:
        """What was asked has its answer in the log."""

    def answer(self) -> dict[str, Any] | None:
        """The answer that came in this control step, if any did."""
        told, self.next = self.next, None
        return told

    def close(self) -> None:
        """Nothing was started."""


class Way:
    """Decides in each control step who moves the arm.

    To a new goal the policy moves at once, for one step. Then the arm is brought to rest. The planner is told where
    that will be, and finds out whether the policy would get through from there and soon; otherwise it plans a motion.
    Until it has answered the arm waits there. A policy that comes no nearer is taken over from, and a motion is given
    up where bodies have moved into it.

    Attributes:
        planner: it is asked.
    """

    def __init__(self, facts: dict[str, Any], planner: Any, tool: Callable[[list[float]], Any]) -> None:
        """Of an exported policy whose tool is where `tool` says."""
        arm, goal = facts["planner"]["arm"], facts["goal"]
        self.planner, self._tool, self._period = planner, tool, float(arm["period"])
        self._near, self._turn = goal["success_distance"], goal.get("success_turn", 0.0)
        self._follower = Follower(arm["lag"], arm["speed"], self._period)
        self._asked, self._outstanding, self._since = 0, None, 0.0
        self.clear()

    def clear(self) -> None:
        """Have nothing to do, and forget what was."""
        self._told: dict[str, Any] | None = None
        self._goal: Any = None
        self._motion: Trajectory | None = None
        self._seconds, self._came, self._before = np.inf, 0.0, None
        self._forget(trust=True)
        self._checked, self._begun = None, False  # what was asked for is still to be answered

    def _forget(self, *, trust: bool) -> None:
        """Ask in the next step what to do, and whether to trust the policy; what is still to be answered is stale."""
        self._mode, self._trust, self._moved, self._asked = "ask", trust, False, self._asked + 1

    def command(self, goal: dict[str, Any], given: dict[str, Any], seconds: float) -> tuple[np.ndarray | None, str]:
        """The next command `[n]`, None where it is the policy's; and why there is none, if so.

        Args:
            goal: it has `joints` and a `position`.
            given: what the policy would decide by.
            seconds: of this control step.
        """
        scene = {name: given["bodies_" + name] for name in ("kind", "position", "quaternion", "size")}
        if seconds < self._seconds:  # the clock has run back, or begins
            self._since = self._came = seconds
        joints = np.array(goal["joints"])
        if self._goal is None or np.abs(joints - self._goal).max() > ALIKE:
            self._goal = joints
            self._forget(trust=True)
        elif self._mode == "follow" and not 0.0 < seconds - self._seconds <= LATE * self._period:
            self._forget(trust=False)
        elif self._mode == "none" and scene != self._scene:
            self._forget(trust=True)
        self._seconds, self._scene, held = seconds, scene, np.array(given["command"])
        self._speed = 0.0 if self._before is None else float(np.abs(held - self._before).max()) / self._period
        self._before = held
        self._listen()
        allowed = LOOK if self._mode == "follow" else DEADLINE
        if self._outstanding is not None and seconds - self._since > allowed:
            return held, f"the planner has not answered for {allowed:g} s"
        return self._by_mode(goal, given, held)

    def _by_mode(self, goal: dict[str, Any], given: dict[str, Any], held: np.ndarray) -> tuple[np.ndarray | None, str]:
        q = np.array(given["q"])
        if self._mode == "ended":
            return held, ENDED
        if self._mode == "none":
            return held, "the planner finds no way to the goal"
        if self._mode == "ask":
            first, self._moved = self._trust and not self._moved, True
            return (None if first else held), ""
        if self._mode == "wait" or not self._rests(held):
            return held, ""
        if self._mode == "follow" and self._motion:
            command = self._follower.command(self._motion, self._step, q, held)
            self._step += 1
            return command, ""
        distance = gap(self._tool(given["q"]), (goal["position"], goal.get("quaternion")), self._turn)
        if distance < max(self._nearest - PROGRESS, self._near):
            self._nearest, self._came = distance, self._seconds
        if self._seconds - self._came <= PATIENCE:
            return None, ""
        self._forget(trust=False)
        return held, ""

    def _rests(self, held: np.ndarray) -> bool:
        """Whether what was planned has begun or may: at rest, and where it was told to, else it is planned anew."""
        if not self._begun and self._speed <= STILL:
            self._begun, self._came = bool(np.abs(held - self._start).max() <= PLACED), self._seconds
            if not self._begun:
                self._forget(trust=False)
        return self._begun

    def _listen(self) -> None:
        """Do what the planner has answered, if it has."""
        told = self.planner.answer()
        if told is None:
            return
        if "current" not in told:
            number = told.get("number")
            told = {**told, "current": number == self._asked, "awaited": number == self._outstanding}
        self._told = told
        if told.get("awaited", True) or "ended" in told:
            self._outstanding = None
        if "ended" in told:
            self._mode = "ended"
        elif not told["current"]:
            return
        elif "leads" in told:
            if not told["leads"]:
                self._forget(trust=False)
        elif "q" in told:
            self._mode, self._step, self._begun = "follow", 0, False
            self._motion = Trajectory(np.array(told["q"]), np.array(told["command"]))
        elif told.get("policy"):
            self._mode, self._nearest, self._begun = "policy", np.inf, False
        else:
            self._mode = "none"

    @property
    def waits(self) -> bool:
        """What comes next depends on an answer of the planner."""
        return self._mode == "wait" or (self._mode == "ask" and self._outstanding is not None)

    def ask(self, limits: MotionLimits, motion: Motion) -> dict[str, Any] | None:
        """Ask the planner what is to be asked, now that a `motion` is commanded; what it has answered in this step."""
        told, self._told = self._told, None
        if self._outstanding is not None:
            return told
        if self._mode == "ask" and self._moved:
            self._mode, self._start = "wait", limits.rest(motion)
            self._send({"start": self._start.tolist(), "goal": self._goal.tolist(), "policy": self._trust})
        elif self._mode == "follow" and self._scene != self._checked:
            self._send({"step": self._step})
        return told

    def _send(self, request: dict[str, Any]) -> None:
        self._checked, self._since, self._outstanding = self._scene, self._seconds, self._asked
        self.planner.ask({**request, "number": self._asked, "bodies": self._scene})
