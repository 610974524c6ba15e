"""Whether measurements can be believed, and whether the controller is called in time."""

from __future__ import annotations

from collections import deque
from time import monotonic
from typing import Any

import numpy as np

from reachlab.deploy.onboard.reading import in_words, of_units

GRACE = 0.06
"""Time for which the last good measurement is used where none comes that can be [s]; then the arm brakes."""

PERIODS = 3
"""The same in control periods, for policies whose are long."""

STOOD = 1.0
"""Time without a call after which an arm rests where it was sent [s], by the machine's own clock too: one that is set
says little of an arm in motion."""

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


CALLS, OFF = 15, 0.25
"""Calls whose mean rate is compared with the policy's, and by what share it may differ."""

UNFIT = 0.1
"""How far, beside as far as it went, measured speeds may lead from where a joint is in as many calls [rad or m]."""

FOLLOWED, FAST_ENOUGH = 50, 0.5
"""Calls over which it is found how late joints follow, and their least speed in them, the root mean square of all
joints together [rad/s or m/s]: at less, what gravity displaces them by counts for too much."""

TINY = 1e-9
"""Divides in place of a smaller number."""

SOONER, LATER, USUAL_LAG = 0.4, 0.6, 0.1
"""By what share of the least time in training they may follow sooner, and of the longest later, without a word; of less
than the usual one [s], of that."""


class Watch:
    """Looks at every measurement before it is used.

    Attributes:
        q, qd: the last measurement that was good.
        waited: time since the call before, as `stop_watch` tells it [s].
        stood: the arm rests where it was sent, for nothing has called for so long.
    """

    def __init__(self, facts: dict[str, Any], widest: dict[str, np.ndarray]) -> None:
        """For the arm of a policy's facts, which can do what its widest limits say."""
        self._names = [joint["name"] for joint in facts["joints"]]
        self._lower, self._upper = widest["lower"] - BEYOND, widest["upper"] + BEYOND
        self._fast = FASTER * widest["speed"]
        self._away = BEYOND + 2 * np.array(facts["arm"]["lag"], float) * widest["speed"]
        self._period = float(facts["control_period"])
        self._lag = np.array(facts["arm"]["lag"], float)
        self._lag_range = facts["arm"].get("lag_range", (1.0, 1.0))
        self._grace = max(GRACE, PERIODS * self._period)
        self._repeats = max(int(GRACE / self._period + 1e-6), 2)
        self._asked: float | None = None
        self.waited = 0.0
        self.reset(np.array(facts["arm"]["home"], float))

    def reset(self, q: np.ndarray) -> None:
        """Begin anew with an arm that rests at joints `[n]`."""
        self.q, self.qd = q.copy(), np.zeros_like(q)
        self._time: float | None = None
        self.stood = False
        self._good, self._same, self._command, self._measured = 0.0, 0, q.copy(), False
        self._passed: deque[float] = deque(maxlen=CALLS)
        self._way = np.zeros_like(q)
        self._ways: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=CALLS)
        self._followed, self._calls, self._behind = np.zeros(3), 0, ""

    def stop_watch(self) -> float:
        """Time since it was last asked [s], 0 at first, by a clock that nobody sets."""
        before, self._asked = self._asked, monotonic()
        return 0.0 if before is None else self._asked - before

    def look(self, q: Any, qd: Any, time: float | None, command: np.ndarray) -> tuple[str, bool]:
        """What is wrong, empty where nothing is, and whether the arm has to brake for it.

        Args:
            q: measured joints, as `read_numbers` gives them.
            qd: their speeds, likewise.
            time: of this control step [s], as `read_seconds` gives it.
            command: the last joint command `[n]`.
        """
        self.waited, self.stood = self.stop_watch(), False
        if time is None:
            return "the time is not a finite number", True
        before, self._time = self._time, time
        passed = 0.0 if before is None else time - before
        self.stood = min(passed, self.waited) > STOOD
        if before is None:
            self._good = time
        elif time <= before:
            self._good = time
            self._passed.clear()
            return f"the clock runs back or stands still, {before - time:.3g} s before the last step", True
        wrong = self._wrong(q, qd, command, time - self._good)
        frozen = ""
        if not wrong:
            frozen = self._frozen(q, qd, command)
            self.q, self.qd, self._good, self._measured = q, qd, time, True
        if passed > self._grace:
            self._passed.clear()
            return f"called {passed:.3f} s after the last time, more than {self._grace:g} s", True
        if frozen:
            return frozen, True
        rate, too_fast = ("", False) if before is None else self._off_rate(passed)
        late = not self._measured or time - self._good >= self._grace - 1e-9
        behind = "" if wrong else self._off_lag(command)
        return wrong or rate or self._unfit(passed) or behind, too_fast or (bool(wrong) and late)

    def _off_rate(self, passed: float) -> tuple[str, bool]:
        """What is wrong with the rate of calls, and whether they are too many: commands then leave limits of speed."""
        self._passed.append(passed)
        mean = sum(self._passed) / len(self._passed)
        if len(self._passed) < CALLS or abs(self._period / mean - 1.0) <= OFF:
            return "", False
        rates = f"step is called at {1 / mean:.3g} Hz, and the policy's rate is {1 / self._period:.3g} Hz"
        return f"{rates}: call it every {self._period:g} s", mean < self._period

    def _unfit(self, passed: float) -> str:
        """Whether measured speeds are those of the measured joints, over the last calls."""
        self._way = self._way + self.qd * passed
        self._ways.append((self.q, self._way))
        moved, told = self.q - self._ways[0][0], self._way - self._ways[0][1]
        unfit = np.abs(told - moved) > UNFIT + np.abs(moved)
        if not unfit.any():
            return ""
        return f"the speed of joint {self._names[int(unfit.argmax())]!r} does not fit where it is: unit, sign or order?"

    def _off_lag(self, command: np.ndarray) -> str:
        """Whether joints follow the last command `[n]` as late as in training: by how far they are behind it."""
        squares = np.square(self.qd)
        self._followed += (command - self.q) @ self.qd, self._lag @ squares, squares.sum()
        self._calls += 1
        if self._calls == FOLLOWED:
            (behind, usual), moved = self._followed[:2] / max(self._followed[2], TINY), self._followed[2]
            if moved > FOLLOWED * FAST_ENOUGH**2:
                least, most = (share * usual for share in self._lag_range)
                low, high = least - SOONER * max(least, USUAL_LAG), most + LATER * max(most, USUAL_LAG)
                trained = f"{least:.2f} s" if least == most else f"{least:.2f} to {most:.2f} s"
                late = f"joints are measured {max(behind, 0):.2f} s behind their commands, and {trained} in training"
                self._behind = "" if low <= behind <= high else f"{late}: the arm may swing about its goal"
            self._followed, self._calls = np.zeros(3), 0
        return self._behind

    def _wrong(self, q: Any, qd: Any, command: np.ndarray, since: float) -> str:
        """What is wrong with a measurement that comes so long [s] after the last good one."""
        if q is None:
            return "no measurement has come"
        if qd is None:
            return "no speeds of the joints have come: give (q - the last q) / period where none are measured"
        if isinstance(q, str) or isinstance(qd, str):
            return "the measurement is not made of numbers"
        if q.shape != self.q.shape or qd.shape != self.q.shape:
            return f"the measurement is of shapes {q.shape} and {qd.shape}, and the arm's joints of {self.q.shape}"
        far = JUMP + self._fast * (since * self._measured)
        usual = (self._lower <= q) & (q <= self._upper) & (np.abs(qd) <= self._fast)
        if (usual & (np.abs(q - self.q) <= far) & (np.abs(q - command) <= self._away)).all():
            return ""
        if not (np.isfinite(q).all() and np.isfinite(qd).all()):
            return "the measurement is not finite"
        jumped = np.abs(q - self.q) > far
        if jumped.any() and not self._measured:
            i = int(jumped.argmax())
            return (
                f"joint {self._names[i]!r} is measured at {in_words(q[i])}, and commands begin at"
                f" {in_words(self.q[i])}: call reset with the joints at which the arm is measured to rest"
                f"{of_units(q, self._lower, self._upper)}"
            )
        for wrong, what in (
            ((q < self._lower) | (q > self._upper), "measured out of its limits"),
            (np.abs(qd) > self._fast, "measured faster than it can be"),
            (jumped, "measured to have jumped"),
            (np.abs(q - command) > self._away, "not where it was sent"),
        ):
            if wrong.any():
                i = int(wrong.argmax())
                turned = abs(abs(q[i] - command[i]) - 2 * np.pi) < self._away[i]
                wrapped = ", by a full turn: give angles that go on where the driver begins anew" if turned else ""
                return f"joint {self._names[i]!r} is {what}{wrapped}"
        return ""

    def _frozen(self, q: np.ndarray, qd: np.ndarray, command: np.ndarray) -> str:
        if q.tobytes() == self.q.tobytes() and qd.tobytes() == self.qd.tobytes():
            self._same += 1
        else:
            self._same, self._command = 0, command.copy()
        if self._same < self._repeats:
            return ""
        moved = np.abs(command - self._command).max() > MOVED
        drifted = np.abs(qd).max() * self._same * self._period > DRIFTED
        stale = f"the measurement has not changed for {self._repeats} steps and more, and the arm was moved"
        return stale if moved or drifted else ""
