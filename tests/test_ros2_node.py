"""The node of ROS 2: which messages it believes, and what it does about a reset and a stop."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from faults.controllers import broken, written
from reachlab.deploy.markers import to_markers
from reachlab.deploy.onboard.controller import Controller
from reachlab.deploy.ros2 import PolicyNode, run_node
from reachlab.deploy.said import Said
from reachlab.deploy.topics import Topics
from reachlab.settings.validation import InputError

pytest.importorskip("rclpy")

UR = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
"""Names of the joints of a UR5e in its driver, which are not those of the policy."""

STAMPED = 1000.0
"""What the node's clock shows at its start [s]."""


@pytest.fixture(scope="module")
def precise(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("precise") / "policy", "precise", robot="ur5e")


@pytest.fixture(scope="module")
def track(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("track") / "policy", "track", robot="panda")


class Driver:
    """An arm that is where it was commanded to be a control period ago, and the node that commands it, in one clock."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, **more: Any) -> None:
        self.controller = Controller(folder)
        self.said, self.commands, self.topics, self.now = list[str](), list[np.ndarray](), dict[str, Any](), 5.0
        self.reached, self.problems = list[Any](), list[Any]()
        kept = {Topics().reached: self.reached.append, Topics().problems: lambda told: self.problems.append(told.data)}
        node = SimpleNamespace(
            create_publisher=lambda _, topic, __: SimpleNamespace(
                publish=kept.get(topic, lambda told: self.commands.append(np.array(told.data)))
            ),
            create_subscription=lambda _, topic, act, __: self.topics.update({topic: act}),
            create_timer=lambda *_: None,
            get_logger=lambda: SimpleNamespace(warning=self.said.append),
            get_clock=lambda: SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=(STAMPED + self.now) * 1e9)),
        )
        monkeypatch.setattr("reachlab.deploy.ros2.time", SimpleNamespace(monotonic=lambda: self.now))
        self.names = more.get("names") or self.controller.joints
        PolicyNode(node, self.controller, Topics(), trajectory=False, **more)
        self.q, self.qd = self.controller.home.copy(), np.zeros(len(self.controller.home))

    def stamped(self, message: Any, age: float = 0.0) -> Any:
        seconds = STAMPED + self.now - age
        message.header.stamp.sec, message.header.stamp.nanosec = int(seconds), int(seconds % 1 * 1e9)
        return message

    def tell(self, names: Any = None, q: Any = None, qd: Any = None, age: float = 0.0) -> None:
        """A message of joints, by default of this arm."""
        from sensor_msgs.msg import JointState

        position, velocity = (np.asarray(own if told is None else told) for told, own in ((q, self.q), (qd, self.qd)))
        message = JointState(name=names or self.names, position=position.tolist(), velocity=velocity.tolist())
        self.topics[Topics().joint_states](self.stamped(message, age))

    def run(self, periods: int, **told: Any) -> None:
        for _ in range(periods):
            before = len(self.commands)
            self.tell(**told)
            if len(self.commands) > before:
                self.qd = (self.commands[-1] - self.q) / self.controller.period
                self.q = self.commands[-1]
            self.now += self.controller.period

    def ask(self, place: Any, frame: str = "") -> None:
        from geometry_msgs.msg import PoseStamped

        message = PoseStamped()
        message.header.frame_id = frame
        message.pose.position.x, message.pose.position.y, message.pose.position.z = map(float, place)
        self.topics[Topics().goals](self.stamped(message))

    def send(self, topic: str) -> None:
        from std_msgs.msg import Empty

        self.topics[topic](Empty())

    @property
    def aside(self) -> np.ndarray:
        """A goal beside the middle of those that were trained."""
        return np.mean(self.controller.goal_box, axis=0) + np.array([0.05, 0.1, 0.0])


# --- what it tells --------------------------------------------------------------------------------


def test_each_goal_that_is_reached_is_published_once(precise: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(precise, monkeypatch)
    driver.run(2)
    stamps = []
    for number, goal in enumerate((driver.aside, driver.aside - [0.0, 0.1, 0.0]), 1):
        driver.ask(goal, "base")
        stamps.append(STAMPED + driver.now)
        assert len(driver.reached) == number - 1
        driver.run(120)
        assert len(driver.reached) == number
    told = [one.header for one in driver.reached]
    assert [one.frame_id for one in told] == ["base", "base"]
    seconds = [one.stamp.sec + one.stamp.nanosec / 1e9 for one in told]
    np.testing.assert_allclose(seconds, stamps, atol=1e-6)


def test_what_is_no_reason_to_brake_is_told_once_it_lasts() -> None:
    said, states = list[str](), list[str]()
    log = Said(said.append, states.append)
    for wrong in ["joint 'joint_1' lags", "", "joint 'joint_1' lags"] * 5:
        log.step(wrong, at_once=False)
    assert not said
    for step in range(60):
        log.step(f"called at {step} Hz", at_once=False)
    for _ in range(40):
        log.step("joint 'joint_1' jumped")
    log.step("joint 'joint_2' jumped")
    log.step("")
    assert said == ["called at 24 Hz", "joint 'joint_1' jumped", "joint 'joint_2' jumped", "all is well again"]
    assert states == [*said[:-1], ""]


def test_two_reasons_in_turns_do_not_fill_the_log() -> None:
    said = list[str]()
    log = Said(said.append, said.append)
    for _ in range(50):
        log.step("the measurement is not finite")
        log.step("no measurement has come")
    assert 1 <= len(said) / 2 <= 5


# --- which messages are believed ------------------------------------------------------------------


def test_joints_of_other_names_are_never_taken_by_their_order(precise: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(precise, monkeypatch)
    driver.run(5, names=UR)
    assert not driver.commands
    (said,) = driver.said
    assert said.startswith("joint states without shoulder_pan, shoulder_lift, elbow, wrist_1, wrist_2, wrist_3 are not")


def test_names_that_are_given_stand_for_the_policys_in_any_order(
    precise: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = Driver(precise, monkeypatch, names=UR)
    order = [2, 0, 1, 5, 4, 3]
    for _ in range(3):
        driver.tell(names=[UR[i] for i in order], q=driver.q[order])
        driver.now += driver.controller.period
    np.testing.assert_allclose(driver.commands[-1], driver.q)
    with pytest.raises(InputError, match="2 joint names are given, and the policy has shoulder_pan, "):
        run_node(precise, Topics(), trajectory=False, joint_names=("a", "b"))


@pytest.mark.parametrize("given", ["", "base"])
def test_places_in_another_frame_than_the_bases_are_not_used(
    precise: Path, monkeypatch: pytest.MonkeyPatch, given: str
) -> None:
    driver = Driver(precise, monkeypatch, frame=given)
    driver.run(2)
    driver.ask(driver.aside, "base")
    driver.run(120)
    there, mirrored = driver.q, driver.aside - [0.0, 0.2, 0.0]
    driver.ask(mirrored, "base_link")
    driver.ask(mirrored, "base_link")
    driver.run(20)
    np.testing.assert_allclose(driver.q, there, atol=1e-3)
    (said,) = (said for said in driver.said if "frame" in said)
    assert said == "places in frame 'base_link' are not used, but those in 'base': see --frame"
    driver.ask(mirrored)
    driver.run(20)
    assert np.abs(driver.q - there).max() > 0.1


def test_obstacles_of_which_one_is_in_another_frame_are_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = Driver(written(tmp_path / "policy", "clutter", robot="ur5e"), monkeypatch, sees=True)
    bodies = [{"position": [0.5, 0.0, z], "radius": 0.05} for z in (0.2, 0.8)]
    markers = to_markers(bodies)
    markers.markers[1].header.frame_id = "map"
    driver.run(2)
    driver.topics[Topics().obstacles](markers)
    driver.ask(driver.aside)
    driver.run(5)
    np.testing.assert_allclose(driver.q, driver.controller.home, atol=1e-6)
    driver.topics[Topics().obstacles](to_markers(bodies))
    driver.run(5)
    assert np.abs(driver.q - driver.controller.home).max() > 0.01


def test_a_grippers_message_takes_no_measurement_away(precise: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(precise, monkeypatch)
    driver.run(2)
    driver.ask(driver.aside)
    for _ in range(20):
        driver.run(1)
        driver.tell(names=["finger"], q=[0.02], qd=[0.0])
        assert driver.controller.problem == ""


def test_joints_that_are_old_by_their_stamps_are_not_used(precise: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(precise, monkeypatch)
    driver.run(5, age=0.4)
    driver.run(5, age=0.5)
    assert not driver.commands
    assert driver.said == ["joint states are 0.4 s old by their stamps, and not used: do clocks differ?"]
    driver.run(5, age=0.01)
    assert driver.commands


def test_speeds_that_are_not_told_follow_from_the_joints(precise: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(precise, monkeypatch)
    driver.run(2)
    seen: list[Any] = []
    monkeypatch.setattr(driver.controller, "step", lambda *told, **_: seen.append(told[1]) or driver.controller.home)
    driver.tell(q=driver.q, qd=[])
    driver.now += 0.02
    driver.tell(q=driver.q + 0.002, qd=[])
    np.testing.assert_allclose(seen[-1], 0.1, rtol=1e-3)


def test_speeds_that_are_no_numbers_follow_from_the_joints_too(precise: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(precise, monkeypatch)
    driver.run(3, qd=np.full(len(driver.q), np.nan))
    driver.ask(driver.aside)
    driver.run(20, qd=np.full(len(driver.q), np.nan))
    assert driver.commands
    assert np.abs(driver.q - driver.controller.home).max() > 0.05


@pytest.mark.parametrize("reset", [False, True])
def test_a_goal_counts_that_came_before_the_arm_was_measured_and_after_a_reset(
    precise: Path, monkeypatch: pytest.MonkeyPatch, reset: bool
) -> None:
    driver = Driver(precise, monkeypatch)
    if reset:
        driver.ask(driver.aside)
        driver.run(3)
        driver.send(Topics().reset)
    begun = driver.q
    driver.ask(driver.aside)
    driver.run(30)
    assert np.abs(driver.q - begun).max() > 0.05


def test_obstacles_of_other_shapes_hold_the_arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(written(tmp_path / "policy", "clutter", robot="ur5e"), monkeypatch, sees=True)
    markers = to_markers([{"position": [0.5, 0.0, 0.2], "radius": 0.05}])
    markers.markers[0].type = markers.markers[0].CUBE_LIST
    driver.run(2)
    driver.topics[Topics().obstacles](markers)
    driver.ask(driver.aside)
    driver.run(5)
    np.testing.assert_allclose(driver.q, driver.controller.home, atol=1e-6)
    assert any(said.startswith("obstacles are spheres, cubes and cylinders, and marker 0") for said in driver.said)


def test_a_goal_that_moves_has_its_velocity_at_any_rate(track: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(track, monkeypatch, fastest=1.0)
    driver.run(2)
    seen: list[Any] = []
    monkeypatch.setattr(driver.controller, "step", lambda *_, velocity, **__: seen.append(velocity) or driver.q)
    begin = driver.now
    for period in range(20):
        if period % 3 == 0:
            driver.ask(driver.aside + np.array([0.1 * (driver.now - begin), 0.0, 0.0]))
        driver.run(1)
    np.testing.assert_allclose(seen[4:], [[0.1, 0.0, 0.0]] * 16, atol=1e-5)
    driver.run(15)
    assert not seen[-1].any(), "a goal that nothing is heard of stands"


# --- reset and stop -------------------------------------------------------------------------------


def test_a_reset_brings_an_arm_that_moves_to_rest_first(precise: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(precise, monkeypatch)
    driver.run(2)
    driver.ask(driver.aside)
    driver.run(10)
    assert np.abs(driver.qd).max() > 0.2, "else this test asks for nothing"
    driver.send(Topics().reset)
    driver.run(40)
    assert broken(driver.commands, driver.controller) == []
    assert np.abs(driver.qd).max() == 0.0
    driver.ask(driver.aside)
    driver.run(5)
    assert np.abs(driver.qd).max() > 0.0, "it goes on after the reset"


@pytest.mark.parametrize("begun", [False, True])
def test_a_stop_after_a_reset_holds(precise: Path, begun: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver(precise, monkeypatch)
    if begun:
        driver.run(3)
        driver.send(Topics().reset)
    driver.send(Topics().stop)
    driver.run(3)
    driver.ask(driver.aside)
    driver.run(20)
    assert driver.controller.problem == "stop() was called"
    np.testing.assert_array_equal(driver.q, driver.controller.home)
    driver.send(Topics().reset)
    driver.run(3)
    driver.ask(driver.aside)
    driver.run(5)
    assert driver.controller.problem == ""
    assert (driver.q != driver.controller.home).any()


def test_an_arm_that_moves_or_is_past_its_limits_is_not_taken_over(
    precise: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = Driver(precise, monkeypatch)
    driver.run(3, qd=np.full(6, 0.5))
    assert driver.said == ["waiting: the arm is not measured to rest"]
    driver.run(3, q=driver.controller.limits.upper + 0.1)
    assert "waiting: joint 'shoulder_pan' is at " in driver.said[-1]
    assert not driver.commands
    driver.run(3, q=driver.controller.limits.upper + 0.001)
    np.testing.assert_allclose(driver.commands[-1], driver.controller.limits.upper, atol=1e-7)
