"""Settings that make no sense together are told before any time is spent."""

from __future__ import annotations

import itertools
import logging
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import reachlab
from reachlab.cli import main as cli
from reachlab.envs.consistency import check
from reachlab.envs.core import Env
from reachlab.envs.gymnasium_single import ReachEnv
from reachlab.envs.presets import configure, in_simulator
from reachlab.envs.random_streams import env_keys
from reachlab.envs.setup import check_reach, in_evaluation, make_setup, settled
from reachlab.envs.uses import USES
from reachlab.learn import learner
from reachlab.learn import train as training
from reachlab.learn.learner import check_memory
from reachlab.robots import loading
from reachlab.robots.derive.workspace import Derived
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import TUTORIAL_WORKSPACE
from reachlab.runs.directory import RunDirectory
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError
from reachlab.sims import SIMULATORS
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.reachability import survey
from reachlab.tasks.rewards import REWARDS
from reference import Arm

ARM = """
<mujoco>
  <worldbody>
    <body name="upper" pos="0 0 0.5">
      <joint axis="0 0 1" range="-90 90"/><geom size="0.02"/>
      <body name="lower" pos="0.4 0 0"><joint axis="0 1 0" range="-60 60"/><geom size="0.02"/>
        <body name="hand" pos="0.3 0 0"><geom size="0.02"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>"""

URDF = """
<robot name="two">
  <link name="base"/><link name="arm"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="2" effort="50" velocity="3"/></joint>
  <joint name="bend" type="revolute"><parent link="arm"/><child link="fore"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="50" velocity="3"/></joint>
</robot>"""


LOGGERS = ("reachlab.envs.setup", "reachlab.envs.consistency")


def said(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.name in LOGGERS]


# --- settings -------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", TASKS)
def test_presets_trouble_nobody_whatever_is_chosen_with_them(task: str, caplog: pytest.LogCaptureFixture) -> None:
    rules = TASKS[task].load()()
    given = {sim: rules.gives | entry.gives | ACTIONS[rules.action].gives for sim, entry in SIMULATORS.items()}
    sims = [sim for sim, words in given.items() if rules.task().needs <= words]
    assert sims
    for sim, observation, reward in itertools.product(sims, OBSERVATIONS, REWARDS):
        if not OBSERVATIONS[observation].needs <= given[sim]:
            continue  # a goal that turns or moves, obstacles or an object
        check(configure(task, sim=sim, observation=observation, reward=reward))
    for sim in sims:
        check(in_simulator(configure(task), sim))
        in_evaluation(configure(task), sim)
    check_reach(configure(task))
    assert said(caplog) == []


WITHOUT_EFFECT: list[tuple[dict[str, Any], str]] = [
    *[
        (
            {"task": "clutter", "robot": "panda", "scene": ("wall",), "action": "heading", name: value},
            f"{name} has an effect only with action tool_delta or tool_step or joint_delta",
        )
        for name, value in {
            "epochs": 3,
            "minibatches": 2,
            "gamma": 0.5,
            "gae_lambda": 0.5,
            "clip_ratio": 0.7,
            "value_weight": 0.1,
            "entropy_weight": 1.0,
            "final_std": 0.5,
        }.items()
    ],
    ({"joint_scale": 0.1}, "joint_scale has an effect only with action joint_delta or joint_residual"),
    ({"action": "joint_delta", "tool_scale": 0.1}, "tool_scale has an effect only with action tool_delta or tool_step"),
    ({"targets": "box", "target_height": 0.1}, "target_height has an effect only with targets table"),
    ({"target_low": (0.4, 0.0, 0.2)}, "target_low has an effect only with targets box"),
    ({"target_high": (0.4, 0.0, 0.2)}, "target_high has an effect only with targets box"),
    ({"hold_speed": 0.1}, "hold_speed has an effect only with reward precise"),
    ({"reward": "sparse", "approach_weight": 1.0}, "approach_weight has an effect only with reward dense or precise"),
    ({"closeness_weight": 1.0}, "closeness_weight has an effect only with reward precise"),
    ({"closeness_scale": 1.0}, "closeness_scale has an effect only with reward precise"),
    ({"effort_weight": 1.0}, "effort_weight has an effect only with reward precise"),
    ({"physics_steps": 2}, "physics_steps has an effect only with sim mujoco"),
    ({"collisions": True}, "collisions has an effect only with sim mujoco"),
    ({"gravity_compensation": True, "sim": "pybullet"}, "gravity_compensation has an effect only with sim mujoco"),
    ({"servo_lag": 0.05}, "servo_lag has an effect only with sim mujoco"),
    ({"randomise": ("lag",)}, "randomise lag needs arms that differ, as in simulator mujoco: in 'kinematic' all"),
    ({"gui": True}, "gui has an effect only with sim pybullet"),
    ({"slow": True, "sim": "mujoco"}, "slow has an effect only with sim pybullet"),
    ({"success_angle": 0.1}, "success_angle is a setting of task pose or clutter_pose, and not of tutorial"),
    ({"task": "precise", "angle_weight": 0.2}, "angle_weight is a setting of task pose or clutter_pose, and not"),
    (
        {"task": "pose", "targets": "any", "target_turn": (0.1, 0.1, 0.1)},
        "target_turn has an effect only with targets table or box",
    ),
    ({"goal_paths": ("line",)}, "goal_paths is a setting of task track, and not of tutorial"),
    ({"task": "precise", "goal_speed": (0.1, 0.1)}, "goal_speed is a setting of task track"),
    (
        {"task": "track", "goal_paths": ("jumps",), "goal_speed": (0.1, 0.1)},
        "an effect only with goal_paths line or circle or smooth",
    ),
    ({"task": "pose", "goal_jump": 0.1}, "goal_jump is a setting of task track"),
    (
        {"task": "track", "goal_paths": ("line",), "goal_jump": 0.1},
        "an effect only with goal_paths jumps",
    ),
    ({"goal_velocity": False}, "goal_velocity is a setting of task track"),
    ({"settle_steps": 10}, "settle_steps is a setting of task track"),
    ({"task": "precise", "obstacles": (0, 2)}, "obstacles is a setting of task clutter or clutter_pose, and not"),
    ({"end_on_contact": True}, "end_on_contact is a setting of task clutter"),
]

CONTRADICTIONS: list[tuple[dict[str, Any], str]] = [
    (
        {"task": "precise", "hold_steps": 200, "max_steps": 100},
        "cannot be held for hold_steps 200 in an episode of",
    ),
    ({"targets": "box", "target_low": (0.3, 0.5, 0.1), "target_high": (0.7, 0.4, 0.6)}, "in y, 0.5 against 0.4 m"),
    ({"num_envs": 10, "minibatches": 4}, "num_envs 10 cannot be divided among 4 minibatches"),
    ({"action_repeat": 11, "max_steps": 10}, "an action cannot be held for action_repeat 11"),
    ({"randomise": ("view",)}, "randomise view has an effect only with an observation with a picture"),
    ({"randomise": ("colour",)}, "randomise 'colour' is not one of: delay, dynamics, lag, objects, sight, view"),
    (
        {"task": "precise", "at_goal": "hold", "hold_steps": 5},
        "'hold' holds the arm at the target, and hold_steps 5",
    ),
    ({"at_goal": "stay"}, "at_goal 'stay' is not one of: continue, end, hold"),
    ({"targets": "floor"}, "targets 'floor' is not one of: any, box, table"),
    (
        {"task": "tutorail"},
        f"task 'tutorail' is not one of: {', '.join(sorted(TASKS))}. Did you mean 'tutorial'?",
    ),
    ({"task": "pose", "action": "tool_delta"}, "task 'pose' needs an action of the joints, as joint_delta"),
    ({"task": "pose", "target_turn": (0.1, -0.1, 0.0)}, "each entry of target_turn must be at least 0, got -0.1"),
    ({"observation": "pose"}, "observation 'pose' needs a goal whose joints are known, as of task pose or clutter"),
    ({"task": "pose", "observation": "track"}, "observation 'track' needs a goal that moves, as of task track"),
    ({"task": "clutter", "observation": "pose"}, "observation 'pose' needs a goal with an orientation"),
    (
        {"task": "precise", "observation": "clutter"},
        "observation 'clutter' needs bodies beside the arm, as in task clutter",
    ),
    ({"task": "clutter", "obstacles": (3, 2)}, "a fewest number above the most, 3 against 2: exchange them"),
    ({"task": "clutter", "obstacles": (0, 17)}, "each entry of obstacles must be at least 0 and at most 16, got 17"),
    ({"task": "clutter", "chained_starts": 0.5}, "with chained_starts 0.5 episodes would start inside bodies"),
    ({"task": "clutter", "sim": "kinematic"}, "task 'clutter' needs contacts, as in simulator mujoco"),
    ({"task": "clutter", "sim": "pybullet"}, "task 'clutter' needs contacts, as in simulator mujoco"),
    ({"task": "clutter", "targets": "table"}, "goals among obstacles are in a box: set targets to 'box'"),
    ({"task": "clutter", "target_turn": (0.1, 0.1, 0.1)}, "target_turn is a setting of task pose"),
    ({"task": "track", "goal_paths": ()}, "goal_paths names no path: choose one"),
    (
        {"task": "track", "goal_paths": ("line", "circel")},
        "goal path 'circel' is not one of: circle, jumps, line, smooth",
    ),
    ({"task": "track", "goal_speed": (0.2, 0.1)}, "a least speed above the largest, 0.2 against 0.1 m/s: exchange"),
    (
        {"task": "track", "settle_steps": 250},
        "no step would count after settle_steps 250 in an episode of max_steps 250",
    ),
    ({"task": "track", "targets": "any"}, "targets is a setting of task tutorial or precise or pose or clutter"),
    ({"task": "track", "hold_steps": 5}, "hold_steps is a setting of task precise or pose or clutter"),
    ({"targets": "any"}, "targets 'any' are poses: choose task 'pose'"),
]


@pytest.mark.parametrize(("settings", "sentence"), WITHOUT_EFFECT + CONTRADICTIONS, ids=str)
def test_what_makes_no_sense_is_refused_in_one_sentence(settings: dict[str, Any], sentence: str) -> None:
    for make in (lambda: check(configure(**settings)), lambda: ReachEnv(**settings)):
        with pytest.raises(InputError) as refused:
            make()
        assert sentence in str(refused.value)
        assert "\n" not in str(refused.value)


def test_a_corner_that_crosses_that_of_the_robots_own_box_is_refused() -> None:
    with pytest.raises(InputError, match=r"target_low is above target_high in y, 0.5 against 0.4 m"):
        make_setup(configure(targets="box", target_low=(0.3, 0.5, 0.1)))


def test_a_goal_does_not_move_in_a_flat_box() -> None:
    with pytest.raises(InputError, match=r"wide in every direction, and it goes from 0.3 to 0.3 m in z: choose other"):
        make_setup(configure("track", target_low=(0.3, -0.3, 0.3), target_high=(0.6, 0.3, 0.3)))


def test_every_setting_that_choices_use_is_tried() -> None:
    tried = {name for settings, _ in [*WITHOUT_EFFECT, *CONSEQUENCES] for name in settings}
    used = {
        name for choice, uses in USES.items() if choice != "stop_early" for names in uses.values() for name in names
    }
    assert used <= tried


def test_training_refuses_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="collisions has an effect only with sim mujoco"):
        training.train(configure(collisions=True), tmp_path / "run")
    assert not list(tmp_path.iterdir())


TOO_LARGE: list[dict[str, Any]] = [
    {"num_envs": 131072, "rollout_steps": 10**8},
    {"num_envs": 131072, "rollout_steps": 10**6, "hidden": (4096,) * 16},
]


@pytest.mark.parametrize("settings", TOO_LARGE, ids=str)
def test_what_no_memory_holds_is_refused_before_anything_is_made(settings: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"num_envs 131,072 with .* need at least [\d,]+ GB of memory, and there are"):
        training.train(configure(**settings), tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_a_container_has_less_memory_than_its_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = configure(num_envs=1024, rollout_steps=1024)
    check_memory(config, make_setup(config))
    monkeypatch.setattr(learner, "CONTAINER", tmp_path / "memory.max")
    (tmp_path / "memory.max").write_text(str(2**28))
    with pytest.raises(InputError, match="GB of memory"):
        check_memory(config, make_setup(config))


CONSEQUENCES: list[tuple[dict[str, Any], str]] = [
    ({"randomise": ("dynamics",)}, "randomise dynamics adds noise to what is measured and nothing else in simulator"),
    ({"randomise": ("dynamics",), "sim": "pybullet"}, "nothing else in simulator 'pybullet'"),
    ({"total_steps": 1000, "anneal_steps": 2000}, "before the learning rate has fallen to its end after anneal_steps"),
    ({"stop_early": False, "stop_success": 0.5}, "stop_success has an effect only with stop_early"),
]


@pytest.mark.parametrize(("settings", "sentence"), CONSEQUENCES, ids=str)
def test_what_follows_is_said_once(settings: dict[str, Any], sentence: str, caplog: pytest.LogCaptureFixture) -> None:
    check(configure(**settings))
    (only,) = said(caplog)
    assert sentence in only


@pytest.mark.parametrize(
    ("sim", "flags", "sentence"),
    [
        ("kinematic", {"gui": True}, "gui has an effect only with sim pybullet"),
        ("mujoco", {"slow": True}, "slow has an effect only with sim pybullet"),
        ("mujoco", {"randomise": ("view",)}, "randomise view has an effect only with an observation with a picture"),
        ("mujocco", {}, "Did you mean 'mujoco'"),
    ],
)
def test_flags_of_an_evaluation_are_checked_too(sim: str, flags: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        in_evaluation(configure(), sim, **flags)


def test_what_a_run_was_trained_with_does_not_hinder_its_evaluation_elsewhere(
    caplog: pytest.LogCaptureFixture,
) -> None:
    trained = configure("precise", collisions=True, physics_steps=3)
    for sim in SIMULATORS:
        config = in_evaluation(trained, sim)
        assert (config.sim, config.randomise) == (sim, ())
    assert said(caplog) == []
    assert in_evaluation(trained, "kinematic", randomise=("dynamics",)).randomise == ("dynamics",)
    assert len(said(caplog)) == 1


@pytest.mark.parametrize(("chosen", "elsewhere"), [(1 / 240, 0.02), (0.01, 0.01)])
def test_a_control_period_of_ones_own_is_kept_in_another_simulator(chosen: float, elsewhere: float) -> None:
    assert in_simulator(configure(control_period=chosen), "mujoco").physics.control_period == elsewhere


@pytest.mark.slow
def test_settings_of_an_older_run_are_not_asked_about_when_it_goes_on(tmp_path: Path) -> None:
    small: dict[str, Any] = {
        "total_steps": 256,
        "num_envs": 8,
        "rollout_steps": 8,
        "report_episodes": 2,
        "max_steps": 20,
    }
    config = configure(**small, collisions=True)
    RunDirectory(tmp_path / "run").create(settled(config, make_setup(config)))
    assert training.train(config, tmp_path / "run", resume=True).steps == 256


# --- reach ----------------------------------------------------------------------------------------


def reached(config: RunConfig) -> float:
    return survey(make_setup(config)).reached


@pytest.mark.parametrize(
    ("settings", "low", "high"),
    [
        ({}, 1.0, 1.0),
        ({"task": "precise"}, 1.0, 1.0),
        ({"targets": "box", "target_low": (2.0, 2.0, 2.0), "target_high": (3.0, 3.0, 3.0)}, 0.0, 0.0),
        ({"target_height": 1.0}, 0.0, 0.0),
        # The table lies 8.3 mm below the workspace, which the tool must not leave.
        ({"success_distance": 0.008}, 0.0, 0.0),
        ({"success_distance": 0.009}, 1.0, 1.0),
        # The arm reaches about 0.85 m from its shoulder: much of this box is beyond.
        ({"task": "precise", "target_high": (1.2, 0.4, 0.6)}, 0.5, 0.8),
    ],
    ids=str,
)
def test_of_the_targets_the_share_in_reach_is_known(settings: dict[str, Any], low: float, high: float) -> None:
    assert low <= reached(configure(**settings)) <= high


def test_the_share_in_reach_is_that_of_a_long_arm_by_geometry(tmp_path: Path) -> None:
    """Two links: the tool is 0.4 m to 0.7 m from the axis only where the elbow's bend says how high it is."""
    (tmp_path / "arm.xml").write_text(ARM)
    points = {"target_low": (0.4, -0.1, 0.5), "target_high": (0.9, 0.1, 0.5)}
    config = configure("precise", robot=str(tmp_path / "arm.xml"), tool="hand", **points, success_distance=0.02)
    drawn = np.random.default_rng(0).uniform(points["target_low"], points["target_high"], (2000, 3))
    bends = np.linspace(-np.pi / 3, np.pi / 3, 2001)
    circle = np.stack([0.4 + 0.3 * np.cos(bends), -0.3 * np.sin(bends)])
    radius = np.hypot(drawn[:, 0], drawn[:, 1])
    truth = [np.hypot(circle[0] - r, circle[1]).min() < 0.02 for r in radius]
    assert reached(config) == pytest.approx(np.mean(truth), abs=0.03)


def test_a_box_out_of_reach_is_refused_and_a_share_is_said(caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(InputError, match=r"none of the targets, \(0.2, -0.3, 1\) to \(0.7, 0.3, 1\) m, can be reached"):
        check_reach(configure(target_height=1.0))
    check_reach(configure("precise", target_high=(1.2, 0.4, 0.6)))
    check_reach(configure("precise", target_high=(0.6, 0.4, 0.6)))
    partly, wholly = said(caplog)
    assert "% of 256 random targets; the others fail whatever is learnt." in partly
    assert wholly.endswith("the arm can reach 100 % of 256 random targets.")


def test_the_share_of_starts_outside_the_workspace_is_said(caplog: pytest.LogCaptureFixture) -> None:
    check_reach(configure(start_noise=0.5))
    found = re.search(r"([0-9.]+) % of the episodes begin with the tool outside its workspace", said(caplog)[-1])
    robot = load_robot("iiwa14")
    starts = robot.home + np.random.default_rng(3).uniform(-0.5, 0.5, (4000, robot.chain.n))
    starts = np.clip(starts, robot.chain.lower, robot.chain.upper)
    tools, _ = Arm(mujoco.MjModel.from_xml_path(str(robot.model.file)), robot.tool).forward(starts)
    truth = ((tools < robot.workspace[0]) | (tools > robot.workspace[1])).any(axis=1).mean()
    assert found
    assert float(found[1]) == pytest.approx(100 * truth, abs=10)


# --- files of one's own ---------------------------------------------------------------------------


def test_a_robot_file_is_found_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "here/arm.xml").write_text(ARM)
    monkeypatch.chdir(tmp_path / "here")
    RunDirectory(tmp_path / "run").create(configure(robot="arm.xml"))
    monkeypatch.chdir(tmp_path)
    config = RunDirectory(tmp_path / "run").read_config()
    assert load_robot(config.robot).tool == "hand"
    (tmp_path / "here/arm.xml").unlink()
    with pytest.raises(InputError, match=r"robot file '/.*/here/arm.xml' does not exist: put it there"):
        load_robot(config.robot, "base")


def test_a_file_that_changed_is_loaded_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nowhere = Derived((0.0, 0.0), (1.0, 0.0, 0.0, 0.0), TUTORIAL_WORKSPACE, TUTORIAL_WORKSPACE, {})
    monkeypatch.setattr(loading, "_derived", lambda *_: nowhere)
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    first = load_robot(str(file))
    assert load_robot(str(file)) is first
    file.write_text(ARM.replace('pos="0.3 0 0"', 'pos="0.6 0 0"'))
    assert load_robot(str(file)).chain.longest == pytest.approx(first.chain.longest + 0.3)


@pytest.fixture
def changed(tmp_path: Path) -> Path:
    """A run whose robot file was edited since."""
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    run = RunDirectory(tmp_path / "run")
    run.create(configure(robot=str(file)))
    file.write_text(ARM.replace('axis="0 1 0"', 'axis="0 -1 0"'))
    return run.path


@pytest.mark.parametrize("command", ["eval {}", "view {}", "video {}", "export {}", "train --resume {}"])
def test_a_run_whose_robot_file_changed_is_refused(
    changed: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(command.format(changed).split()) == cli.WRONG_INPUT
    said = capsys.readouterr().err
    assert f"robot file '{changed.parent}/arm.xml', or a file that it names, has changed since. Train a new" in said
    assert said.count("\n") == 1


def test_the_run_of_a_robot_file_that_is_restored_or_of_an_earlier_version_is_read(changed: Path) -> None:
    run, file = RunDirectory(changed), changed.parent / "arm.xml"
    with pytest.raises(InputError, match="restore what was there"):
        reachlab.load(changed)
    edited = file.read_text()
    file.write_text(ARM)
    assert run.read_config().robot == str(file)
    file.write_text(edited)
    run.robot_file.unlink()
    assert run.read_config().robot == str(file)


def test_a_mesh_of_a_package_that_is_missing_is_left_out_and_told(tmp_path: Path) -> None:
    mesh = '<visual><geometry><mesh filename="package://x/y.obj"/></geometry></visual>'
    (tmp_path / "arm.urdf").write_text(URDF.replace('<link name="fore">', f'<link name="fore">{mesh}'))
    robot = load_robot(str(tmp_path / "arm.urdf"))
    assert robot.spec().compile().nmesh == 0
    missing = r"not found in the folders of their packages, which --package NAME=FOLDER says \(package://[^)]*y\.obj\)"
    assert any(re.search(missing, notice) for notice in robot.notices)


@pytest.mark.parametrize(("name", "text"), [("arm.xml", ARM), ("arm.urdf", URDF)])
def test_an_own_arm_is_perturbed_with_a_payload(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    tool = "hand" if name == "arm.xml" else "fore"
    env = Env(configure("precise", robot=str(tmp_path / name), tool=tool), 2)
    state = env.init(env_keys(0, 2))
    for _ in range(20):
        state, _ = env.step(state, np.zeros((2, 2), np.float32))
    assert state.arm.q[0] != pytest.approx(np.asarray(state.arm.q[1])), "arms differ"


@pytest.mark.slow
def test_a_command_tells_what_follows_on_standard_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    flags = [
        "--num-envs",
        "8",
        "--rollout-steps",
        "8",
        "--total-steps",
        "64",
        "--report-episodes",
        "2",
        "--max-steps",
        "9",
    ]
    assert cli.main(["train", *flags, "--randomise", "dynamics", "--json", "--out", str(tmp_path / "run")]) == cli.DONE
    assert capsys.readouterr().out.startswith("{")
    assert "arms differ with --sim mujoco" in said(caplog)[0]
