"""What a policy observes and what its action commands, in NumPy, for one arm: as in training."""

from __future__ import annotations

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
    """Observations and joint commands of one policy's task."""

    def __init__(self, arm: Arm, facts: dict[str, Any]) -> None:
        """Of a policy's facts."""
        self._arm, self._facts, self._k = arm, facts, facts["constants"]
        self._fields = [field["name"] for field in facts["observation"]["fields"] if not field["picture"]]
        self._period, self._lag = float(facts["control_period"]), np.array(facts["arm"]["lag"], float)
        action = facts["action"]
        self._scale = np.array(action["scale"], float)
        self._low, self._high = (np.array(action[side], float) for side in ("low", "high"))
        self._held = rotation_of(np.array(facts["arm"]["held_quaternion"], float))
        self._angle_weight = float(facts["goal"]["angle_weight"])
        self.scene: Any = Scene(arm, facts["capsules"], self._k) if facts["capsules"] else None
        self._command = getattr(self, "_" + action["name"])
        self._most = np.array(facts["arm"]["speed"], float) * self._period if facts["real_time"] else np.inf
        self.size = len(self._low)

    # --- observations -------------------------------------------------------------------------------

    def observe(self, now: Situation) -> np.ndarray | None:
        """The observation's vector `[k]`, but for a picture; None where there is only that."""
        if not self._fields:
            return None
        return np.concatenate([getattr(self, "_see_" + name)(now) for name in self._fields])

    def _see_goal(self, now: Situation) -> np.ndarray:
        return now.goal.position

    def _see_tool(self, now: Situation) -> np.ndarray:
        return now.frames.position

    def _see_joints(self, now: Situation) -> np.ndarray:
        return now.q

    def _see_joint_speeds(self, now: Situation) -> np.ndarray:
        return now.qd

    def _see_lag(self, now: Situation) -> np.ndarray:
        return now.command - now.q

    def _see_way(self, now: Situation) -> np.ndarray:
        return now.way

    def _see_way_near(self, now: Situation) -> np.ndarray:
        return now.way / (now.distance + self._k["NEAR"])

    def _see_last_action(self, now: Situation) -> np.ndarray:
        return now.action

    def _see_tool_axes(self, now: Situation) -> np.ndarray:
        return now.frames.rotation.T[:2].ravel()

    def _see_goal_axes(self, now: Situation) -> np.ndarray:
        return now.goal.rotation.T[:2].ravel()

    def _see_turn(self, now: Situation) -> np.ndarray:
        return now.turn

    def _see_turn_near(self, now: Situation) -> np.ndarray:
        return now.turn / (np.sqrt(now.turn @ now.turn) + self._k["NEAR"] / self._angle_weight)

    def _see_joint_way(self, now: Situation) -> np.ndarray:
        return now.goal.joints - now.q

    def _see_goal_velocity(self, now: Situation) -> np.ndarray:
        return now.goal.velocity

    def _see_clearance(self, now: Situation) -> np.ndarray:
        return self.scene.clearance(now.around)

    def _see_scene(self, now: Situation) -> np.ndarray:
        return self.scene.basis(now.obstacles)

    def _see_achieved_goal(self, now: Situation) -> np.ndarray:
        if now.goal.quaternion is None:
            return now.frames.position
        return np.concatenate([now.frames.position, quaternion_of(now.frames.rotation)])

    def _see_desired_goal(self, now: Situation) -> np.ndarray:
        if now.goal.quaternion is None:
            return now.goal.position
        return np.concatenate([now.goal.position, now.goal.quaternion])

    # --- actions ------------------------------------------------------------------------------------

    def command(self, now: Situation, action: np.ndarray) -> np.ndarray:
        """Joint command `[n]` that an action `[a]` asks for, no faster than the joints can follow."""
        wanted = self._command(now, action)
        return np.minimum(np.maximum(wanted, now.command - self._most), now.command + self._most)

    def _tool_delta(self, now: Situation, action: np.ndarray) -> np.ndarray:
        return self._arm.displaced(now.command, action * self._scale, self._held)

    _tool_step = _tool_delta

    def _joint_delta(self, now: Situation, action: np.ndarray) -> np.ndarray:
        step = action * self._scale
        if now.obstacles is not None:
            step = self.scene.keep_clear(now.sent, now.around_sent, step)
            step = np.minimum(np.maximum(step, -self._scale), self._scale)
        return np.minimum(np.maximum(now.command + step, self._arm.lower), self._arm.upper)

    def _joint_residual(self, now: Situation, action: np.ndarray) -> np.ndarray:
        corrected = self._towards(now) + self._worth(now) * action
        return self._joint_delta(now, np.minimum(np.maximum(corrected, self._low), self._high))

    def _worth(self, now: Situation) -> float:
        k, away = self._k, now.distance
        if now.goal.velocity is not None:
            return k["MOVING_CORRECTION"]
        if now.goal.quaternion is not None:
            away += self._angle_weight * _angle(now.turn)
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
        k, period, speed = self._k, self._period, self._arm.speed
        way = now.goal.joints - now.q
        far = np.minimum(np.abs(way) / k["APPROACH_ANGLE"], 1.0)
        share = k["JOINT_NEAR"] + far * (k["JOINT_FAR"] - k["JOINT_NEAR"])
        rate = np.minimum(share / np.maximum(self._lag, k["TINY"]), 1 / period)
        asked = np.minimum(np.maximum(rate * way, -speed), speed)
        step = period * asked + far * k["FORESIGHT"] * self._lag * (asked - now.qd)
        return self._in_box(step)

    def _to_point(self, now: Situation) -> np.ndarray:
        k, lag = self._k, self._lag
        far = min(now.distance / k["APPROACH"], 1.0)
        caught_up = now.q + far * lag * now.qd
        gain = k["NEAR_GAIN"] + far * (k["FAR_GAIN"] - k["NEAR_GAIN"])
        share = min(gain * self._period / max(lag.max(), k["TINY"]), 1.0)
        return self._point_step(now, caught_up, now.goal.position, share)

    def _with_point(self, now: Situation) -> np.ndarray:
        lag = self._lag
        ahead = now.goal.position + (lag.max() + self._k["LEAD"] * self._period) * now.goal.velocity
        return self._point_step(now, now.q + lag * now.qd, ahead, 1.0)

    def _point_step(self, now: Situation, caught_up: np.ndarray, place: np.ndarray, share: float) -> np.ndarray:
        frames = self._arm.frames(caught_up)
        wanted = share * (place - frames.position)
        most = self._k["TOOL_SPEED"] * self._period / (np.sqrt(wanted @ wanted) + self._k["TINY"])
        return self._in_box(self._arm.point_step(frames, now.command, wanted * min(most, 1.0)))

    def _in_box(self, step: np.ndarray) -> np.ndarray:
        return np.minimum(np.maximum(step / self._scale, self._low), self._high)


def _angle(turn: np.ndarray) -> float:
    """Angle [rad] of a rotation error, which is twice the sine of its half."""
    return 2 * float(np.arcsin(min(np.sqrt(turn @ turn) / 2, 1.0)))
