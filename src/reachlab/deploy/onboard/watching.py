"""Whether measurements can be believed, and whether the controller is called in time."""

from __future__ import annotations

from typing import Any

import numpy as np

GRACE = 0.06
"""Time for which the last good measurement is used where none comes that can be [s]; then the arm brakes."""

BEYOND = 0.2
"""How far a joint may be measured past its limits, where it swings for moments, or away from its command [rad or m]."""

FASTER = 3.0
"""How much faster than its limit a joint may be measured to be."""

JUMP = 0.1
"""How far a joint may be from where it was, beside what its speed explains [rad or m]."""

MOVED = 0.005
"""A measurement that stays the same for `GRACE` while the command moves so far is not one [rad or m]."""

DRIFTED = 0.0005
"""Nor is one while its own speeds say that a joint moves so far [rad or m]."""


class Watch:
    """Looks at every measurement before it is used.

    Attributes:
        q, qd: the last measurement that was good.
    """

    def __init__(self, facts: dict[str, Any]) -> None:
        """For the arm of a policy's facts."""
        arm = facts["arm"]
        self._lower, self._upper = (np.array(arm[side], float) for side in ("lower", "upper"))
        self._speed, self._lag = (np.array(arm[name], float) for name in ("speed", "lag"))
        self._period = float(facts["control_period"])
        self._repeats = max(int(GRACE / self._period + 1e-6), 2)
        self.reset(np.array(arm["home"], float))

    def reset(self, q: np.ndarray) -> None:
        """Begin anew with an arm that rests at joints `[n]`."""
        self.q, self.qd = q.copy(), np.zeros_like(q)
        self._time: float | None = None
        self._good, self._same, self._command = 0.0, 0, q.copy()

    def look(self, q: Any, qd: Any, time: Any, command: np.ndarray) -> tuple[str, bool]:
        """What is wrong, empty where nothing is, and whether the arm has to brake for it.

        Args:
            q: measured joints, whatever that is.
            qd: their speeds, likewise.
            time: of this control step [s].
            command: the last joint command `[n]`.
        """
        if not isinstance(time, (int, float, np.floating, np.integer)) or not np.isfinite(time):
            return "the time is not a finite number", True
        before, self._time = self._time, float(time)
        if before is None:
            self._good = self._time
        elif self._time <= before:
            self._good = self._time
            return f"the clock runs back or stands still, at {time:g} s after {before:g} s", True
        wrong = self._wrong(q, qd, command, self._time - self._good)
        frozen = ""
        if not wrong:
            frozen = self._frozen(np.asarray(q, float), np.asarray(qd, float), command)
            self.q, self.qd = np.array(q, float), np.array(qd, float)
            self._good = self._time
        if before is not None and self._time - before > GRACE:
            return f"called {self._time - before:.3f} s after the last time, more than {GRACE:g} s", True
        if frozen:
            return frozen, True
        return wrong, bool(wrong) and self._time - self._good >= GRACE - 1e-9

    def _wrong(self, q: Any, qd: Any, command: np.ndarray, since: float) -> str:
        """What is wrong with a measurement that comes so long [s] after the last good one."""
        if q is None or qd is None:
            return "no measurement has come"
        try:
            q, qd = np.asarray(q, float), np.asarray(qd, float)
        except (TypeError, ValueError):
            return "the measurement is not made of numbers"
        if q.shape != self.q.shape or qd.shape != self.q.shape:
            return f"the measurement has {q.size} joints and {qd.size} speeds, the arm {self.q.size}"
        if not (np.isfinite(q).all() and np.isfinite(qd).all()):
            return "the measurement is not finite"
        for wrong, what in (
            ((q < self._lower - BEYOND) | (q > self._upper + BEYOND), "measured out of its limits"),
            (np.abs(qd) > FASTER * self._speed, "measured faster than it can be"),
            (np.abs(q - self.q) > JUMP + FASTER * self._speed * since, "measured to have jumped"),
            (np.abs(q - command) > BEYOND + 2 * self._lag * self._speed, "not where it was sent"),
        ):
            if wrong.any():
                return f"joint {int(wrong.argmax()) + 1} is {what}"
        return ""

    def _frozen(self, q: np.ndarray, qd: np.ndarray, command: np.ndarray) -> str:
        if (q == self.q).all() and (qd == self.qd).all():
            self._same += 1
        else:
            self._same, self._command = 0, command.copy()
        if self._same < self._repeats:
            return ""
        moved = np.abs(command - self._command).max() > MOVED
        drifted = np.abs(qd).max() * self._same * self._period > DRIFTED
        return f"the measurement has not changed for {self._same} steps, and the arm moves" if moved or drifted else ""
