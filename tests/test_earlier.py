"""Runs and exports of earlier versions stay usable: they are in `earlier/`, as those versions wrote them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import reachlab
from reachlab.cli import main as cli
from reachlab.envs.earlier_configs import from_json
from reachlab.envs.presets import preset
from reachlab.runs.directory import RunDirectory
from reachlab.settings.json_form import to_json

FORMAT_1 = Path(__file__).parent / "earlier" / "format_1"

EPISODES, SEED = 20, 77
"""Of the evaluations that the version before made of them."""


def figures(name: str) -> list[dict[str, Any]]:
    return json.loads((FORMAT_1 / f"{name}-evaluations.json").read_text())


@pytest.mark.parametrize("name", ["tutorial", pytest.param("clutter", marks=pytest.mark.slow)])
def test_a_run_of_format_1_is_evaluated_to_the_same_figures(name: str) -> None:
    loaded = reachlab.load(FORMAT_1 / f"{name}-finished", num_envs=EPISODES)
    for before in figures(name):
        policy = loaded.policy if before["agent"] == "trained" else None
        now = reachlab.evaluate(loaded.env, before["agent"], policy, seed=SEED, episodes=EPISODES).to_json()
        later = {"wall_s", "versions", "straight", "planning_s", "largest_force_n", "object"}
        assert now.keys() == before.keys() | later
        for figure in ("task", "robot", "sim", "success_rate", "ends", "success_within", "steps_mean"):
            assert now[figure] == before[figure], figure
        assert now["return_mean"] == pytest.approx(before["return_mean"], rel=1e-3)
    loaded.env.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clutter", "pose"])
def test_a_run_of_format_1_is_resumed(name: str, tmp_path: Path) -> None:
    run = shutil.copytree(FORMAT_1 / f"{name}-unfinished", tmp_path / "run")
    # In a process of its own: with as many threads as the run began with.
    words = [sys.executable, "-m", "reachlab", "train", "--resume", str(run)]
    env = {name: value for name, value in os.environ.items() if name != "NPROC"}
    done = subprocess.run(words, capture_output=True, text=True, env=env, check=False)
    assert done.returncode == 0, done.stderr
    directory = RunDirectory(run)
    assert directory.finished
    assert directory.read_metrics()[-1]["steps"] == 400
    steps = [row["steps"] for row in directory.read_metrics()]
    assert steps == sorted(set(steps))


@pytest.mark.slow
def test_an_export_of_format_1_drives_an_arm(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["deploy", "check", str(FORMAT_1 / "clutter-export"), "--episodes", "4", "--json"]) == cli.DONE
    told = json.loads(capsys.readouterr().out)
    assert told["broken"] == 0


def saved(**changes: Any) -> dict[str, Any]:
    """Settings as format 1 had them: those of every task in one."""
    plain = json.loads((FORMAT_1 / "tutorial-finished" / "config.json").read_text())
    return plain | {"rules": plain["rules"] | changes}


@pytest.mark.parametrize(
    ("rules", "task"),
    [
        ({}, "tutorial"),
        ({"hold_steps": 5}, "precise"),
        ({"targets": "box", "target_turn": [0.1, 0.2, 0.3]}, "pose"),
        ({"targets": "any"}, "pose"),
    ],
)
def test_settings_of_format_1_are_those_of_the_task_that_has_them(rules: dict[str, Any], task: str) -> None:
    config = from_json(saved(**rules))
    assert config.task == task
    assert type(config.rules) is type(preset(task).rules)
    plain = to_json(config)["rules"]
    assert all(tuple(np.atleast_1d(plain[name])) == tuple(np.atleast_1d(value)) for name, value in rules.items())
    assert config.rules.tool == (None if task == "tutorial" else "link_7"), "the tool of the tutorial's task"
    assert from_json(json.loads(json.dumps(to_json(config)))) == config


def test_a_setting_that_is_missing_has_its_default() -> None:
    plain = json.loads(json.dumps(to_json(preset("precise"))))
    del plain["rules"]["hold_steps"], plain["loop"]["chained_starts"]
    assert from_json(plain) == preset("precise")
