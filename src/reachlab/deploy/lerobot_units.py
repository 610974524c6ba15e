"""Names and units in which LeRobot reads and commands an arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from reachlab.envs.earlier_configs import from_json
from reachlab.envs.setup import make_setup
from reachlab.robots.robot import Robot


@dataclass(frozen=True)
class Motors:
    """What LeRobot knows of an arm.

    Attributes:
        names: of its motors `[k]`.
        read: their positions `[..., k]` in LeRobot's units, of what can be commanded `[..., m]` [rad or m].
        command: what can be commanded `[..., m]` [rad or m], of their positions `[..., k]`.
    """

    names: tuple[str, ...]
    read: Callable[[np.ndarray], np.ndarray]
    command: Callable[[np.ndarray], np.ndarray]


def motors_of(name: str, robot: Robot) -> Motors:
    """Motors of an arm by its name in `ROBOTS`; of one that LeRobot does not know, its joints [rad or m] as they are.

    The opening of its gripper [m], where it is driven, comes after them.
    """
    return LEROBOT.get(name, lambda robot: Motors(robot.actuators, np.asarray, np.asarray))(robot)


def exported_motors(facts: Mapping[str, Any]) -> Motors:
    """Motors of the arm of an exported policy, by what its `policy.json` says."""
    config = from_json(facts["settings"])
    return motors_of(config.robot, make_setup(config).robot)


def _so101(robot: Robot) -> Motors:
    """Joints in degrees, and the jaw from 0, closed, to 100; where no task drives the jaw it is where it is locked.

    Names and units are those of LeRobot's `so_follower.py`; its zeros and senses are those of the description that the
    arm's file is from, see `robots/assets/so101/SOURCES.md`.
    """
    model, arm, gripper = robot.model.spec(pictures=False).compile(), robot.chain.n, robot.gripper
    joint, locked = model.joint("gripper"), model.key("home").qpos
    low, high = joint.range

    def read(actuated: np.ndarray) -> np.ndarray:
        at_rest = np.full((*actuated.shape[:-1], 1), locked[joint.qposadr[0]])
        jaw = gripper.fingers(actuated[..., arm:]) if gripper else at_rest
        return np.concatenate([np.degrees(actuated[..., :arm]), 100 * (jaw - low) / (high - low)], axis=-1)

    def command(motors: np.ndarray) -> np.ndarray:
        joints, jaw = np.radians(motors[..., :arm]), low + (high - low) * motors[..., arm:] / 100
        return np.concatenate([joints, gripper.opening(jaw)], axis=-1) if gripper else joints

    return Motors(tuple(f"{name}.pos" for name in (*robot.joint_names, joint.name)), read, command)


LEROBOT: dict[str, Callable[[Robot], Motors]] = {"so101": _so101}
"""Arms of the catalogue that LeRobot knows. Adding one takes its function and its line here."""
