"""A node of ROS 2 that runs an exported policy: measured joints and goals come in, joint commands go out."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.deploy.card import sees
from reachlab.deploy.check import EARLY, read_facts, start_controller
from reachlab.deploy.markers import from_markers
from reachlab.deploy.said import Said
from reachlab.deploy.seen import RECENT, seen
from reachlab.deploy.topics import Topics
from reachlab.settings.validation import InputError, needing

SLOW = 0.1
"""Speed below which an arm is measured to rest [rad/s or m/s]."""

OLD = 0.06
"""Age of measured joints from which on they are not used [s]."""

SILENT = 2.0
"""Time without joints after which the log says so [s]."""

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
    with needing("this needs ROS 2's Python: source its setup, or {} for tests on one machine.", "ros2"):
        import rclpy
    rclpy.init(args=[])
    try:
        yield rclpy
    finally:
        rclpy.try_shutdown()


def run_node(
    folder: Path, topics: Topics, *, trajectory: bool, joint_names: Sequence[str] = (), frame: str = ""
) -> None:
    """Run the node until it is interrupted; joints have the policy's names, or those that are given in their place.

    Raises:
        InputError: ROS 2 is missing, the folder is none that was exported, or there are not as many names as joints.
    """
    controller, facts = start_controller(folder, feels=True), read_facts(folder)
    if joint_names and len(joint_names) != len(controller.joints):
        raise InputError(
            f"{len(joint_names)} joint names are given, and the policy has {', '.join(controller.joints)}."
        )
    needs = {"sees": sees(facts), "feels": "wrench" in facts["inputs"], "fastest": facts["goal"].get("fastest", 0.0)}
    needs |= {"names": joint_names or controller.joints, "frame": frame}
    with ros2() as rclpy:
        node = PolicyNode(rclpy.create_node("reachlab_policy"), controller, topics, trajectory=trajectory, **needs)
        topic = node.node.resolve_topic_name(topics.joint_states)
        said = f"{folder} waits for {', '.join(needs['names'])} on '{topic}', to command them each"
        node.node.get_logger().info(f"{said} {1000 * controller.period:g} ms")
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
        names: Sequence[str] = (),
        frame: str = "",
        sees: bool = False,
        feels: bool = False,
        fastest: float = 0.0,
    ) -> None:
        """The policy's side of a node of rclpy.

        Args:
            node: the node.
            controller: of the policy.
            topics: names of topics.
            trajectory: commands are trajectories.
            names: of the joints in messages, in the policy's order; by default the policy's.
            frame: of places in messages, see `goal.frame` in policy.json; by default the first that one of them names.
            sees: the policy has to be told of obstacles.
            feels: it has to be told of the wrench.
            fastest: its goals move, and so fast at most [m/s]; one that was faster has jumped.
        """
        from geometry_msgs.msg import PoseStamped, WrenchStamped
        from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Empty, Float64MultiArray, String
        from trajectory_msgs.msg import JointTrajectory

        self.node, self._controller, self._trajectory = node, controller, trajectory
        self._names, self._fastest, self._sees, self._frame = list(names or controller.joints), fastest, sees, frame
        self._goal = self._goal_seen = self._joints_seen = self._object_seen = None
        self._topics, self._objects = topics, list[dict[str, Any]]()
        self._obstacles: list[dict[str, Any]] | None = None if sees else []
        self._measured: tuple[np.ndarray, np.ndarray] | None = None
        self._wrench: tuple[float, list[float]] | None = None
        self._due, self._start = 0.0, time.monotonic()
        self._resets, self._begun, self._stops = True, False, False  # commands begin where the arm is
        self._sent, self._rests = controller.home, True
        kind, topic = (JointTrajectory, topics.trajectories) if trajectory else (Float64MultiArray, topics.commands)
        self._publisher, self._asked = node.create_publisher(kind, topic, 1), None
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._reached = node.create_publisher(PoseStamped, topics.reached, kept)
        problems = node.create_publisher(String, topics.problems, kept)
        self._said = Said(node.get_logger().warning, lambda problem: problems.publish(String(data=problem)))
        node.create_subscription(JointState, topics.joint_states, self._on_joints, qos_profile_sensor_data)
        node.create_subscription(PoseStamped, topics.goals, self._on_goal, 1)
        node.create_subscription(PoseStamped, topics.objects, self._on_object, qos_profile_sensor_data)
        if sees:
            from visualization_msgs.msg import MarkerArray

            node.create_subscription(MarkerArray, topics.obstacles, self._on_obstacles, qos_profile_sensor_data)
        if feels:
            node.create_subscription(WrenchStamped, topics.wrenches, self._on_wrench, qos_profile_sensor_data)
        node.create_subscription(Empty, topics.reset, self._on_reset, 1)
        node.create_subscription(Empty, topics.stop, self._on_stop, 1)
        node.create_timer(controller.period / TICKS, self._on_tick)

    def _on_reset(self, _: Any) -> None:
        """Begin anew once the arm rests, to which it is brought if it moves."""
        self._resets, self._stops, self._measured = True, False, None
        self._goal = self._goal_seen = self._asked = None
        self._controller.stop()

    def _on_stop(self, _: Any) -> None:
        """Brake, also where a reset was asked for just before."""
        self._stops = True
        self._controller.stop()

    def _age(self, stamp: Any) -> float:
        """Age of what has a stamp [s]; 0 without one."""
        seconds = stamp.sec + stamp.nanosec / 1e9
        return max(self.node.get_clock().now().nanoseconds / 1e9 - seconds, 0.0) if seconds else 0.0

    def _foreign(self, header: Any) -> bool:
        """Whether a place is one in another frame than the first, and so of no use."""
        named = header.frame_id
        self._frame = self._frame or named
        if foreign := named not in {"", self._frame}:
            said = f"places in frame '{named}' are not used, but those in '{self._frame}': see --frame"
            self._said.once(named, said)
        return foreign

    def _on_goal(self, message: Any) -> None:
        if self._foreign(message.header):
            return
        place, turn = message.pose.position, message.pose.orientation
        goal = [place.x, place.y, place.z]
        if self._fastest:
            self._goal_seen = seen(goal, time.monotonic() - self._age(message.header.stamp), self._goal_seen)
        if self._controller.asks_orientation:
            goal += [turn.w, turn.x, turn.y, turn.z]
        self._goal, self._asked = goal, message

    def _on_object(self, message: Any) -> None:
        """Keep where the object was seen, and its velocity if it was seen just before."""
        if self._foreign(message.header):
            return
        place, turn, when = message.pose.position, message.pose.orientation, time.monotonic()
        before = self._object_seen
        now = self._object_seen = seen([place.x, place.y, place.z], when - self._age(message.header.stamp), before)
        turned = np.array([turn.w, turn.x, turn.y, turn.z])
        self._objects = [{"position": now.place, "quaternion": turned, "time": now.time}]
        if before and 0.0 < now.time - before.time < RECENT:
            self._objects[0]["velocity"] = now.velocity

    def _on_obstacles(self, message: Any) -> None:
        if any(self._foreign(marker.header) for marker in message.markers):
            return
        try:
            self._obstacles = from_markers(message, time.monotonic())
        except ValueError as error:
            self._obstacles = None
            self._said.once("marker", f"obstacles are spheres, cubes and cylinders, and {error}: none of them is used")

    def _on_wrench(self, message: Any) -> None:
        force, torque = message.wrench.force, message.wrench.torque
        when = time.monotonic() - self._age(message.header.stamp)
        self._wrench = when, [force.x, force.y, force.z, torque.x, torque.y, torque.z]

    def _on_joints(self, message: Any) -> None:
        """Keep what is measured, of a message of all joints that is not old; of others there is none."""
        now, age = time.monotonic(), self._age(message.header.stamp)
        places, speeds = (dict(zip(message.name, part, strict=False)) for part in (message.position, message.velocity))
        lacking = ", ".join(name for name in self._names if name not in places)
        if lacking:
            said = f"joint states without {lacking} are not used: are joints called otherwise, see --joint-names?"
            self._said.once(lacking, said)
            return
        if age > OLD:
            self._said.once("old", f"joint states are {age:.2g} s old by their stamps, and not used: do clocks differ?")
            return
        self._joints_seen = seen([places[name] for name in self._names], now - age, self._joints_seen)
        told = np.array([speeds.get(name, np.nan) for name in self._names])
        self._measured = self._joints_seen.place, np.where(np.isfinite(told), told, self._joints_seen.velocity)
        if now >= self._due - EARLY * self._controller.period:
            self._step()

    def _on_tick(self) -> None:
        if self._joints_seen is None and time.monotonic() > self._start + SILENT:
            said = f"no joint states have come on '{self._topics.joint_states}': is it called otherwise, or its domain?"
            self._said.once("silent", said)
        if self._due and time.monotonic() >= self._due + EARLY * self._controller.period:
            self._step()

    def _step(self) -> None:
        controller, now = self._controller, time.monotonic()
        late = now - self._due > controller.period
        self._due = now + controller.period if late else self._due + controller.period
        measured, self._measured = self._measured, None
        q, qd = measured or (None, None)
        waits = self._begin(q, qd) if self._resets else ""
        if not self._begun:
            self._said.step(waits)
            return
        beside: dict[str, Any] = {"objects": self._objects} if self._objects else {}
        if self._sees and self._obstacles is not None:
            beside["obstacles"] = self._obstacles
        if self._wrench and now - self._wrench[0] < RECENT:
            beside["wrench"] = self._wrench[1]
        if self._goal_seen:
            velocity = self._goal_seen.velocity
            moves = now - self._goal_seen.time < RECENT and np.linalg.norm(velocity) <= self._fastest
            beside["velocity"] = velocity * moves
        command = controller.step(q, qd, None if self._obstacles is None else self._goal, now, **beside)
        self._rests, self._sent = np.array_equal(command, self._sent), command
        self._tell(waits)
        self._publish(command)

    def _begin(self, q: np.ndarray | None, qd: np.ndarray | None) -> str:
        """Begin anew where the arm is measured to rest; why that is not done yet, if so."""
        if q is None or qd is None:
            return self._said.state
        if not (self._rests and np.abs(qd).max() <= SLOW):
            return "waiting: the arm is not measured to rest"
        try:
            self._controller.reset(q)
        except ValueError as error:
            return f"waiting: {error}"
        if self._stops:
            self._controller.stop()
        self._resets, self._begun, self._sent = False, True, q
        return ""

    def _tell(self, waits: str) -> None:
        """Write into the log what is wrong, and publish a goal that is reached, once."""
        controller = self._controller
        missing = "" if self._goal else f"goal has come on '{self._topics.goals}'"
        missing = f"obstacles have come on '{self._topics.obstacles}'" if self._obstacles is None else missing
        if missing and not (waits or controller.braking):
            waits = f"no {missing}, and the arm is held where it is"
        self._said.step(waits or controller.problem, at_once=controller.braking or bool(waits))
        arrival = getattr(controller, "arrival", None)  # the folder's own controller may be an old one
        if self._asked and arrival and arrival.reached:
            self._reached.publish(self._asked)
            self._asked = None

    def _publish(self, command: np.ndarray) -> None:
        if not self._trajectory:
            from std_msgs.msg import Float64MultiArray

            self._publisher.publish(Float64MultiArray(data=command.tolist()))
            return
        from rclpy.duration import Duration
        from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

        point = JointTrajectoryPoint(positions=command.tolist())
        point.time_from_start = Duration(seconds=self._controller.period).to_msg()
        self._publisher.publish(JointTrajectory(joint_names=self._names, points=[point]))
