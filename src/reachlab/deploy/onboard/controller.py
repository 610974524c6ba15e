"""A controller that runs an exported policy on an arm, with NumPy and the standard library alone.

    controller = Controller("policy/")
    controller.reset(measured_q)
    while True:  # at every control period, with seconds of a clock that never runs back
        command = controller.step(measured_q, measured_qd, goal, time)

`command` are joint positions in the order of `controller.joints`, for a position controller that follows at once.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.deploy.onboard.arm import Arm, quaternion_of
from reachlab.deploy.onboard.deciding import Decider, Goal, Situation
from reachlab.deploy.onboard.log import Log, read_log
from reachlab.deploy.onboard.network import Network, onnx_network, read_weights
from reachlab.deploy.onboard.scene import Obstacles
from reachlab.deploy.onboard.solving import Solver
from reachlab.deploy.onboard.watching import Watch
from reachlab.robots.motion_limits import MotionLimits

SOLVED_A_STEP = 4
"""Steps that the solver of a goal's joints takes in a control step."""

ASIDE = 0.01
"""How far past its limits an arm may rest that is taken over; its commands begin at the limit [rad or m]."""

NEARBY = 0.1
"""How far outside the box of the goals that were trained a goal may be [m]."""


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
        limits: of position, speed, acceleration and jerk.
        problem: what is wrong, in words; empty where nothing is.
        braking: the arm is brought to rest, or rests because it has to.
        asks_orientation: goals are poses.
        goal_box: lower and upper corner `[2, 3]` of the goals that were trained [m].
        home_quaternion: orientation `[4]`, wxyz, of the tool at home.
    """

    def __init__(self, folder: str | Path, *, runtime: str = "numpy") -> None:
        """Controller of the policy in a folder that `reachlab export` wrote.

        Args:
            folder: the folder, with `policy.json` and `policy.safetensors`.
            runtime: what computes the network: `numpy`, or `onnx` for ONNX Runtime and `policy.onnx`.

        Raises:
            ValueError: a file is broken, or there is no such runtime.
            ModuleNotFoundError: ONNX Runtime is asked for and not installed.
        """
        folder = Path(folder)
        facts = json.loads((folder / "policy.json").read_text(encoding="utf-8"))
        self.joints = [joint["name"] for joint in facts["joints"]]
        self.home, self.period = np.array(facts["arm"]["home"], float), float(facts["control_period"])
        self._goal_facts, self._pictured = facts["goal"], facts["observation"]["pictured"]
        self.asks_orientation = bool(self._goal_facts["orientation"])
        self._arm = Arm(facts["arm"], facts["constants"])
        self.goal_box = np.array([self._goal_facts["low"], self._goal_facts["high"]], float)
        self.home_quaternion = quaternion_of(self._arm.frames(self.home).rotation)
        self._decider, self._watch = Decider(self._arm, facts), Watch(facts)
        network = {"numpy": lambda: Network(read_weights(folder / "policy.safetensors"), facts["network"]).act}
        network["onnx"] = lambda: onnx_network(folder / "policy.onnx")
        if runtime not in network:
            raise ValueError(f"runtime must be numpy or onnx, got {runtime!r}.")
        self._act = network[runtime]()
        arm, joints = facts["arm"], facts["joints"]
        ramp, jerk = (np.array([joint[name] for joint in joints], float) for name in ("acceleration", "jerk"))
        self.limits = MotionLimits(arm["lower"], arm["upper"], arm["speed"], ramp, jerk, self.period)
        self._log = Log()
        self.reset(self.home)

    def reset(self, q: Any) -> None:
        """Begin anew with an arm that rests at joints `[n]`: also after `stop`.

        Raises:
            ValueError: they are not joints of this arm, within its limits.
        """
        q, arm = np.array(q, float), self._arm
        if q.shape != (arm.n,) or not ((q >= arm.lower - ASIDE) & (q <= arm.upper + ASIDE)).all():
            raise ValueError(f"reset takes {arm.n} joints within their limits, got {q.tolist()}.")
        self.motion = self.limits.at_rest(np.clip(q, arm.lower, arm.upper))
        self._watch.reset(q)
        self._action, self.problem = np.zeros(self._decider.size), ""
        self._goal: Goal | None = None
        self._asked: tuple[Any, ...] | None = None
        self._solver: Solver | None = None
        self._goal_time = 0.0
        self._stopped = self.braking = False
        self._log.add({"reset": q.tolist()})

    def stop(self) -> None:
        """Brake, and stay at rest until `reset`."""
        self._stopped = True
        self._log.add({"stop": True})

    def step(
        self,
        q: Any,
        qd: Any,
        goal: Any,
        time: float,
        *,
        velocity: Any = None,
        obstacles: Any = None,
        picture: np.ndarray | None = None,
        joints: Any = None,
    ) -> np.ndarray:
        """Next joint command `[n]` [rad or m]; call it once in a control period.

        Args:
            q: measured joints `[n]` [rad or m]; None where no measurement has come.
            qd: their speeds `[n]` [rad/s or m/s].
            goal: position of the tool `[3]` m or, for a policy that was trained on poses, position and quaternion
                wxyz `[7]`, in the frame of the arm's base; None holds the arm.
            time: of this step [s], by any clock that does not run back.
            velocity: of the goal `[3]` [m/s]; by default from its last positions.
            obstacles: for a policy that was trained among them, a list of dicts with `position`, and for boxes and
                capsules `quaternion`, `half` and `radius`, see `Obstacles`.
            picture: the camera's, for a policy that gets one, `[84, 84]` uint8.
            joints: joints at which the tool is at the goal, where they are known; by default they are looked for.
        """
        before = self.motion.position
        problem, brake = self._watch.look(q, qd, time, before)
        wanted, refused = before, "stop() was called" if self._stopped else ""
        if not refused:
            try:
                refused = self._take(goal, time, velocity, joints)
                if self._goal is not None and not (refused or brake or self.braking):
                    wanted, refused = self._decide(self._goal, obstacles, picture)
            except Exception as error:  # whatever it is, an arm in motion is brought to rest
                refused = f"{type(error).__name__}: {error}"
        at_rest = bool((self.motion.stop_step >= self.limits.steps).all())
        was, now = self.braking and not at_rest, bool(refused or brake)
        self.problem = refused or problem or (self.problem if was else "")
        self.braking = now or was
        self.motion = self.limits.advance(self.motion, wanted, self.braking)
        command = self.motion.position
        self._log.add((q, qd, goal, time, velocity, obstacles, joints, command, self.problem))
        return command.copy()

    @property
    def goal_joints(self) -> np.ndarray | None:
        """Joints `[n]` at which the tool is at the goal, where the policy needs them and they are found."""
        return None if self._goal is None else self._goal.joints

    # --- goals --------------------------------------------------------------------------------------

    def _take(self, goal: Any, time: float, velocity: Any, joints: Any) -> str:
        """Take a goal, and say why it is refused, if it is."""
        if goal is None:
            self._goal = self._asked = None
            return ""
        facts = self._goal_facts
        try:
            numbers = np.array(goal, float)
            speed = None if velocity is None else np.array(velocity, float)
        except (TypeError, ValueError):
            return "the goal is not made of numbers"
        size = 7 if facts["orientation"] else 3
        if numbers.shape != (size,) or not np.isfinite(numbers).all():
            return f"the goal must be {size} finite numbers, got {goal!r}"
        if speed is not None and (speed.shape != (3,) or not np.isfinite(speed).all()):
            return f"the goal's velocity must be 3 finite numbers, got {velocity!r}"
        place, (low, high) = numbers[:3], self.goal_box
        if (place < low - NEARBY).any() or (place > high + NEARBY).any():
            return f"the goal {place.tolist()} is out of the workspace, {low.tolist()} to {high.tolist()} m"
        if facts["orientation"] and abs(np.linalg.norm(numbers[3:]) - 1) > 1e-2:
            return f"the goal's quaternion must have length 1, got {numbers[3:].tolist()}"
        return self._set_goal(numbers, time, speed, joints)

    def _set_goal(self, numbers: np.ndarray, time: float, velocity: np.ndarray | None, joints: Any) -> str:
        asked = (*numbers.tolist(), None if joints is None else tuple(joints))
        if self._goal_facts["moves"]:
            known = self._seen_velocity(numbers[:3], time) if velocity is None else velocity
            self._goal, self._goal_time = Goal(numbers[:3], velocity=known), time
            return ""
        if not self._goal_facts["joints"]:
            if asked != self._asked:
                self._goal, self._asked = Goal(numbers[:3]), asked
            return ""
        if asked != self._asked:
            self._asked, self._goal, self._solver = asked, None, None
            if joints is not None:
                known = np.array(joints, float)
                if known.shape != (self._arm.n,) or not np.isfinite(known).all():
                    return f"the goal's joints must be {self._arm.n} finite numbers, got {joints!r}"
                self._goal = self._goal_at(known)
                return ""
            turned = None
            if self._goal_facts["orientation"]:
                turned = Goal(numbers[:3], numbers[3:] / np.linalg.norm(numbers[3:])).rotation
            self._solver = Solver(self._arm, numbers[:3], turned, self.motion.position.copy())
        return self._look_for_joints()

    def _seen_velocity(self, place: np.ndarray, time: float) -> np.ndarray:
        """Velocity `[3]` m/s of a goal that is now at `[3]` m; nothing of one that has jumped."""
        last, passed = self._goal, time - self._goal_time
        if last is None or passed <= 0:
            return np.zeros(3)
        velocity = (place - last.position) / passed
        return velocity if np.sqrt(velocity @ velocity) <= self._goal_facts["fastest"] else np.zeros(3)

    def _look_for_joints(self) -> str:
        solver = self._solver
        if solver is None or self._goal is not None:
            return ""
        solver.advance(SOLVED_A_STEP)
        if not solver.ended:
            return ""
        if solver.joints is None:
            return "the goal is out of reach: no joints are found at which the tool is there"
        self._goal = self._goal_at(solver.joints)
        return ""

    def _goal_at(self, joints: np.ndarray) -> Goal:
        """The goal that the tool is at with joints `[n]`."""
        from_joints = self._arm.frames(joints)
        turned = quaternion_of(from_joints.rotation) if self._goal_facts["orientation"] else None
        return Goal(from_joints.position, turned, joints=joints)

    # --- decisions ----------------------------------------------------------------------------------

    def _decide(self, goal: Goal, obstacles: Any, picture: np.ndarray | None) -> tuple[np.ndarray, str]:
        """The command with which the policy goes to a goal `[n]`, and why there is none, if so."""
        rest = self.motion.position
        if self._pictured and (picture is None or np.shape(picture) != tuple(self._pictured)):
            return rest, f"the policy needs a picture of {self._pictured} pixels"
        around = None if self._decider.scene is None else Obstacles(obstacles or [])
        now = Situation(self._arm, self._watch.q, self._watch.qd, goal, rest, self._action, around, self._decider.scene)
        seen = self._decider.observe(now)
        action = np.asarray(self._act(seen, picture if self._pictured else None), float)
        wanted = self._decider.command(now, action)
        if not np.isfinite(wanted).all():
            return rest, "the policy's command is not finite"
        self._action = action
        return wanted, ""

    # --- log ----------------------------------------------------------------------------------------

    def save_log(self, file: str | Path) -> None:
        """Write the last control steps, a line of JSON each; `replay` takes them again.

        Pictures are not kept, so that a policy that gets some cannot be replayed.
        """
        self._log.save(Path(file))

    def replay(self, file: str | Path) -> float:
        """Take the control steps of a log again, and give the largest difference of a command [rad or m].

        The log has to begin with a `reset`, as it does unless it has grown too long.
        """
        worst = 0.0
        for entry in read_log(Path(file)):
            if "reset" in entry:
                self.reset(entry["reset"])
            elif "stop" in entry:
                self.stop()
            else:
                told, _ = entry.pop("command"), entry.pop("problem")
                worst = max(worst, float(np.abs(self.step(**entry) - told).max()))
        return worst
