"""The check of an exported policy over ROS 2: the plant is a node here, the policy's node another process."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.deploy.check import PATIENCE, read_facts, settings_of
from reachlab.deploy.markers import to_markers
from reachlab.deploy.plant import Measurement, Outcome, Plant, drive
from reachlab.deploy.plant_faults import Faults
from reachlab.deploy.ros2 import ros2
from reachlab.deploy.topics import Topics
from reachlab.settings.validation import InputError

THERE = 1e-3
"""The policy's node has taken the arm over when it sends it where it is, to so much [rad or m]."""

TOLD_EVERY, ASKED_EVERY = 0.015, 1.0
"""Time between two measurements, and between two resets, while the policy's node takes the arm over [s]."""


def check_over_ros2(folder: Path, *, sim: str | None, episodes: int, seed: int, faults: Faults) -> Outcome:
    """Play held-out episodes in real time, with real messages between two nodes in two processes.

    Raises:
        InputError: ROS 2 is missing, or the policy's node does not start.
    """
    config, facts = settings_of(folder, sim), read_facts(folder)
    topics = own_topics()
    with ros2() as rclpy:
        plant = Plant(config, seed)
        node = rclpy.create_node("reachlab_plant")
        link = RosLink(node, [joint["name"] for joint in facts["joints"]], topics, moves=facts["goal"]["moves"])
        executor = rclpy.executors.SingleThreadedExecutor()
        executor.add_node(node)
        spinning = threading.Thread(target=executor.spin, daemon=True)
        spinning.start()
        try:
            with _policy_node(folder, topics):
                return drive(plant, link, faults, episodes)
        finally:
            executor.shutdown()
            spinning.join(5)
            plant.close()


def own_topics() -> Topics:
    """Topics of this process alone: neither an arm that is there nor another check hears of them."""
    return Topics(**{name: f"reachlab_check_{os.getpid()}/{topic}" for name, topic in vars(Topics()).items()})


@contextlib.contextmanager
def _policy_node(folder: Path, topics: Topics) -> Iterator[None]:
    """The policy's node as a user starts it."""
    named = [word for name, topic in vars(topics).items() for word in (f"--{name.replace('_', '-')}", topic)]
    words = [sys.executable, "-m", "reachlab", "deploy", "ros2", str(folder), *named]
    process = subprocess.Popen(words)  # noqa: S603
    try:
        yield
    finally:
        process.terminate()
        process.wait(10)


class RosLink:
    """Topics to the policy's node, see `Link`."""

    problem = ""
    """What the policy's node says is in its log."""

    def __init__(self, node: Any, joints: list[str], topics: Topics, *, moves: bool) -> None:
        """The plant's side of a node of rclpy, whose messages come in another thread; its goals may move."""
        from geometry_msgs.msg import PoseStamped, WrenchStamped
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Empty, Float64MultiArray
        from visualization_msgs.msg import MarkerArray

        self._joints, self._node, self._moves = joints, node, moves
        self._states = node.create_publisher(JointState, topics.joint_states, 1)
        self._goals = node.create_publisher(PoseStamped, topics.goals, 1)
        self._objects = node.create_publisher(PoseStamped, topics.objects, 1)
        self._obstacles = node.create_publisher(MarkerArray, topics.obstacles, 1)
        self._wrenches = node.create_publisher(WrenchStamped, topics.wrenches, 1)
        self._resets = node.create_publisher(Empty, topics.reset, 1)
        node.create_subscription(Float64MultiArray, topics.commands, self._on_command, 1)
        self._commands: list[np.ndarray] = []
        self._asked: list[float] | None = None

    def _on_command(self, message: Any) -> None:
        self._commands.append(np.array(message.data))

    def begin(self, q: np.ndarray) -> None:
        """Tell where the arm rests until the policy's node has taken it over, and has no goal.

        Raises:
            InputError: it does not in time.
        """
        self._asked = None
        end, asked = time.monotonic() + PATIENCE, 0.0
        still = np.zeros_like(q)
        while time.monotonic() < end:
            if time.monotonic() - asked > ASKED_EVERY:
                asked = time.monotonic()
                self.receive()
                self._resets.publish(self._resets.msg_type())
            self._publish(q, still)
            time.sleep(TOLD_EVERY)
            if (commands := self.receive()) and np.abs(commands[-1] - q).max() < THERE:
                return
        raise InputError(f"the policy's node does not take the arm over within {PATIENCE:g} s.")

    def send(self, measurement: Measurement) -> None:
        """Publish a measurement, and the goal where it is new or moves."""
        if measurement.goal and (self._moves or measurement.goal != self._asked):
            self._asked = measurement.goal
            self._goals.publish(self._pose(measurement.goal))
        for one in measurement.beside.get("objects", []):
            self._objects.publish(self._pose([*one["position"], *one["quaternion"]]))
        self._obstacles.publish(to_markers(measurement.beside["obstacles"]))
        if wrench := measurement.beside.get("wrench"):
            self._wrenches.publish(self._felt(wrench))
        self._publish(measurement.q, measurement.qd)

    def _felt(self, numbers: list[float]) -> Any:
        """A wrench [N, Nm] as a message."""
        message = self._wrenches.msg_type()
        force, torque = message.wrench.force, message.wrench.torque
        force.x, force.y, force.z, torque.x, torque.y, torque.z = numbers
        message.header.stamp = self._node.get_clock().now().to_msg()
        return message

    def _pose(self, numbers: list[float]) -> Any:
        """A position [m], and a quaternion wxyz where there is one, as a message."""
        message = self._goals.msg_type()
        place, turn = message.pose.position, message.pose.orientation
        place.x, place.y, place.z = numbers[:3]
        if len(numbers) > 3:
            turn.w, turn.x, turn.y, turn.z = numbers[3:]
        message.header.stamp = self._node.get_clock().now().to_msg()
        return message

    def _publish(self, q: np.ndarray, qd: np.ndarray) -> None:
        state = self._states.msg_type(name=self._joints, position=q.tolist(), velocity=qd.tolist())
        state.header.stamp = self._node.get_clock().now().to_msg()
        self._states.publish(state)

    def receive(self) -> list[np.ndarray]:
        """The commands that have come."""
        commands, self._commands = self._commands, []
        return commands
