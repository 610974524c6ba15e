"""Exports: what they compute, what the controller does with it, and what it does when things go wrong."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import extension
from benchmarks.deploy import lively_run
from faults.controllers import FAULTS, exported, faulty, hostile_commands, written
from params import tried
from reachlab.agents.acting import make_act
from reachlab.cli import main as cli
from reachlab.control.situation import Situation
from reachlab.deploy import weights
from reachlab.deploy.bundle import controller_source
from reachlab.deploy.card import model_card
from reachlab.deploy.check import check, load_controller, settings_of
from reachlab.deploy.export import export
from reachlab.deploy.markers import from_markers, to_markers
from reachlab.deploy.onboard.bodies import placed
from reachlab.deploy.onboard.controller import Controller
from reachlab.deploy.onboard.reading import read_bodies
from reachlab.deploy.plant import Measurement, Plant, drive
from reachlab.deploy.plant_faults import Faults
from reachlab.deploy.ros2 import PolicyNode
from reachlab.deploy.ros2_check import own_topics
from reachlab.deploy.topics import Topics
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.envs.setup import in_evaluation
from reachlab.learn.load import load_policy
from reachlab.robots.loading import load_robot
from reachlab.runs.directory import RunDirectory
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS, TOOL
from reachlab.tasks.task import TaskSetup

CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "tutorial": ("tutorial", {}),
    "delta": ("precise", {"action": "joint_delta", "robot": "panda"}),
    "goals": ("precise", {"observation": "goal+state", "robot": "gen3"}),
    "pose": ("pose", {}),
    "tilt": ("pose", {"robot": "so101"}),
    "track": ("track", {"robot": "ur5e"}),
    "clutter": ("clutter", {"robot": "xarm7"}),
    "clutter_pose": ("clutter_pose", {"robot": "panda"}),
    "heading": ("clutter", {"action": "heading", "observation": "ways", "robot": "ur5e"}),
    "picture": ("tutorial", {"observation": "image+tool"}),
    "memory": ("precise", {"memory": 16, "robot": "ur5e"}),
}
"""Tasks, observations, actions and arms that between them hold every term, action and kind of goal."""

QUICK = ("tutorial", "delta", "track")
"""Those that `make test` tries."""

EPISODES, STEPS = 3, 40
"""Episodes and their steps in which commands are compared."""

SAME = 1e-5
"""Largest difference of a command from that of the environment [rad]."""


@pytest.fixture(scope="module", params=tried(CASES, QUICK))
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    task, settings = CASES[request.param]
    return lively_run(tmp_path_factory.mktemp(request.param) / "run", task, **settings)


@pytest.fixture(scope="module")
def folder(run: RunDirectory) -> Path:
    done = export(run, run.path.parent / "policy", "trained")
    assert done.differences.keys() >= {"ONNX Runtime", "step.py"}
    assert done.differences["ONNX Runtime"] < 1e-6
    assert done.differences["step.py"] < SAME
    assert done.differences.get("reachlab_policy.c", 0.0) < 1e-12
    return done.folder


@pytest.fixture(scope="module")
def precise(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("precise") / "policy", "precise")


@pytest.fixture(scope="module")
def clutter(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("clutter") / "policy", "clutter", robot="ur5e")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["so101/push", "panda/lift"])
def test_shipped_policies_that_move_objects_are_exported(name: str, tmp_path: Path) -> None:
    assert export(name, tmp_path / "policy").differences["step.py"] < 5 * SAME


# --- what it computes -----------------------------------------------------------------------------


def told(env: Env, state: Any, row: int) -> dict[str, Any]:
    """What the controller is told of one environment, beside joints and goal."""
    goal, extras = state.goal, {}
    for name in env.setup.rules.gives & {"velocity", "joints"}:
        extras[name] = np.asarray(getattr(goal, name), float)[row]
    if "bodies" in env.setup.rules.gives:
        names = ("position", "quaternion", "half", "radius")
        parts = {name: np.asarray(getattr(state.arm.bodies, name), float)[row] for name in names}
        count = len(parts["radius"])
        extras["obstacles"] = [{name: part[i] for name, part in parts.items()} for i in range(count)]
    picture = env.render_observation(state)
    return extras if picture is None else {**extras, "picture": picture[row]}


def test_the_controller_commands_what_the_environment_does(run: RunDirectory, folder: Path) -> None:
    config = run.read_config()
    env = Env(override(in_evaluation(config, config.sim), shaping=True), EPISODES)
    policy, act, key = load_policy(run, env), make_act(env, "trained"), jax.random.key(0)
    state = env.compile_whole(env.init)(episode_keys(1, REPORT_STREAM, 0, EPISODES))
    step, alive = env.compile_whole(act), np.ones(EPISODES, bool)
    controllers = [load_controller(folder).Controller(folder) for _ in range(EPISODES)]
    for controller, q in zip(controllers, np.asarray(state.arm.q, float), strict=True):
        controller.reset(q)
    for number in range(STEPS):
        q, qd, goal = (np.asarray(part, float) for part in (state.arm.q, state.arm.qd, state.goal.position))
        if state.goal.quaternion is not None:
            goal = np.concatenate([goal, np.asarray(state.goal.quaternion, float)], axis=-1)
        commands = [
            controller.step(q[row], qd[row], goal[row], number * controller.period, **told(env, state, row))
            for row, controller in enumerate(controllers)
        ]
        state, transition, key = step(policy, state, key)
        assert [controller.problem for controller in controllers] == [""] * EPISODES
        assert np.array(commands)[alive] == pytest.approx(np.asarray(state.command)[alive], abs=SAME)
        alive &= ~np.asarray(transition.done)
    env.close()


def test_the_files_say_what_they_hold(folder: Path) -> None:
    facts = json.loads((folder / "policy.json").read_text())
    card = (folder / "README.md").read_text()
    used = {"__pycache__"}  # where another test has loaded the folder's modules
    assert {file.name for file in folder.iterdir()} - used == {
        *("README.md", "controller.py", "policy.json", "policy.onnx", "policy.safetensors", "step.py"),
        *("reachlab_policy.c", "reachlab_policy.h", "main.c"),
    }
    assert all(joint["name"] in card for joint in facts["joints"])
    assert all(
        set(joint["sources"]) == {"position", "speed", "torque", "acceleration", "jerk"} for joint in facts["joints"]
    )
    assert facts["run"]["sha256"]
    assert card.startswith("---\nlibrary_name: reachlab\n")


@pytest.mark.parametrize(
    "name", ["arm: #1", "- x", 'a"b\\c', "é 🦾 \x7f\xa0\n", "\udcff", "yes", "3", "@arm", "{", ""], ids=ascii
)
def test_the_card_of_an_arm_of_any_name_begins_with_yaml(precise: Path, name: str) -> None:
    report = {"seed": 1, "sim": "mujoco", "success_rate": 1.0, "success_interval": [0.9, 1.0], "episodes": 9}
    report |= {"final_error_mm": {"median": None}, "randomised": []}
    facts = json.loads((precise / "policy.json").read_text()) | {"robot": name, "held_out": [report]}
    front = yaml.safe_load(model_card(facts).split("---\n")[1])
    assert front["tags"] == ["robotics", "reinforcement-learning", "onnx", name, "precise"]
    assert front["model-index"][0]["name"] == f"precise for {name}"


def test_the_card_says_where_figures_are_of_something_else(clutter: Path) -> None:
    report = {"seed": 1, "sim": "mujoco", "success_rate": 0.98, "success_interval": [0.9, 1.0], "episodes": 9}
    report |= {"final_error_mm": {"median": 1.0}, "randomised": []}
    facts = json.loads((clutter / "policy.json").read_text()) | {"held_out": [report]}
    assert "model-index" in model_card(facts)
    assert "the bodies that it is told of, not what is around it" in model_card(facts)
    other = model_card(facts | {"evaluated_with": {"scene": ["balls"], "max_steps": 150}, "planner": {}})
    assert "model-index" not in other
    assert (
        "They are of the policy alone, without its planner, and not of what is asked for here: with scene balls,"
        " max_steps 150, and without the limits of acceleration and jerk that the controller keeps. Evaluate" in other
    )


@pytest.mark.usefixtures("entered")
def test_a_task_whose_goals_its_controller_would_refuse_is_not_exported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rail = TASKS["rail"].load()
    made, corner = rail.task(), np.zeros(3, np.float32)
    monkeypatch.setattr(rail, "task", classmethod(lambda _: replace(made, goal_box=lambda _: (corner, corner + 0.1))))
    lively_run(tmp_path / "run", "rail")
    with pytest.raises(
        InputError, match=r"a goal of the task is at \[0.5, .*\] m, out of its `goal_box`.*make the box"
    ):
        export(tmp_path / "run", tmp_path / "policy")
    assert not (tmp_path / "policy").exists()


ADDED: dict[str, tuple[str, Any]] = {
    "observation": ("observation", extension.OBSERVATION),
    "action": ("action", extension.ACTION),
}
"""Entries that somebody adds under the name `own`."""


@pytest.mark.parametrize("name", ADDED)
def test_what_a_user_adds_is_exported_by_itself(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    setting, entry = ADDED[name]
    monkeypatch.setitem(OBSERVATIONS if setting == "observation" else ACTIONS, "own", entry)
    done = export(lively_run(tmp_path / "run", "tutorial", **{setting: "own"}), tmp_path / "policy")
    assert done.differences["step.py"] < SAME


def test_limits_that_were_lowered_are_those_of_c_too(tmp_path: Path) -> None:
    run, lowered = lively_run(tmp_path / "run", "precise"), tmp_path / "lowered.json"
    first = export(run, tmp_path / "first")
    facts = json.loads((first.folder / "policy.json").read_text())
    for limits in facts["limits"].values():
        limits.update(speed=0.2, acceleration=1.0)
    lowered.write_text(json.dumps(facts))
    second = export(run, tmp_path / "second", limits=lowered)
    assert second.differences["reachlab_policy.c"] < 1e-12, "C beside the shell, which keeps the lowered limits"
    assert Controller(second.folder).limits.speed == pytest.approx(0.2)
    texts = [(one.folder / "reachlab_policy.c").read_text() for one in (first, second)]
    assert texts[0] != texts[1]
    next(iter(facts["limits"].values()))["speed"] = 100.0
    lowered.write_text(json.dumps(facts))
    with pytest.raises(InputError, match=r"speed must be above 0 and at most .* never widened"):
        export(run, tmp_path / "third", limits=lowered)
    with pytest.raises(InputError, match=r"policy\.json of an export before, and there is no file"):
        export(run, tmp_path / "third", limits=tmp_path / "nowhere")
    lowered.write_text("{}")
    with pytest.raises(InputError, match=r"lowered\.json' has no `limits` of joints: name the policy\.json"):
        export(run, tmp_path / "third", limits=lowered)


def test_a_check_says_where_joints_follow_otherwise_than_in_training(
    precise: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["deploy", "check", str(precise), "--episodes", "2"]
    assert cli.main([*words, "--sim", "kinematic"]) == cli.DONE
    said = " ".join(capsys.readouterr().out.split())
    assert "joints are measured 0.00 s behind their commands, and 0.10 s in training" in said
    assert "held-out episodes in real time, in kinematic: success" in said
    assert cli.main(words) == cli.DONE
    said = " ".join(capsys.readouterr().out.split())
    assert "held-out episodes in real time, in mujoco: success" in said
    assert "behind their commands" not in said


def test_an_export_counts_on_measurements_as_late_as_they_were_in_training(tmp_path: Path) -> None:
    commands = {}
    for varied in (("dynamics",), ("dynamics", "delay")):
        run = lively_run(tmp_path / f"run-{len(varied)}", "precise", robot="panda", randomise=varied)
        done = export(run, tmp_path / f"policy-{len(varied)}")
        assert done.differences["step.py"] < SAME
        controller = load_controller(done.folder).Controller(done.folder)
        home = np.array(load_robot("panda").home)
        for speed in (0.0, 0.5):
            controller.reset(home)
            command = controller.step(home, np.full(7, speed), np.array([0.5, 0.1, 0.4]), 0.0)
            assert controller.problem == ""
            commands[varied[-1], speed] = np.array(command)
    assert commands["delay", 0.0] == pytest.approx(commands["dynamics", 0.0], abs=SAME)
    assert np.abs(commands["delay", 0.5] - commands["dynamics", 0.5]).max() > 10 * SAME


def test_what_cannot_be_printed_is_refused_by_name_and_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def sorted_place(setup: TaskSetup, now: Situation) -> Any:
        del setup
        return jnp.sort(now.tool_position, axis=-1)

    own = replace(OBSERVATIONS["target"], terms=(replace(TOOL, value=sorted_place),))
    monkeypatch.setitem(OBSERVATIONS, "own", own)
    lively_run(tmp_path / "run", "tutorial", observation="own")
    assert cli.main(["export", str(tmp_path / "run"), "--out", str(tmp_path / "policy")]) == cli.WRONG_INPUT
    said = capsys.readouterr().err
    assert "'sort' cannot be printed in Python, C and JavaScript, which `" in said
    assert "sorted_place` (" in said
    assert "test_deploy.py, line" in said
    assert not (tmp_path / "policy").exists()


# --- where it runs --------------------------------------------------------------------------------


def test_the_controller_is_one_file_for_python_3_9() -> None:
    source = controller_source()
    tree = ast.parse(source, feature_version=(3, 9))
    modules = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    modules |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    outside = {module.partition(".")[0] for module in modules} - set(sys.stdlib_module_names)
    assert outside == {"numpy"}
    defined = [node.name for node in tree.body if isinstance(node, (ast.ClassDef, ast.FunctionDef))]
    defined += [
        target.id
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    ]
    assert len(defined) == len(set(defined)), "modules that are joined have no name in common"
    assert "strict=" not in source


EXAMPLE = """
import sys
sys.path.insert(0, {folder!r})
{example}
loaded = {{name.partition(".")[0] for name in sys.modules}}
assert not loaded & {{"reachlab", "jax", "mujoco", "onnxruntime", "scipy"}}, loaded
"""


@pytest.mark.parametrize("which", ["precise", "clutter"])
def test_the_example_of_the_card_runs_with_numpy_alone(which: str, request: pytest.FixtureRequest) -> None:
    exported: Path = request.getfixturevalue(which)
    example = (exported / "README.md").read_text().partition("```python\n")[2].partition("```")[0]
    code = EXAMPLE.format(folder=str(exported), example=example.replace('"."', repr(str(exported))))
    done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert "no problem" in done.stdout


# --- what goes wrong ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_brings_the_arm_to_rest_and_is_told(precise: Path, name: str) -> None:
    assert faulty(precise, name, 10).wrong == []


def test_no_command_leaves_a_limit_whatever_is_measured(precise: Path) -> None:
    assert hostile_commands(precise, 4000).wrong == []


@pytest.mark.slow
def test_a_goals_velocity_is_found_from_its_places(tmp_path: Path) -> None:
    folder = exported(tmp_path, "track")
    module = load_controller(folder)
    told, finds = module.Controller(folder), module.Controller(folder)
    q, qd, middle, velocity = told.home, 0 * told.home, told.goal_box.mean(axis=0), np.array([0.1, -0.05, 0.0])
    for number in range(60):
        jumped = np.array([0.0, 0.0, 0.15]) * (number >= 40)
        goal = middle + 0.02 * number * velocity + jumped
        known = velocity if number not in (0, 40) else np.zeros(3)
        command = told.step(q, qd, goal, 0.02 * number, velocity=known)
        assert finds.step(q, qd, goal, 0.02 * number) == pytest.approx(command, abs=1e-9)
        q, qd = command, (command - q) / 0.02


def test_an_arm_that_was_stopped_waits_for_a_reset(precise: Path) -> None:
    controller = load_controller(precise).Controller(precise)
    q, qd, goal = controller.home, 0 * controller.home, [0.5, 0.2, 0.4]
    step = iter(range(10**6))

    def play(steps: int) -> None:
        nonlocal q, qd
        for _ in range(steps):
            command = controller.step(q, qd, goal, next(step) * controller.period)
            q, qd = command, (command - q) / controller.period

    play(10)
    controller.stop()
    play(9)
    rest = q
    play(20)
    assert controller.problem == "stop() was called"
    assert q == pytest.approx(rest, abs=1e-12)
    controller.reset(q)
    play(10)
    assert controller.problem == ""
    assert np.abs(q - rest).max() > 1e-3


HOSTILE: list[dict[str, Any]] = [
    {"goal": "nowhere"},
    {"goal": [0.5, 0.0]},
    {"goal": [np.nan, 0.0, 0.4]},
    {"goal": {"x": 1}},
    {"time": "now"},
    {"time": np.inf},
    {"q": [[1, 2], [3]]},
    {"qd": {}},
]


@pytest.mark.parametrize("nonsense", HOSTILE, ids=str)
def test_nonsense_brakes_the_arm_and_raises_nothing(precise: Path, nonsense: dict[str, Any]) -> None:
    controller = load_controller(precise).Controller(precise)
    q, qd = controller.home, 0 * controller.home
    for number in range(30):
        call = {"q": q, "qd": qd, "goal": [0.5, 0.2, 0.4], "time": 0.02 * number} | (nonsense if number > 10 else {})
        command = controller.step(**call)
        q, qd = command, (command - q) / 0.02
    assert controller.problem
    assert controller.braking
    assert np.abs(qd).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    "obstacles", [[{}], "wall", [{"position": [0.4, 0.0, 0.3], "half": [1.0]}], [{"position": [np.nan] * 3}]], ids=str
)
def test_obstacles_that_cannot_be_read_brake_the_arm(clutter: Path, obstacles: Any) -> None:
    controller = load_controller(clutter).Controller(clutter)
    q, qd, middle = controller.home, 0 * controller.home, controller.goal_box.mean(axis=0)
    for number in range(60):
        command = controller.step(q, qd, middle, 0.02 * number, obstacles=obstacles if number > 20 else [])
        q, qd = command, (command - q) / 0.02
    assert controller.problem
    assert np.abs(qd).max() < 1e-9


def test_a_lost_measurement_or_two_do_not_stop_the_arm(precise: Path) -> None:
    controller = load_controller(precise).Controller(precise)
    q, qd = controller.home, 0 * controller.home
    for number in range(60):
        lost = number % 5 in (3, 4)
        command = controller.step(None if lost else q, qd, [0.5, 0.2, 0.4], number * controller.period)
        assert bool(controller.problem) == lost
        assert not controller.braking
        q, qd = command, (command - q) / controller.period


@pytest.mark.slow
def test_a_pose_without_joints_is_refused_and_one_with_some_is_reached(tmp_path: Path) -> None:
    folder = exported(tmp_path, "pose")
    controller = load_controller(folder).Controller(folder)
    facts = json.loads((folder / "policy.json").read_text())
    held = facts["arm"]["held_quaternion"]
    q, qd = controller.home, 0 * controller.home
    wanted = [0.5, 0.1, 0.4, *held]
    for number in range(40):
        command = controller.step(q, qd, wanted, number * controller.period)
        q, qd = command, (command - q) / controller.period
    assert controller.problem == ""
    assert controller.goal_joints is not None
    for number in range(40, 80):
        controller.step(q, qd, [*(controller.goal_box[1] + 0.09), *held], number * controller.period)
    assert "out of reach" in controller.problem
    assert controller.braking


def test_a_log_is_replayed_to_the_last_bit(precise: Path, tmp_path: Path) -> None:
    controller = load_controller(precise).Controller(precise)
    q, qd, random = controller.home, 0 * controller.home, np.random.default_rng(0)
    for number in range(100):
        told: Any = q if number % 7 else None
        command = controller.step(
            told, qd, random.uniform(0.3, 0.6, 3) if number > 50 else [0.5, 0, 0.4], 0.02 * number
        )
        q, qd = q + 0.5 * (command - q), 0.5 * (command - q) / 0.02
    controller.save_log(tmp_path / "log.jsonl")
    assert load_controller(precise).Controller(precise).replay(tmp_path / "log.jsonl") == 0.0


def test_an_export_that_differs_from_its_policy_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lively_run(tmp_path / "run", "tutorial")
    monkeypatch.setattr(weights, "OBSERVATION_CLIP", 0.3)  # the graph is built with it
    assert cli.main(["export", str(tmp_path / "run"), "--out", str(tmp_path / "policy")]) == cli.WRONG_INPUT
    assert "ONNX Runtime differs from the policy by" in capsys.readouterr().err
    assert not (tmp_path / "policy").exists()


@pytest.mark.parametrize(
    ("words", "flag"),
    [
        (["ros2", "--episodes", "5"], "--episodes"),
        (["ros2", "--drop", "0.1"], "--faults"),
        (["check", "--trajectory"], "--trajectory"),
    ],
)
def test_a_flag_that_does_not_go_with_it_is_refused(
    words: list[str], flag: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["deploy", *words]) == cli.WRONG_INPUT
    assert flag in capsys.readouterr().err


def test_a_folder_that_is_not_empty_stays_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lively_run(tmp_path / "run", "tutorial")
    assert cli.main(["export", str(tmp_path / "run"), "--out", str(tmp_path)]) == cli.WRONG_INPUT
    assert "is not empty" in capsys.readouterr().err


# --- in real time ---------------------------------------------------------------------------------


def test_an_arm_whose_sensor_dies_is_brought_to_rest_in_real_time(precise: Path) -> None:
    outcome = check(precise, sim=None, episodes=1, seed=1, faults=Faults(dead_after=0.6))
    assert outcome.broken == 0
    assert outcome.rest_s is not None
    assert outcome.rest_s <= 0.3
    assert "no measurement has come" in outcome.problems


def test_measurements_may_come_late_and_damaged_in_real_time(precise: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["deploy", "check", str(precise), "--episodes", "2", "--delay", "0.02", "--jitter", "0.01", "--nan", "0.05"]
    assert cli.main([*words, "--json"]) == cli.DONE
    result = json.loads(capsys.readouterr().out)
    assert (result["episodes"], result["broken"]) == (2, 0)
    assert "the measurement is not finite" in result["problems"]


def test_measurements_that_come_late_by_chance_are_not_used_twice_in_a_period(precise: Path) -> None:
    outcome = check(precise, sim=None, episodes=1, seed=1, faults=Faults(jitter=0.04))
    assert "no measurement has come" in outcome.problems
    rates = [float(rate) for said in outcome.problems for rate in re.findall(r"step is called at ([\d.]+) Hz", said)]
    assert all(rate < 50 for rate in rates), "a busy computer calls it less often"


def test_a_check_in_which_nothing_is_measured_says_so(precise: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["deploy", "check", str(precise), "--episodes", "1", "--drop", "1", "--delay", "0.2"]) == cli.DONE
    said = " ".join(capsys.readouterr().out.split())
    assert "The controller gave no command: no measurement came to it." in said
    assert "swings about its goal where measurements are later" in said


class Turning:
    """A link whose controller turns the arm at a share of its full speed, and loses every third command on its way."""

    problem = ""

    def __init__(self, plant: Plant, share: float) -> None:
        self.most = share * plant.speed * plant.period
        self.made = 0

    def begin(self, q: np.ndarray) -> None:
        self.command = q

    def send(self, measurement: Measurement) -> None:
        del measurement
        self.command = self.command + self.most
        self.made += 1

    def receive(self) -> list[np.ndarray]:
        return [] if self.made % 3 == 0 else [self.command]


@pytest.mark.parametrize(("share", "kept"), [(1.0, True), (1.2, False)])
def test_a_command_that_is_lost_on_its_way_breaks_no_limit_and_one_that_is_too_fast_does(
    share: float, kept: bool
) -> None:
    plant = Plant(configure("precise", max_steps=20), seed=0)
    outcome = drive(plant, Turning(plant, share), Faults(), 1)
    plant.close()
    assert (outcome.cycles, outcome.in_time) == (20, 14)
    assert outcome.broken == (0 if kept else outcome.in_time)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "least"), [("panda/push", 2), ("panda/place", 0), ("so101/pose", 3)])
def test_a_controller_judges_every_step_as_the_task_does(name: str, least: int, tmp_path: Path) -> None:
    export(name, tmp_path / "policy")
    controller, plant = Controller(tmp_path / "policy"), Plant(settings_of(tmp_path / "policy", None), seed=5000)
    successes = 0
    for number in range(3):
        plant.begin(number)
        controller.reset(plant.q)
        done = success = False
        for step in range(plant.steps):
            told = plant.measure()
            controller.step(told.q, told.qd, told.goal, step * plant.period, **told.beside)
            assert controller.arrival.reached == success
            done, success = plant.step(controller.motion.position)
        assert done
        successes += success
    plant.close()
    assert successes >= least


def test_a_check_over_ros_2_is_heard_by_no_arm_and_no_other_check() -> None:
    own, usual = set(vars(own_topics()).values()), set(vars(Topics()).values())
    assert len(own) == len(usual)
    assert all(name.startswith(f"reachlab_check_{os.getpid()}/") for name in own)


@pytest.mark.slow
@pytest.mark.parametrize("task", ["precise", "push", "clutter", "wrench"])
def test_the_loop_runs_over_ros_2(task: str, precise: Path, tmp_path: Path) -> None:
    policy = precise if task == "precise" else tmp_path / "policy"
    if task in ("push", "wrench"):
        written(policy, "push", robot="panda", shaping=True, wrench=task == "wrench")
    elif task == "clutter":
        export("panda/clutter", policy)
    began = time.monotonic()
    episodes = "4" if task == "clutter" else "2"
    words = [sys.executable, "-m", "reachlab", "deploy", "check", str(policy), "--over-ros2", "--episodes", episodes]
    done = subprocess.run([*words, "--json"], capture_output=True, text=True, check=False)
    assert done.returncode == cli.DONE, done.stderr
    result = json.loads(done.stdout)
    assert result["broken"] <= 5, "what comes late on a busy computer, and then with the next"
    assert result["in_time"] > 0.5, "most commands come in time also where much else is computed"
    if task == "clutter":  # an arm that was told no obstacles is held; of late commands, some do harm
        assert result["success_rate"] >= (1.0 if result["in_time"] > 0.97 else 0.25), done.stdout
    assert time.monotonic() - began > 4, "it is real time"


def test_obstacles_come_through_markers_as_they_are_told() -> None:
    pytest.importorskip("rclpy")
    from visualization_msgs.msg import Marker, MarkerArray

    half = np.sqrt(0.5)
    told = [
        {"position": [0.5, 0.1, 0.2], "half": [0.1, 0.02, 0.3], "quaternion": [half, 0.0, 0.0, half]},
        {"position": [0.4, -0.2, 0.5], "radius": 0.05},
        {"position": [0.3, 0.2, 0.1], "half": [0.0, 0.0, 0.2], "radius": 0.04, "quaternion": [half, half, 0.0, 0.0]},
    ]
    markers = to_markers(told)
    came = placed(read_bodies(from_markers(markers, 3.0)), 4)
    expected = placed(read_bodies(told), 4)
    for name, numbers in expected.items():
        np.testing.assert_allclose(came[name], numbers, atol=1e-12)
    assert from_markers(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]), 3.0) == []
    with pytest.raises(ValueError, match="is deleted: each message has to hold all of them"):
        from_markers(MarkerArray(markers=[*markers.markers, Marker(action=Marker.DELETE)]), 3.0)
    cubes, flat = Marker(type=Marker.CUBE_LIST, id=9, ns="map"), Marker(type=Marker.SPHERE, id=9, ns="map")
    cubes.scale.x = cubes.scale.y = cubes.scale.z = 0.2
    for wrong in (cubes, flat):
        with pytest.raises(ValueError, match="marker 9 of 'map' has type"):
            from_markers(MarkerArray(markers=[wrong]), 3.0)


def test_the_node_holds_the_arm_until_obstacles_were_told(clutter: Path) -> None:
    pytest.importorskip("rclpy")
    from geometry_msgs.msg import PoseStamped
    from sensor_msgs.msg import JointState

    made, said = SimpleNamespace(publish=lambda _: None), list[str]()
    node = SimpleNamespace(
        **dict.fromkeys(("create_publisher", "create_subscription", "create_timer"), lambda *_: made),
        get_logger=lambda: SimpleNamespace(warning=said.append),
    )
    controller = Controller(clutter)
    policy = PolicyNode(node, controller, Topics(), trajectory=False, sees=True)
    goal = PoseStamped()
    goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = np.mean(controller.goal_box, axis=0).tolist()

    def step() -> None:
        here = controller.motion.position.tolist()
        policy._on_joints(JointState(name=controller.joints, position=here, velocity=[0.0] * len(here)))
        time.sleep(controller.period)

    step()
    policy._on_goal(goal)
    for _ in range(5):
        step()
    assert said[-1] == "no obstacles have come on 'reachlab/obstacles', and the arm is held where it is"
    policy._on_obstacles(to_markers([]))
    for _ in range(5):
        step()
    assert said[-1] == "all is well again"


# --- policies in ONNX -----------------------------------------------------------------------------


@pytest.mark.slow
def test_an_export_is_judged_like_its_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = lively_run(tmp_path / "run", "tutorial")
    export(run, tmp_path / "policy")
    words = ["--episodes", "50", "--seed", "3", "--json"]
    reports = []
    for policy in (tmp_path / "run", tmp_path / "policy", tmp_path / "policy" / "policy.onnx"):
        assert cli.main(["eval", str(policy), *words]) == cli.DONE
        reports.append(json.loads(capsys.readouterr().out))
    assert [report["agent"] for report in reports] == ["trained", "onnx", "onnx"]
    assert len({report["success_rate"] for report in reports}) == 1
    assert reports[1]["return_mean"] == pytest.approx(reports[0]["return_mean"], rel=1e-3)
    assert cli.main(["eval", str(tmp_path / "policy"), "--agent", "hybrid"]) == cli.WRONG_INPUT
    assert "agent 'hybrid' needs the policy of a run" in capsys.readouterr().err
    (tmp_path / "policy" / "planner.py").touch()
    assert cli.main(["eval", str(tmp_path / "policy"), "--episodes", "1"]) == cli.DONE
    assert "acts without its planner here" in capsys.readouterr().err


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy of another trainer: a small network of PyTorch's exporter."""
    torch = pytest.importorskip("torch")
    file = tmp_path_factory.mktemp("foreign") / "net.onnx"
    network = torch.nn.Sequential(torch.nn.Linear(6, 16), torch.nn.Tanh(), torch.nn.Linear(16, 3))
    given = {"input_names": ["x"], "output_names": ["y"], "dynamic_axes": {"x": {0: "n"}, "y": {0: "n"}}}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # its newer exporter needs another package
        torch.onnx.export(network, (torch.zeros(1, 6),), str(file), dynamo=False, **given)
    return file


def test_a_policy_of_another_trainer_gets_a_report(foreign: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["eval", str(foreign), "--task", "tutorial", "--episodes", "20", "--json"]) == cli.DONE
    report = json.loads(capsys.readouterr().out)
    assert report["agent"] == "onnx"
    assert report["success_interval"][0] < report["success_interval"][1]


def test_what_another_trainers_policy_observes_is_said_beside_it(
    foreign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["eval", str(foreign), "--task", "precise", "--episodes", "5"]) == cli.WRONG_INPUT
    assert "takes [6], and the environment observes [40]" in capsys.readouterr().err
    beside = foreign.with_name("policy.json")
    beside.write_text(json.dumps({"settings": {"task": "tutorial", "targets": "box"}}))
    try:
        assert cli.main(["eval", str(foreign), "--episodes", "20", "--json"]) == cli.DONE
        beside.write_text("{}")
        assert cli.main(["eval", str(foreign), "--episodes", "20"]) == cli.WRONG_INPUT
    finally:
        beside.unlink()


def test_a_file_that_is_no_policy_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.onnx").write_bytes(b"nothing")
    assert cli.main(["eval", str(tmp_path / "bad.onnx"), "--task", "precise"]) == cli.WRONG_INPUT
    assert "cannot be read as a policy in ONNX" in capsys.readouterr().err


def test_a_folder_without_a_controller_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no controller\.py|cannot be read"):
        check(tmp_path, sim=None, episodes=1, seed=1, faults=Faults())
