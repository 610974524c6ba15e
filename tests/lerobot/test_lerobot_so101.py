"""The loop around LeRobot's SO-101, whose motors are simulated; run by `make lerobot`."""

# pyright: reportMissingImports=false
from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from lerobot.motors import MotorCalibration
from lerobot.motors.feetech import FeetechMotorsBus
from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig

from lerobot_policy_reachlab.so101 import STOP, follow
from reachlab.deploy.check import settings_of
from reachlab.deploy.plant import Plant
from reachlab.settings.validation import InputError

TICKS, MIDDLE = 4095 / 360, 2047.5
"""Of an encoder in a degree, and where the simulated arm's joints are at zero."""

MIDDLES = {"shoulder_pan": 2000, "shoulder_lift": 2100, "elbow_flex": 2047, "wrist_flex": 1900, "wrist_roll": 2047}
"""Middles of the ranges that a calibration has found, from which LeRobot counts degrees."""

ZEROS = {f"{name}.pos": (MIDDLE - middle) / TICKS for name, middle in MIDDLES.items()}
STEPS = 100
"""Control steps of an episode, of 0.02 s."""


class Motors(FeetechMotorsBus):
    """LeRobot's bus, whose encoders are those of a simulated arm."""

    plant: Plant
    is_connected = is_calibrated = True

    def sync_read(self, data_name: str, *_: Any, **__: Any) -> dict[str, float]:
        assert data_name == "Present_Position"
        degrees = [*np.degrees(self.plant.q), 0.0]
        ticks = {self.motors[name].id: round(MIDDLE + TICKS * x) for name, x in zip(self.motors, degrees, strict=True)}
        shown = self._normalize(ticks)
        return {name: shown[motor.id] for name, motor in self.motors.items()}

    def sync_write(self, data_name: str, values: Any, **_: Any) -> None:
        assert data_name == "Goal_Position"
        ticks = self._unnormalize({self.motors[name].id: value for name, value in values.items()})
        self.sent = np.radians([(ticks[self.motors[name].id] - MIDDLE) / TICKS for name in MIDDLES])


class Bench:
    """A simulated arm with LeRobot's follower, and a clock that moves both."""

    def __init__(self, robot: Any, plant: Plant) -> None:
        self.robot, self.plant, self.time = robot, plant, 0.0
        self.success, self.commands = list[bool](), list[np.ndarray]()

    def sleep(self, seconds: float) -> None:
        self.time += seconds
        self.success.append(self.plant.step(self.robot.bus.sent)[1])
        self.commands.append(self.robot.bus.sent)

    def follow(self, exported: Path, **more: Any) -> str:
        goal = (self.plant.measure().goal or [])[:3]
        return follow(self.robot, exported, goal, 2.0, clock=lambda: self.time, **{"sleep": self.sleep, **more})


@contextmanager
def bench(exported: Path, folder: Path, episode: int) -> Iterator[Bench]:
    plant = Plant(settings_of(exported, None), 5000)
    plant.begin(episode)
    with patch("lerobot.robots.so_follower.so_follower.FeetechMotorsBus", Motors):
        robot: Any = SO101Follower(SO101FollowerConfig(port="/dev/null", id="arm", calibration_dir=folder))
    robot.bus.calibration = {
        name: MotorCalibration(motor.id, 0, 0, MIDDLES.get(name, 2047) - 1800, MIDDLES.get(name, 2047) + 1800)
        for name, motor in robot.bus.motors.items()
    }
    robot.bus.plant, robot.bus.sent = plant, plant.q
    yield Bench(robot, plant)
    plant.close()


@pytest.mark.parametrize("episode", range(3))
def test_an_arm_with_its_own_calibration_reaches_its_goal_and_rests(
    exported: Path, tmp_path: Path, episode: int
) -> None:
    with bench(exported, tmp_path, episode) as made:
        assert made.follow(exported, zeros=ZEROS) == ""
        assert made.success[STEPS - 1]
        assert np.ptp(made.commands[-3:], axis=0).max() == 0.0


def test_without_its_calibration_it_misses(exported: Path, tmp_path: Path) -> None:
    with bench(exported, tmp_path, 0) as made:
        made.follow(exported)
        assert not made.success[STEPS - 1]


def test_an_interrupt_brings_the_arm_to_rest(exported: Path, tmp_path: Path) -> None:
    with bench(exported, tmp_path, 0) as made:

        def interrupted(seconds: float) -> None:
            made.sleep(seconds)
            if len(made.commands) == 10:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            made.follow(exported, zeros=ZEROS, sleep=interrupted)
        moves = np.abs(np.diff(made.commands, axis=0)).max(axis=1)
        assert moves[8] > 0.005
        assert moves[-3:].max() == 0.0
        assert made.time < 10 * made.plant.period + STOP + 2 * made.plant.period


def test_a_motor_that_does_not_exist_is_refused(exported: Path, tmp_path: Path) -> None:
    with bench(exported, tmp_path, 0) as made, pytest.raises(InputError, match="motor 'shoulder_pan' is not one of"):
        made.follow(exported, zeros={"shoulder_pan": 3.0})
