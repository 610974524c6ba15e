"""What a policy observes and what its action commands, in NumPy, for one arm: as in training."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from reachlab.deploy.onboard.arm import Arm, quaternion_of, rotation_error, rotation_of
from reachlab.deploy.onboard.scene import Nearest, Scene


class Goal:
    """Where the tool is asked to be.

    Attributes:
        position: `[3]` [m].
        quaternion: `[4]`, wxyz; None where any orientation will do.
        rotation: its axes as columns `[3, 3]`.
        velocity: `[3]` [m/s]; None where it does not move.
        joints: at which the tool is there `[n]`; None where they are not needed.
    """

    def __init__(
        self,
        position: np.ndarray,
        quaternion: np.ndarray | None = None,
        velocity: np.ndarray | None = None,
        joints: np.ndarray | None = None,
    ) -> None:
        """A goal; what a policy does not need may be left out."""
        self.velocity: Any
        self.joints: Any
        self.position, self.quaternion, self.velocity, self.joints = position, quaternion, velocity, joints
        self.rotation = np.eye(3) if quaternion is None else rotation_of(quaternion)


class Situation:
    """What is known in a control step: the measured joints, the goal, the last command and action, the obstacles."""

    def __init__(
        self,
        arm: Arm,
        q: np.ndarray,
        qd: np.ndarray,
        goal: Goal,
        command: np.ndarray,
        action: np.ndarray,
        obstacles: Any,
        scene: Any,
    ) -> None:
        """A situation; where the tool is follows, and in a scene what is around the arm as it is and as it is sent."""
        self.q, self.qd, self.goal, self.command, self.action = q, qd, goal, command, action
        self.obstacles = obstacles
        if scene is None:
            self.frames = arm.frames(q)
        else:
            both = arm.frames(np.stack([q, command]))
            self.frames, self.sent = both.row(0), both.links[1]
            self.around, self.around_sent = (Nearest(*row) for row in zip(*scene.nearest(both.links, obstacles)))
        self.way = goal.position - self.frames.position
        self.distance = float(np.sqrt(self.way @ self.way))
        self.turn = np.zeros(3) if goal.quaternion is None else rotation_error(self.frames.rotation, goal.rotation)


class Decider:
    """Observations and joint commands of one policy's task.

    Attributes:
        k: constants of its formulas.
        angle_weight: length for which an angle of 1 counts [m/rad].
        scene: what the arm has to know of itself among obstacles; None where there are none.
        size: numbers of an action.
    """

    def __init__(self, arm: Arm, facts: dict[str, Any]) -> None:
        """Of a policy's facts."""
        self._arm, self._facts, self.k = arm, facts, facts["constants"]
        self._fields = [field["name"] for field in facts["observation"]["fields"] if not field["picture"]]
        self._period, self._lag = float(facts["control_period"]), np.array(facts["arm"]["lag"], float)
        action = facts["action"]
        self._scale = np.array(action["scale"], float)
        self._low, self._high = (np.array(action[side], float) for side in ("low", "high"))
        self._held = rotation_of(np.array(facts["arm"]["held_quaternion"], float))
        self.angle_weight = float(facts["goal"]["angle_weight"])
        self.scene: Any = Scene(arm, facts["capsules"], self.k) if facts["capsules"] else None
        self._design = COMMANDED[action["name"]]
        self._most = arm.speed * self._period if facts["real_time"] else np.inf
        self.size = len(self._low)

    def observe(self, now: Situation) -> np.ndarray | None:
        """The observation's vector `[k]`, but for a picture; None where there is only that."""
        if not self._fields:
            return None
        return np.concatenate([OBSERVED[name](self, now) for name in self._fields])

    # --- actions ------------------------------------------------------------------------------------

    def command(self, now: Situation, action: np.ndarray) -> np.ndarray:
        """Joint command `[n]` that an action `[a]` asks for, no faster than the joints can follow."""
        wanted = self._design(self, now, action)
        return np.minimum(np.maximum(wanted, now.command - self._most), now.command + self._most)

    def move_tool(self, now: Situation, action: np.ndarray) -> np.ndarray:
        """The tool's command displaced, its orientation held."""
        return self._arm.displaced(now.command, action * self._scale, self._held)

    def move_joints(self, now: Situation, action: np.ndarray) -> np.ndarray:
        """Every joint's command displaced, as far as obstacles allow."""
        step = action * self._scale
        if now.obstacles is not None:
            step = self.scene.keep_clear(now.sent, now.around_sent, step)
            step = np.minimum(np.maximum(step, -self._scale), self._scale)
        return np.minimum(np.maximum(now.command + step, self._arm.lower), self._arm.upper)

    def correct_joints(self, now: Situation, action: np.ndarray) -> np.ndarray:
        """The same, added to what inverse kinematics would do."""
        corrected = self._towards(now) + self._worth(now) * action
        return self.move_joints(now, np.minimum(np.maximum(corrected, self._low), self._high))

    def _worth(self, now: Situation) -> float:
        k, away = self.k, now.distance
        if now.goal.velocity is not None:
            return k["MOVING_CORRECTION"]
        if now.goal.quaternion is not None:
            away += self.angle_weight * _angle(now.turn)
        most = k["CORRECTION"] if now.goal.joints is None else k["POSE_CORRECTION"]
        if now.obstacles is not None:
            most = k["CLUTTER_CORRECTION"]
        return most * min((away / k["CORRECTION_FADE"]) ** 2, 1.0)

    def _towards(self, now: Situation) -> np.ndarray:
        """What inverse kinematics would do, in actions `[n]`."""
        if now.goal.joints is not None:
            return self._to_joints(now)
        return self._to_point(now) if now.goal.velocity is None else self._with_point(now)

    def _to_joints(self, now: Situation) -> np.ndarray:
        k, period, speed = self.k, self._period, self._arm.speed
        way = now.goal.joints - now.q
        far = np.minimum(np.abs(way) / k["APPROACH_ANGLE"], 1.0)
        share = k["JOINT_NEAR"] + far * (k["JOINT_FAR"] - k["JOINT_NEAR"])
        rate = np.minimum(share / np.maximum(self._lag, k["TINY"]), 1 / period)
        asked = np.minimum(np.maximum(rate * way, -speed), speed)
        step = period * asked + far * k["FORESIGHT"] * self._lag * (asked - now.qd)
        return self._in_box(step)

    def _to_point(self, now: Situation) -> np.ndarray:
        k, lag = self.k, self._lag
        far = min(now.distance / k["APPROACH"], 1.0)
        caught_up = now.q + far * lag * now.qd
        gain = k["NEAR_GAIN"] + far * (k["FAR_GAIN"] - k["NEAR_GAIN"])
        share = min(gain * self._period / max(lag.max(), k["TINY"]), 1.0)
        return self._point_step(now, caught_up, now.goal.position, share)

    def _with_point(self, now: Situation) -> np.ndarray:
        lag = self._lag
        ahead = now.goal.position + (lag.max() + self.k["LEAD"] * self._period) * now.goal.velocity
        return self._point_step(now, now.q + lag * now.qd, ahead, 1.0)

    def _point_step(self, now: Situation, caught_up: np.ndarray, place: np.ndarray, share: float) -> np.ndarray:
        frames = self._arm.frames(caught_up)
        wanted = share * (place - frames.position)
        most = self.k["TOOL_SPEED"] * self._period / (np.sqrt(wanted @ wanted) + self.k["TINY"])
        return self._in_box(self._arm.point_step(frames, now.command, wanted * min(most, 1.0)))

    def _in_box(self, step: np.ndarray) -> np.ndarray:
        return np.minimum(np.maximum(step / self._scale, self._low), self._high)


def _angle(turn: np.ndarray) -> float:
    """Angle [rad] of a rotation error, which is twice the sine of its half."""
    return 2 * float(np.arcsin(min(np.sqrt(turn @ turn) / 2, 1.0)))


def _posed(quaternion: np.ndarray | None, position: np.ndarray, turned: Callable[[], Any]) -> np.ndarray:
    """A position, and where the goal has an orientation a quaternion too."""
    return position if quaternion is None else np.concatenate([position, turned()])


OBSERVED: dict[str, Callable[[Decider, Situation], np.ndarray]] = {
    "goal": lambda _, now: now.goal.position,
    "tool": lambda _, now: now.frames.position,
    "joints": lambda _, now: now.q,
    "joint_speeds": lambda _, now: now.qd,
    "lag": lambda _, now: now.command - now.q,
    "way": lambda _, now: now.way,
    "way_near": lambda decider, now: now.way / (now.distance + decider.k["NEAR"]),
    "last_action": lambda _, now: now.action,
    "tool_axes": lambda _, now: now.frames.rotation.T[:2].ravel(),
    "goal_axes": lambda _, now: now.goal.rotation.T[:2].ravel(),
    "turn": lambda _, now: now.turn,
    "turn_near": lambda decider, now: (
        now.turn / (np.sqrt(now.turn @ now.turn) + decider.k["NEAR"] / decider.angle_weight)
    ),
    "joint_way": lambda _, now: now.goal.joints - now.q,
    "goal_velocity": lambda _, now: now.goal.velocity,
    "clearance": lambda decider, now: decider.scene.clearance(now.around),
    "scene": lambda decider, now: decider.scene.basis(now.obstacles),
    "achieved_goal": lambda _, now: _posed(
        now.goal.quaternion, now.frames.position, lambda: quaternion_of(now.frames.rotation)
    ),
    "desired_goal": lambda _, now: _posed(now.goal.quaternion, now.goal.position, lambda: now.goal.quaternion),
}
"""What an observation may hold, by the name of its field: numbers `[k]` of a situation."""

COMMANDED: dict[str, Callable[[Decider, Situation, np.ndarray], np.ndarray]] = {
    "tool_delta": Decider.move_tool,
    "tool_step": Decider.move_tool,
    "joint_delta": Decider.move_joints,
    "joint_residual": Decider.correct_joints,
}
"""Action designs by name: the joint command `[n]` of an action `[a]`."""
