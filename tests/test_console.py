"""What a person reads in the terminal."""

from __future__ import annotations

import os
import pty
import re
import sys
from collections.abc import Callable
from typing import Any

import pytest

from reachlab.cli.console import note, print_reports, say, task_and_success
from reachlab.cli.deploy_command import _by_kind
from reachlab.cli.eval_command import _means
from reachlab.cli.eval_subjects import Subject
from reachlab.cli.progress import Bar, TrainDisplay, explained, parts_of_time, train_line
from reachlab.envs.presets import configure
from reachlab.evaluation.intervals import mean_report
from reachlab.learn.loop import Progress
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override


def progress(steps: int, elapsed_s: float, **metrics: float) -> Progress:
    row = {"episodes": 0.0, "success_rate": 0.0, "final_distance": 0.0, "wall_s": elapsed_s - 1.0}
    return Progress(steps, 4_000_000, row | metrics, elapsed_s, lambda _: pytest.fail("nobody asked for it"))


def lines_of(config: RunConfig, seen: list[Progress], capsys: pytest.CaptureFixture[str]) -> list[str]:
    capsys.readouterr()
    with TrainDisplay(config) as display:
        for now in seen:
            display(now)
    out, err = capsys.readouterr()
    assert out == ""
    return [line for line in str(err).splitlines() if "M steps" in line]


def test_the_speed_of_a_line_is_its_steps_over_its_time() -> None:
    line = train_line(progress(300_000, 5.0), progress(8192, 2.0), configure(), "")
    assert line == "0.30M steps  60k steps/s  5 s"


def test_time_left_is_told_only_where_all_steps_are_taken() -> None:
    config = configure(stop_early=False, num_envs=100, rollout_steps=100)
    first, now = progress(10_000, 6.0), progress(1_010_000, 16.0)
    assert train_line(now, first, config, "").endswith("16 s  about 30 s left"), "the first, compiled, is left out"
    assert "left" not in train_line(first, first, config, "")
    assert "left" not in train_line(now, first, configure(), "")


def test_the_parts_of_a_trainings_time_add_up_to_it() -> None:
    first = progress(8192, 6.0, steps_per_second=8192 / 2.0)
    last = progress(108_192, 16.0, steps_per_second=108_192 / 10.0)
    assert parts_of_time(first, last, 16.5) == (
        "6.5 s of compiling and the first 8,192 steps, 8.0 s of training (12,500 steps/s),"
        " 2.0 s of validations and saving"
    )


def test_a_line_tells_of_all_training_episodes_since_the_last_line(capsys: pytest.CaptureFixture[str]) -> None:
    ended = {"episode_length": 200.0, "reward": 0.01}
    seen = [
        progress(8192, 2.0),
        progress(16384, 2.5, **ended, episodes=100.0, success_rate=0.5, early_rate=0.2, validation_success=0.75),
        progress(24576, 4.5, **ended, episodes=300.0, success_rate=1.0),
    ]
    first, last = lines_of(configure(), seen, capsys)
    assert "success" not in first, "nothing is said of no episode"
    told = "success 87.5 % of 400 training episodes, 5.0 % ended outside the workspace  return 2  validation 75.0 %"
    assert told in last


def test_lines_become_rarer_and_no_passed_validation_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    tenths = [progress(100 * n, n / 10) for n in range(1, 1000)]
    assert len(lines_of(configure(), tenths, capsys)) < 20
    rates = {0.0: 3.0, 0.5: 3.1, 1.0: 3.2}
    passed = [progress(100, elapsed_s, validation_success=rate) for rate, elapsed_s in rates.items()]
    assert ["validation 100.0 %" in line for line in lines_of(configure(), passed, capsys)] == [False, True]


def test_what_has_to_be_held_is_told_with_its_distance(capsys: pytest.CaptureFixture[str]) -> None:
    seen = [progress(100_000, 3.0, episodes=10.0, success_rate=0.5, final_distance=0.0042)]
    (line,) = lines_of(configure("precise"), seen, capsys)
    assert "success 50.0 % of 10 training episodes, 4.2 mm at their end" in line


def test_a_training_explains_what_its_lines_speak_of() -> None:
    tutorial, precise = explained(configure()), explained(configure("precise"))
    assert "at most 20,000,000 steps, until 3 validations in a row reach 100 % success" in tutorial
    assert "Training episodes explore with noise;" in tutorial
    assert f": {configure('precise').loop.total_steps:,} steps." in precise
    assert "noise and vary in dynamics" in precise
    few = explained(configure(total_steps=50_000, num_envs=128, rollout_steps=64))
    assert "at most 50,000 steps (57,344 in whole iterations), until" in few


REPORT: dict[str, Any] = {
    "task": "tutorial",
    "robot": "iiwa14",
    "sim": "kinematic",
    "agent": "trained",
    "seed": 1,
    "episodes": 4,
    "randomised": [],
    "success_rate": 0.5,
    "success_interval": (0.15, 0.85),
    "success_within": None,
    "success_within_pairs": None,
    "final_error_mm": {"median": 2.0, "p95": 3.0, "p99": 3.0, "max": 3.0},
    "final_angle_rad": None,
    "tracking": None,
    "time_to_reach_s": 0.5,
    "contact": None,
    "self_contact": None,
}
"""A report of episodes that end once the tool was held."""


PARTS = (({"median": 0.1}, [1.0, 2.0]), (None, [3.0, 4.0]))
"""Of two reports: times of planning, which one of them lacks, and largest speeds."""

HELD = configure("precise", sim="kinematic", hold_steps=2, at_goal="end", control_period=1 / 240)


def test_a_table_of_episodes_that_end_once_the_tool_was_held(capsys: pytest.CaptureFixture[str]) -> None:
    print_reports([REPORT], HELD)
    out = capsys.readouterr().out
    assert "for 2 steps (0.0083 s), no joint faster than 0.05 rad/s, which ends the episode." in out
    assert "median error" in out
    assert "2.0 mm" in out
    assert "added to a controller's" not in out


def test_agents_that_look_at_nothing_are_no_baselines_where_they_correct_a_controller(
    capsys: pytest.CaptureFixture[str],
) -> None:
    blind = [REPORT | {"agent": agent} for agent in ("trained", "zero", "random", "zero")]
    print_reports(blind, HELD)
    assert "Actions of zero and random are added to a controller's here" in capsys.readouterr().out
    print_reports(blind, override(HELD, action="joint_delta"))
    assert "added to a controller's" not in capsys.readouterr().out


def test_reports_of_several_runs_are_told_with_the_mean_of_their_seeds(capsys: pytest.CaptureFixture[str]) -> None:
    rates = {"s0": 0.25, "s1": 0.5, "s2": 0.75}
    reports = [{**REPORT, "run": name, "success_rate": rate} for name, rate in rates.items()]
    reports[2] |= {"time_to_reach_s": None, "final_error_mm": {**REPORT["final_error_mm"], "median": 8.0}}
    mean = mean_report(reports)
    # 0.25 / √3 times the 97.5 % quantile of Student's distribution with two degrees of freedom, 4.303
    assert mean["success_interval"] == (0.0, 1.0)
    assert mean_report(reports[:2])["success_rate"] == 0.375
    close = mean_report([{**REPORT, "success_rate": rate} for rate in (0.49, 0.5, 0.51)])
    assert close["success_interval"] == pytest.approx((0.5 - 0.0248, 0.5 + 0.0248), abs=1e-4)
    assert (mean["final_error_mm"]["median"], mean["time_to_reach_s"]) == (4.0, None)
    both = ({"planning_s": one, "max_joint_speed": speed, "checkpoint": {"steps": 1}} for one, speed in PARTS)
    parts = mean_report([REPORT | one for one in both])
    assert (parts["planning_s"], parts["max_joint_speed"], parts["checkpoint"]) == (None, [2.0, 3.0], None)
    print_reports(
        [*reports, mean | {"run": "mean of 3 seeds"}],
        HELD,
    )
    rows = [line.split("│")[1].strip() for line in capsys.readouterr().out.splitlines() if "│" in line]
    assert rows == ["s0", "s1", "s2", "mean of 3 seeds"]


def test_a_mean_is_of_runs_that_differ_by_their_seeds_alone() -> None:
    settings = {"a": {"seed": 0}, "b": {"seed": 1}, "again": {"seed": 1}, "other": {"seed": 0, "gamma": 0.5}}
    subjects = [Subject(name, configure(**chosen)) for name, chosen in settings.items()]
    rates = {"a": 0.25, "b": 0.75, "again": 1.0, "other": 1.0}
    (mean,) = _means([{**REPORT, "run": name, "success_rate": rate} for name, rate in rates.items()], subjects)
    assert (mean["run"], mean["success_rate"]) == ("mean of 2 seeds", 0.5)
    assert not _means([{**REPORT, "success_rate": 1.0}], [Subject("", configure())])


def test_each_agent_has_a_mean_of_its_own() -> None:
    subjects = [Subject(name, configure(seed=seed)) for seed, name in enumerate("ab")]
    rates = {("a", "trained"): 0.5, ("b", "trained"): 0.6, ("a", "hybrid"): 1.0, ("b", "hybrid"): 1.0}
    reports = [{**REPORT, "run": run, "agent": agent, "success_rate": rate} for (run, agent), rate in rates.items()]
    means = _means(reports, subjects)
    assert [(mean["agent"], mean["run"]) for mean in means] == [
        ("trained", "mean of 2 seeds"),
        ("hybrid", "mean of 2 seeds"),
    ]
    assert [mean["success_rate"] for mean in means] == pytest.approx([0.55, 1.0])


def test_problems_of_one_kind_are_told_in_one_line() -> None:
    said = {"called at 175 Hz: call it every 0.004 s": 3, "called at 180.5 Hz: call it every 0.004 s": 5, "no goal": 1}
    assert _by_kind(said) == {"called at 180.5 Hz: call it every 0.004 s": 8, "no goal": 1}


def test_where_simulators_differ_in_the_length_of_a_step_it_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    periods = {"kinematic": 1 / 240, "mujoco": 0.02}
    print_reports(
        [{**REPORT, "sim": sim, "control_period": period} for sim, period in periods.items()],
        HELD,
    )
    assert "A step is 4.17 ms in kinematic, 20 ms in mujoco: equally many" in capsys.readouterr().out


@pytest.mark.parametrize(("distance", "said"), [(0.05, "within 50 mm"), (0.0125, "within 12.5 mm")])
def test_what_a_task_asks_for_follows_from_its_settings(distance: float, said: str) -> None:
    assert said in task_and_success(configure(success_distance=distance))[0]
    assert re.match("touch a point in the arm's box", task_and_success(configure(targets="box"))[0])


def test_the_end_of_an_evaluation_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    with Bar() as display:
        for agent in ("trained", "ik"):
            display.expect(f"{agent} in kinematic", 100)
            for ended in (8, 96, 100, 100, 100):
                display.count(ended)
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["trained in kinematic", "ik in kinematic"]


def test_a_report_that_takes_long_tells_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([0.0, 4.0, 11.0, 15.0, 22.0])
    monkeypatch.setattr("reachlab.cli.progress.time.perf_counter", lambda: next(clock))
    with TrainDisplay(configure(report_episodes=100)) as display:
        for ended in (8, 40, 60, 100):
            display.report(ended)
    assert capsys.readouterr().err.splitlines() == ["report: 40 of 100 episodes, 11 s"]


@pytest.mark.parametrize(("write", "stream"), [(say, "stdout"), (note, "stderr")])
def test_what_is_written_to_a_terminal_that_was_closed_is_dropped(
    write: Callable[[str], None], stream: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal, end = pty.openpty()
    with os.fdopen(end, "w") as screen:
        monkeypatch.setattr(sys, stream, screen)
        os.close(terminal)
        write("nobody reads this")
        write("nor this")
