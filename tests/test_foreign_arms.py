"""Robot files of public packages are read as they are: the right joints, and a tool where another reader has it."""

from __future__ import annotations

from pathlib import Path

import pytest

from foreign_arms import FILES, largest_difference
from reachlab.robots.derive.arm import find_arm
from reachlab.robots.files.model_file import read_model_file
from reachlab.robots.loading import load_robot

TOOLS = {
    "panda (pybullet_data)": ("panda_grasptarget", 7),
    "xarm6": ("link6", 6),
    "panda": ("panda_hand_tcp", 7),
    "ur3": ("tool0", 6),
    "ur5": ("tool0", 6),
    "ur10": ("tool0", 6),
    "xarm7": ("link_eef", 7),
    "so100": ("gripper", 5),
    "so101": ("gripper_frame_link", 5),
    "kinova": ("j2s6s200_end_effector", 6),
    "z1": ("gripperStator", 6),
}
"""Tool frame and number of joints that each has without being told."""


@pytest.mark.parametrize("name", FILES)
def test_tool_and_kinematics_without_a_flag(name: str) -> None:
    arm = find_arm(read_model_file(FILES[name]), None, None)
    assert (arm.tool, arm.chain.n) == TOOLS[name]
    assert largest_difference(FILES[name], arm.chain, arm.names, arm.tool, 300) < 2e-6


@pytest.mark.slow
def test_its_boxes_are_reached_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    robot = load_robot(str(FILES["so101"]))
    assert robot.shares["workspace"] >= 0.999
    assert robot.shares["goal_box"] >= 0.999
    assert len(list((tmp_path / "reachlab" / "robots").iterdir())) == 1
