"""A node of ROS 2 that runs an exported policy: measured joints and goals come in, joint commands go out."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.deploy.check import read_facts, start_controller
from reachlab.deploy.markers import from_markers
from reachlab.deploy.topics import Topics
from reachlab.settings.validation import InputError, installing

EARLY = 0.25
"""Share of a control period by which a measurement may come before its time and still begins a control step."""

RECENT = 0.2
"""Time between two poses of an object from which its velocity follows, and age of a wrench, at most [s]."""

TICKS = 8
"""How often in a control period the node looks whether it is time for a step without a new measurement."""

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""Variable that says where nodes look for each other."""


@contextlib.contextmanager
def ros2() -> Iterator[Any]:
    """The package rclpy, between its begin and its end. Nodes of this machine alone are found, unless told otherwise.

    Raises:
        InputError: it is not installed.
    """
    os.environ.setdefault(RANGE, "LOCALHOST")
    try:
        import rclpy
    except ModuleNotFoundError:
        raise InputError(
            f"this needs ROS 2's Python: source its setup, or {installing('ros2')} for tests on one machine."
        ) from None
    rclpy.init(args=[])
    try:
        yield rclpy
    finally:
        rclpy.try_shutdown()


def run_node(folder: Path, topics: Topics, *, trajectory: bool) -> None:
    """Run the node until it is interrupted.

    Raises:
        InputError: ROS 2 is missing, or the folder is none that was exported.
    """
    controller, facts = start_controller(folder, feels=True), read_facts(folder)
    sees = "bodies_kind" in facts["inputs"] and facts["inputs"]["bodies_kind"] != [len(facts.get("objects", []))]
    needs = {"sees": sees, "feels": "wrench" in facts["inputs"]}
    with ros2() as rclpy:
        node = PolicyNode(rclpy.create_node("reachlab_policy"), controller, topics, trajectory=trajectory, **needs)
        with contextlib.suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
            rclpy.spin(node.node)


class PolicyNode:
    """Steps a controller as measurements come, at the policy's rate.

    Commands stream to a forward position controller. A trajectory of one point is the alternative for arms without
    one: a trajectory controller starts a new spline at each, from where it believes the arm to be, which adds lag of
    its own that the policy was not trained with.
    """

    def __init__(
        self,
        node: Any,
        controller: Any,
        topics: Topics,
        *,
        trajectory: bool,
        sees: bool = False,
        feels: bool = False,
    ) -> None:
        """The policy's side of a node of rclpy: of a policy that has to be told of obstacles or the wrench, or not."""
        from geometry_msgs.msg import PoseStamped, WrenchStamped
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Empty, Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory

        self.node, self._controller, self._trajectory = node, controller, trajectory
        self._goal: list[float] | None = None
        self._topics, self._objects = topics, list[dict[str, Any]]()
        self._obstacles: list[dict[str, Any]] | None = None if sees else []
        self._measured: tuple[np.ndarray, np.ndarray] | None = None
        self._wrench: tuple[float, list[float]] | None = None
        self._due, self._told = 0.0, ""
        self._resets = True  # commands begin where the arm is
        kind, topic = (JointTrajectory, topics.trajectories) if trajectory else (Float64MultiArray, topics.commands)
        self._publisher = node.create_publisher(kind, topic, 1)
        node.create_subscription(JointState, topics.joint_states, self._on_joints, qos_profile_sensor_data)
        node.create_subscription(PoseStamped, topics.goals, self._on_goal, 1)
        node.create_subscription(PoseStamped, topics.objects, self._on_object, qos_profile_sensor_data)
        if sees:
            from visualization_msgs.msg import MarkerArray

            node.create_subscription(MarkerArray, topics.obstacles, self._on_obstacles, qos_profile_sensor_data)
        if feels:
            node.create_subscription(WrenchStamped, topics.wrenches, self._on_wrench, qos_profile_sensor_data)
        node.create_subscription(Empty, topics.reset, self._on_reset, 1)
        node.create_subscription(Empty, topics.stop, lambda _: controller.stop(), 1)
        node.create_timer(controller.period / TICKS, self._on_tick)

    def _on_reset(self, _: Any) -> None:
        self._resets, self._measured = True, None

    def _on_goal(self, message: Any) -> None:
        place, turn = message.pose.position, message.pose.orientation
        goal = [place.x, place.y, place.z]
        if self._controller.asks_orientation:
            goal += [turn.w, turn.x, turn.y, turn.z]
        self._goal = goal

    def _on_object(self, message: Any) -> None:
        """Keep where the object was seen, and its velocity if it was seen just before."""
        place, turn, stamp = message.pose.position, message.pose.orientation, message.header.stamp
        age = self.node.get_clock().now().nanoseconds / 1e9 - stamp.sec - stamp.nanosec / 1e9
        position, seen = np.array([place.x, place.y, place.z]), time.monotonic() - max(age, 0.0)
        now = {"position": position, "quaternion": np.array([turn.w, turn.x, turn.y, turn.z]), "time": seen}
        for before in self._objects:
            if 0.0 < (since := seen - before["time"]) < RECENT:
                now["velocity"] = (position - before["position"]) / since
        self._objects = [now]

    def _on_obstacles(self, message: Any) -> None:
        self._obstacles = from_markers(message, time.monotonic())

    def _on_wrench(self, message: Any) -> None:
        force, torque = message.wrench.force, message.wrench.torque
        self._wrench = time.monotonic(), [force.x, force.y, force.z, torque.x, torque.y, torque.z]

    def _on_joints(self, message: Any) -> None:
        try:
            rows = [message.name.index(name) for name in self._controller.joints]
            speeds = message.velocity or [0.0] * len(message.position)
            q, qd = (np.array([part[row] for row in rows]) for part in (message.position, speeds))
            self._measured = q, qd
        except (ValueError, IndexError):
            self._measured = (np.array(message.position), np.array(message.velocity))
        if time.monotonic() >= self._due - EARLY * self._controller.period:
            self._step()

    def _on_tick(self) -> None:
        if self._due and time.monotonic() >= self._due + EARLY * self._controller.period:
            self._step()

    def _step(self) -> None:
        controller, now = self._controller, time.monotonic()
        late = now - self._due > controller.period
        self._due = now + controller.period if late else self._due + controller.period
        measured, self._measured = self._measured, None
        q, qd = measured or (None, None)
        if not self._begin(q):
            return
        beside: dict[str, Any] = {"objects": self._objects} if self._objects else {}
        if self._obstacles:
            beside["obstacles"] = self._obstacles
        if self._wrench and now - self._wrench[0] < RECENT:
            beside["wrench"] = self._wrench[1]
        command = controller.step(q, qd, None if self._obstacles is None else self._goal, now, **beside)
        missing = "" if self._goal else f"goal has come on '{self._topics.goals}'"
        missing = f"obstacles have come on '{self._topics.obstacles}'" if self._obstacles is None else missing
        waiting = missing and f"no {missing}, and the arm is held where it is"
        self._tell(controller.problem if controller.braking else waiting)
        self._publish(command)

    def _begin(self, q: np.ndarray | None) -> bool:
        """Begin anew where the arm is measured, if that is asked for; whether there is anything to control."""
        controller = self._controller
        if not self._resets or q is None:
            return not self._resets
        inside = q.shape == controller.home.shape and np.isfinite(q).all()
        if inside and ((q >= controller.limits.lower) & (q <= controller.limits.upper)).all():
            controller.reset(q)
            self._goal, self._resets, self._told = None, False, ""
            return True
        self._tell("waiting: the arm is not measured within its limits")
        return False

    def _tell(self, problem: str) -> None:
        """Write into the log what is wrong, once."""
        if problem != self._told:
            self._told = problem
            self.node.get_logger().warning(problem or "all is well again")

    def _publish(self, command: np.ndarray) -> None:
        if not self._trajectory:
            from std_msgs.msg import Float64MultiArray

            self._publisher.publish(Float64MultiArray(data=command.tolist()))
            return
        from rclpy.duration import Duration
        from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

        point = JointTrajectoryPoint(positions=command.tolist())
        point.time_from_start = Duration(seconds=self._controller.period).to_msg()
        self._publisher.publish(JointTrajectory(joint_names=self._controller.joints, points=[point]))
