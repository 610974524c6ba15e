"""A controller that runs an exported policy on an arm, with NumPy and the standard library alone.

    controller = Controller("policy/")
    controller.reset(measured_q)
    while True:  # at every control period, with seconds of a clock that never runs back
        command = controller.step(measured_q, measured_qd, goal, time)

`command` are joint positions in the order of `controller.joints`, for a position controller that follows at once.
"""

from __future__ import annotations

from collections import deque
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.control.motion_limits import MotionLimits
from reachlab.deploy.onboard.aiming import Aim
from reachlab.deploy.onboard.arrival import Arrival, slowness
from reachlab.deploy.onboard.bodies import Beside
from reachlab.deploy.onboard.folder import FORMAT, limits_of, read_folder
from reachlab.deploy.onboard.log import KEPT, read_log, write_log
from reachlab.deploy.onboard.reading import felt, in_words, of_units, read_bodies, read_numbers, read_seconds
from reachlab.deploy.onboard.step import load_step
from reachlab.deploy.onboard.watching import JUMP, Watch
from reachlab.deploy.onboard.ways import PlannerProcess, Told, Way

ASIDE = 0.01
"""How far past its limits an arm may rest that is taken over; its commands begin at the limit [rad or m]."""

NO_GOAL = "there is no goal, and the arm is held where it is"


class Controller:
    """Runs a policy: takes measurements and a goal, gives joint commands.

    Commands never leave the limits of position, speed, acceleration and jerk, whatever is measured or asked. Where a
    measurement cannot be believed, the last good one is used for 0.06 s; then, and where the controller is called late,
    the clock runs back or the goal is refused, the arm brakes: it is at rest 0.18 s later, and moves again when all is
    well. `problem` says why.

    Attributes:
        joints: names of the joints, in the order of all vectors.
        home: joints `[n]` in which episodes began in training [rad or m].
        period: time from one control step to the next [s].
        limits: of position, speed, acceleration and jerk: `limits` of `policy.json`, where they may be lowered.
        arrival: how far what it moves is from the goal, and whether that is reached.
        problem: what is wrong, or that there is no goal, in words; empty where neither is so.
        braking: the arm is brought to rest, or rests because it has to.
        asks_orientation: goals are poses.
        goal_box: lower and upper corner `[2, 3]` of the goals that were trained [m].
        home_quaternion: orientation `[4]`, wxyz, of the tool at home.
    """

    def __init__(self, folder: str | Path, *, planner: bool = True) -> None:
        """Controller of the policy in a folder that `reachlab export` wrote.

        Args:
            folder: the folder, with `policy.json`, `policy.safetensors` and `step.py`, which is run.
            planner: where one was exported too, start it, in a process that ends with this one, and let it take over
                where the policy does not get through.

        Raises:
            ValueError: a file is broken or of another export, or a limit is wider than what was exported.
        """
        folder = Path(folder)
        facts = read_folder(folder)
        if facts["format"] != FORMAT:
            raise ValueError(
                f"'{folder}' was exported by an earlier version: use the controller.py of its own, or export again."
            )
        limits, self.joints = limits_of(facts), [joint["name"] for joint in facts["joints"]]
        self.home, self.period = np.array(facts["arm"]["home"], float), float(facts["control_period"])
        self._lower, self._upper, self._inputs = limits["lower"], limits["upper"], facts["inputs"]
        self._beside, self._policy = Beside(facts), str(facts["sha256"])
        step = load_step(folder)
        self._decide, self._tool = step["decide"], step["tool"]
        self._aim = Aim(facts["goal"], (self._lower, self._upper), step)
        self.asks_orientation, self.goal_box = self._aim.poses, self._aim.box
        widest = limits_of(facts, widest=True)
        self.arrival = Arrival(facts, step.get("judge"), slowness(limits, widest))
        self.home_quaternion = np.array(self._tool(self.home.tolist())[1])
        plans = planner and "planner" in facts
        self._way = Way(facts, PlannerProcess(folder), self._tool) if plans else None
        self._watch = Watch(facts, widest)
        self.limits = MotionLimits(**limits, period=self.period)
        self._log: deque[Any] = deque(maxlen=KEPT)  # of numbers as `reading` gives them, all of them its own
        self._make_anew()

    def reset(self, q: Any) -> None:
        """Begin anew with an arm that rests at joints `[n]`, as they are measured: also after `stop`.

        Raises:
            ValueError: they are not joints of this arm, within its limits.
        """
        q, lower, upper = read_numbers(q), self._lower, self._upper
        if not isinstance(q, np.ndarray) or q.shape != lower.shape or not np.isfinite(q).all():
            got = f"something {q}" if isinstance(q, str) else in_words(q)
            raise ValueError(f"reset takes {len(lower)} measured joints, got {got}.")
        outside = (q < lower - ASIDE) | (q > upper + ASIDE)
        if outside.any():
            i = int(outside.argmax())
            raise ValueError(
                f"joint {self.joints[i]!r} is at {in_words(q[i])}, out of its limits {in_words(lower[i])} to"
                f" {in_words(upper[i])}: move the arm to within them, and reset there{of_units(q, lower, upper) or '.'}"
            )
        self._start(q)
        self._log.append({"reset": q.tolist()})

    def _make_anew(self) -> None:
        """Be as a new controller, which begins at home where nothing else is measured."""
        self._start(self.home)
        self._is_new = True
        self._log.append({"reset": None})

    def _start(self, q: np.ndarray) -> None:
        self.motion = self.limits.at_rest(np.clip(q, self._lower, self._upper))
        self._watch.reset(q)
        for kept in filter(None, (self._aim, self.arrival, self._beside, self._way)):
            kept.clear()
        self._action, self.problem = [0.0] * self._inputs["last_action"][0], ""
        self._memory = [0.0] * self._inputs.get("memory", [0])[0]
        self._stopped, self.braking, self._is_new = "", False, False

    def stop(self) -> None:
        """Brake, and stay at rest until `reset`."""
        self._stopped = "stop() was called"
        self._log.append({"stop": True})

    def close(self) -> None:
        """End what was started beside it."""
        if self._way:
            self._way.planner.close()

    def step(
        self,
        q: Any,
        qd: Any,
        goal: Any,
        time: float,
        *,
        velocity: Any = None,
        obstacles: Any = None,
        objects: Any = None,
        picture: np.ndarray | None = None,
        joints: Any = None,
        wrench: Any = None,
    ) -> np.ndarray:
        """Next joint command `[n]` [rad or m]; call it once in a control period. It raises nothing, see `problem`.

        Args:
            q: measured joints `[n]` [rad or m]; None where no measurement has come.
            qd: their speeds `[n]` [rad/s or m/s].
            goal: position of the tool `[3]` m or, for a policy that was trained on poses, position and quaternion
                wxyz `[7]`, in the frame that policy.json names; None holds the arm, but where the policy was trained
                with targets that are not seen at times: then it is one, once a target was given.
            time: of this step [s], by any clock that does not run back.
            velocity: of the goal `[3]` [m/s]; by default from its last positions.
            obstacles: for a policy that was trained among them, a list of dicts with `position`, and for boxes and
                capsules `quaternion`, `half` and `radius`, which sweeps them. Where they move, their `velocity` `[3]`
                [m/s] too, by default from their last positions: each keeps its place in the list.
            objects: for a policy that moves some, the same of these, by default as large as in training, with their
                `velocity` `[3]` [m/s] where the policy goes by it, as where it strikes them, and `time` [s] where they
                were measured earlier: without them, or with old ones, the arm brakes.
            picture: the camera's, for a policy that gets one, `[84, 84]` uint8.
            joints: joints at which the tool is at the goal, where they are known; by default they are looked for.
            wrench: for a policy that observes it, force and torque `[6]` [N, Nm] with which all that the last joint
                holds acts on the arm, in the frame of the last moving link. Without it the arm brakes.
        """
        q, qd, goal, velocity, joints, wrench = map(read_numbers, (q, qd, goal, velocity, joints, wrench))
        seconds, around, things = read_seconds(time), read_bodies(obstacles), read_bodies(objects)
        problem, brake = self._look(q, qd, seconds)
        wanted, refused, away = (before := self.motion.position), self._stopped, ""
        was = self.braking and not bool((self.motion.stop_step >= self.limits.steps).all())
        if not refused and seconds is not None:
            try:
                refused = self._aim.take(goal, seconds, velocity, joints, before)
                # An arm that rests because it has to finds out in every step whether it still has to.
                if self._aim.goal is not None and not (refused or brake or was):
                    bodies = around, things or [], seconds
                    wanted, refused, away = self._command(self._aim.goal, bodies, picture, wrench)
            except Exception as error:  # whatever it is, an arm in motion is brought to rest
                refused = f"{type(error).__name__}: {error}"
        self.braking = bool(refused or brake) or was
        if self.braking or self._aim.goal is None:
            self.arrival.clear()
        away = NO_GOAL if goal is None and self._aim.goal is None else away
        braked = refused or (problem if brake else "") or (self.problem if was else "")
        self.problem = braked or away or problem or self._beside.unknown(around)
        self.motion = self.limits.advance(self.motion, wanted, self.braking)
        command = self.motion.position
        told = self._watch.waited, command, self.problem, self._way.ask(self.limits, self.motion) if self._way else None
        self._log.append((q, qd, goal, seconds, velocity, around, things, joints, wrench, *told))
        return command.copy()

    def _look(self, q: Any, qd: Any, seconds: float | None) -> tuple[str, bool]:
        """What is wrong with a measurement, and whether to brake for it."""
        lost, sent = self._is_lost(q), self.motion.position
        problem, brake = self._watch.look(q, qd, seconds, sent)
        if self._watch.stood:
            self.motion = self.limits.at_rest(sent)
        return problem, brake or lost

    def _is_lost(self, q: Any) -> bool:
        """Whether it is not known, without a reset, where the arm is; if not at home it stays there: nothing leaps."""
        begin, lower, upper = self.motion.position, self._lower - ASIDE, self._upper + ASIDE
        if not (self._is_new and isinstance(q, np.ndarray) and q.shape == begin.shape):
            return self._is_new
        away = np.abs(q - begin)
        self._is_new = not (away <= JUMP).all()
        if self._is_new and ((lower <= q) & (q <= upper)).all():
            self._start(q)
            i = int(away.argmax())
            self._stopped = (
                f"joint {self.joints[i]!r} is measured at {in_words(q[i])}, and without a reset commands begin at home,"
                f" {in_words(begin[i])}: call reset with the joints at which the arm is measured to rest"
            )
        return self._is_new

    @property
    def waits(self) -> bool:
        """The arm waits for a planner: where time is simulated, let some pass."""
        return bool(self._way and self._way.waits)

    @property
    def goal_joints(self) -> np.ndarray | None:
        """Joints `[n]` at which the tool is at the goal, where the policy needs them and they are found."""
        goal = self._aim.goal or {}
        return np.array(goal["joints"]) if "joints" in goal else None

    def _command(self, goal: dict[str, Any], bodies: Any, picture: Any, wrench: Any) -> tuple[np.ndarray, str, str]:
        """The command `[m]` to a goal, why there is none, if so, and what else is wrong; bodies with the time [s]."""
        rest, inputs = self.motion.position, self._inputs
        given = {"q": self._watch.q.tolist(), "qd": self._watch.qd.tolist(), "command": rest.tolist()}
        given.update({"last_action": self._action, "memory": self._memory})
        given.update({f"goal_{name}": part for name, part in goal.items()})
        if hidden := goal["position"] is None:
            given["goal_position"], _ = self._tool(given["q"])
            self.arrival.clear()
        if refused := self._look_around(given, bodies, picture, wrench):
            return rest, refused, ""
        known = {"sure": not self._aim.seeks, "waits": self._way is not None}
        away = "" if hidden else self.arrival.look(given, bodies[2], **known)
        if self._way:
            planned, refused = self._way.command(goal, given, bodies[2])
            if planned is not None:
                return planned, refused, away
        with np.errstate(all="ignore"):  # what is not finite is refused below
            action, wanted, memory = (*self._decide(**{name: given[name] for name in inputs}), [])[:3]
        if not all(map(isfinite, (*wanted, *memory))):
            return rest, "the policy's command is not finite", ""
        self._action, self._memory = action, memory
        return np.array(wanted), "", away

    def _look_around(self, given: dict[str, Any], bodies: Any, picture: Any, wrench: Any) -> str:
        """Add what is seen and felt to what is given, as the policy needs it, and say what is wrong with it."""
        inputs = self._inputs
        if "picture" in inputs:
            if picture is None and self._aim.hides:
                picture = np.zeros(inputs["picture"], np.uint8)
            if picture is None or list(np.shape(picture)) != inputs["picture"]:
                return f"the policy needs a picture of {inputs['picture']} pixels"
            given["picture"] = picture
        try:
            given.update(felt(wrench, inputs))
            given.update(self._beside.numbers(*bodies))
        except ValueError as error:
            return str(error)
        return ""

    # --- log ----------------------------------------------------------------------------------------

    def save_log(self, file: str | Path) -> None:
        """Write the last control steps, a line of JSON each; `replay` takes them again, if no pictures were given."""
        write_log(self._log, Path(file), self._policy)

    def replay(self, file: str | Path) -> float:
        """Take a log's control steps again, from its first `reset` on; the largest difference of a command [rad or m].

        What a planner answered is taken from it: from then on this controller has none. Without a reset, as in a log
        that has grown too long, ValueError is raised.
        """
        worst, told = 0.0, Told()
        if self._way:
            self._way.planner = told
        for entry in read_log(Path(file), self._policy):
            told.next, waited = entry.pop("planned", None), entry.pop("waited", inf)
            self._watch.stop_watch = lambda waited=waited: waited
            if "reset" in entry:
                self._make_anew() if entry["reset"] is None else self.reset(entry["reset"])
            elif "stop" in entry:
                self.stop()
            else:
                expected, _ = entry.pop("command"), entry.pop("problem")
                worst = max(worst, float(np.abs(self.step(**entry) - expected).max()))
        return worst
