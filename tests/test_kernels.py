"""What is derived of an arm is the same on every CPU, to the last bit: `make kernels` runs this with other kernels."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from extension import ARM
from reachlab.envs.presets import preset
from reachlab.envs.setup import make_setup, settled
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot
from reachlab.settings.json_form import override
from reachlab.tasks import TASKS

DIGESTS = {
    "iiwa14": "cd8e23f04194",
    "panda": "366e4bc6db1c",
    "ur5e": "3e242d85fa1e",
    "xarm7": "2f214287d80c",
    "gen3": "5a421fce5e39",
    "so101": "dabda2b0446a",
    "own": "e5bb4268f1bb",
}
"""Of what is derived; made anew where the derivation changes on purpose."""


LENGTHS = ("tool_scale", "success_distance", "approach_weight", "goal_jump", "target_height")
"""Settings that follow from an arm's workspace."""


def digest(robot: Robot, name: str) -> str:
    """Of an arm's figures, its capsules and the settings that follow from it for every task."""
    figures = robot.home, robot.held_quaternion, robot.workspace, robot.goal_box, robot.scale, robot.chain
    configs = [override(preset(task), robot=name) for task in TASKS]
    rules = [settled(config, make_setup(config)).rules for config in configs]
    lengths = [[getattr(one, length, None) for length in LENGTHS] for one in rules]
    capsules = {name: value for name, value in vars(robot.capsules).items() if name != "floors"}
    return hashlib.sha256(repr((figures, capsules, lengths)).encode()).hexdigest()[:12]


@pytest.mark.parametrize("name", [*ROBOTS, "own"])
def test_what_is_derived_is_the_same_on_every_cpu(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = name
    if name == "own":
        monkeypatch.chdir(tmp_path)
        path = "own.xml"
        Path(path).write_text(ARM)
    assert digest(load_robot(path), path) == DIGESTS[name]
