"""The loop around an SO-101: from its motors to an exported controller, and back."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from reachlab.deploy.check import read_facts, start_controller
from reachlab.deploy.lerobot_units import exported_motors
from reachlab.settings.validation import choose

STOP = 0.3
"""Time in which the arm is brought to rest at the end [s]; its controller takes 0.18."""

ROUNDING = 1e-6
"""What clocks lose in sums of periods [s]."""


def follow(
    robot: Any,
    export: str | Path,
    goal: Sequence[float],
    seconds: float,
    *,
    zeros: Mapping[str, float] | None = None,
    clock: Callable[[], float] = time.perf_counter,
    sleep: Callable[[float], None] = time.sleep,
) -> str:
    """Drive an arm to a goal by the policy of an exported folder; what is wrong at the end, empty where nothing is.

    It begins where the arm is, and brings it to rest at the end, also where it is interrupted.

    Args:
        robot: LeRobot's `SO101Follower`, connected and calibrated, or what has its `get_observation` and `send_action`.
        export: folder that `reachlab export` wrote.
        goal: position `[3]` of the tool in the frame of the arm's base [m]; with a quaternion wxyz where the policy
            was trained on poses.
        seconds: how long it is driven [s].
        zeros: what motors by name, as `shoulder_pan.pos`, show where the joints of reachlab's model are at zero
            [degrees]; by default 0, for a calibration whose middle is the model's.
        clock: tells the time [s].
        sleep: waits for a time [s].

    Raises:
        InputError: the folder is none that was exported, or there is no such motor.
        ValueError: the arm is not within its limits.
    """
    controller, motors = start_controller(Path(export)), exported_motors(read_facts(Path(export)))
    shown_at_zero = {choose("motor", name, motors.names): value for name, value in (zeros or {}).items()}
    shift = np.array([shown_at_zero.get(name, 0.0) for name in motors.names])

    def measure() -> np.ndarray:
        shown = robot.get_observation()
        return motors.command(np.array([shown[name] for name in motors.names]) - shift)

    def run(duration: float) -> None:
        nonlocal q, then
        end = then + duration
        while then + controller.period <= end + ROUNDING:
            sleep(max(0.0, then + controller.period - clock()))
            before, q, since, then = q, measure(), then, clock()
            command = controller.step(q, (q - before) / (then - since), goal, then)
            robot.send_action(dict(zip(motors.names, (motors.read(command) + shift).tolist(), strict=True)))

    q, then = measure(), clock()
    controller.reset(q)
    try:
        run(seconds)
        return controller.problem
    finally:
        controller.stop()
        run(STOP)
