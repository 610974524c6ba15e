"""What is derived of an arm is the same on every CPU, to the last bit: `make kernels` runs this with other kernels."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from extension import ARM
from reachlab.envs.setup import make_setup, settled
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot
from reachlab.settings.json_form import override
from reachlab.settings.presets import preset
from reachlab.tasks import TASKS

DIGESTS = {
    "iiwa14": "5f296430ab71",
    "panda": "4e261a7cc477",
    "ur5e": "54bc9951dd25",
    "xarm7": "548ad4b014fe",
    "gen3": "cd39411417f0",
    "so101": "886eae20d3dc",
    "own": "ec8dd67ab08a",
}
"""Of what is derived; made anew where the derivation changes on purpose."""


LENGTHS = ("tool_scale", "success_distance", "approach_weight", "goal_jump", "target_height")
"""Settings that follow from an arm's workspace."""


def digest(robot: Robot, name: str) -> str:
    """Of an arm's figures, its capsules and the settings that follow from it for every task."""
    figures = robot.home, robot.held_quaternion, robot.workspace, robot.goal_box, robot.scale, robot.chain
    configs = [override(preset(task), robot=name) for task in TASKS]
    rules = [settled(config, make_setup(config)).rules for config in configs]
    lengths = [[getattr(one, length) for length in LENGTHS] for one in rules]
    return hashlib.sha256(repr((figures, vars(robot.capsules), lengths)).encode()).hexdigest()[:12]


@pytest.mark.parametrize("name", [*ROBOTS, "own"])
def test_what_is_derived_is_the_same_on_every_cpu(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = name
    if name == "own":
        monkeypatch.chdir(tmp_path)
        path = "own.xml"
        Path(path).write_text(ARM)
    assert digest(load_robot(path), path) == DIGESTS[name]
