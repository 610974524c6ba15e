"""An entry of each table is added by one line; everything works on it, and nothing else is touched."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import extension
import reachlab
from conformance import CHECKS, Subject
from params import tried
from reachlab.agents import AGENTS
from reachlab.cli import main as cli
from reachlab.robots.catalogue import ROBOTS
from reachlab.runs.metrics import read_metrics
from reachlab.runs.sinks import SINKS
from reachlab.settings import extensions
from reachlab.sims import SIMULATORS
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.rewards import REWARDS

USUAL = {
    "task": "tutorial",
    "robot": "iiwa14",
    "sim": "kinematic",
    "observation": "target+tool",
    "action": "joint_delta",
    "reward": "dense",
}

ADDED = {
    "task": "hover",
    "robot": "three_link",
    "sim": "sluggish",
    "observation": "height",
    "action": "joint_step",
    "reward": "squared",
}

TINY = {"num_envs": 8, "rollout_steps": 8, "total_steps": 64, "hidden": (8,), "report_episodes": 4, "max_steps": 20}


@pytest.fixture(autouse=True)
def added(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(TASKS, "hover", extension.TASK)
    monkeypatch.setitem(ROBOTS, "three_link", extension.robot(tmp_path))
    monkeypatch.setitem(SIMULATORS, "sluggish", extension.SIMULATOR)
    monkeypatch.setitem(OBSERVATIONS, "height", extension.OBSERVATION)
    monkeypatch.setitem(ACTIONS, "joint_step", extension.ACTION)
    monkeypatch.setitem(REWARDS, "squared", extension.reward)
    monkeypatch.setitem(AGENTS, "nudge", extension.AGENT)
    monkeypatch.setitem(SINKS, "notebook", extension.SINK)


@pytest.mark.parametrize("kinds", tried(["task", "robot", "all"], ["all"]))
def test_what_is_added_conforms(kinds: str) -> None:
    names = {kind: name for kind, name in ADDED.items() if kinds in (kind, "all")}
    subject = Subject(**{**USUAL, **names})
    for check in CHECKS:
        check(subject)
    subject.env.close()


@pytest.mark.slow
@pytest.mark.parametrize("sim", ["mujoco", "sluggish"])
def test_what_is_added_is_trained_on_evaluated_and_loaded(tmp_path: Path, sim: str) -> None:
    config = reachlab.configure(**{**ADDED, "sim": sim}, **TINY, stop_early=False)
    result = reachlab.train(config, tmp_path / "run")
    loaded = reachlab.load(tmp_path / "run")
    assert result.report.task == loaded.config.task == "hover"
    again = reachlab.evaluate(loaded.env, "trained", loaded.policy, seed=0, episodes=4)
    assert again.final_error_mm == result.report.final_error_mm
    assert reachlab.evaluate(loaded.env, "nudge", seed=0, episodes=4).agent == "nudge"
    loaded.env.close()


def test_what_is_added_is_listed_and_evaluated_by_the_command_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extensions, "INSTALLED", ["extension"])
    assert cli.main(["list", "--json"]) == cli.DONE
    listed = json.loads(capsys.readouterr().out)
    assert {"hover", "three_link", "sluggish", "height", "joint_step", "squared", "nudge"} <= {
        name for names in listed.values() for name in names
    }
    words = "eval --task hover --robot three_link --sim sluggish --agent nudge --episodes 5 --json"
    assert cli.main(words.split()) == cli.DONE
    report = json.loads(capsys.readouterr().out)
    assert (report["task"], report["robot"], report["agent"]) == ("hover", "three_link", "nudge")


@pytest.mark.slow
def test_a_sink_that_is_added_has_its_flag_and_gets_the_rows_and_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny = "--num-envs 8 --rollout-steps 8 --total-steps 64 --hidden 8 --report-episodes 4 --max-steps 20"
    run = tmp_path / "run"
    assert cli.main(["train", *tiny.split(), "--json", "--notebook", "--out", str(run)]) == cli.DONE
    report = json.loads(capsys.readouterr().out)
    assert json.loads((run / "notebook.json").read_text()) == [read_metrics(run / "metrics.jsonl"), report]


def test_a_figure_of_a_robot_says_where_it_is_from() -> None:
    ours, added = reachlab.load_robot("iiwa14"), reachlab.load_robot("three_link")
    assert ours.sources["home"] == "model file"
    for name in ("position", "speed", "torque"):
        assert ours.sources[name] == ("model file",) * ours.chain.n
    assert ours.sources["workspace"] == ours.sources["goal_box"] == ours.sources["held_quaternion"] == "catalogue"
    n = added.chain.n
    assert added.sources["home"] == "catalogue"
    assert added.sources["speed"] == added.sources["torque"] == ("default",) * n
    assert (added.sources["workspace"], added.sources["goal_box"]) == ("catalogue", "derived")
    assert set(added.shares) <= {"goal_box"}, "of boxes that are derived"
