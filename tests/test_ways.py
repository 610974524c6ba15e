"""The controller of an export with a planner beside its policy: real processes, and faults of theirs."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from benchmarks.deploy import lively_run
from reachlab.control.contact_model import add_contacts, arm_of
from reachlab.control.motion_limits import MotionLimits
from reachlab.control.planning.branches import branches
from reachlab.control.planning.collision import NEAR, CollisionChecker
from reachlab.control.planning.plans import Plans
from reachlab.control.planning.timing import smoothed
from reachlab.deploy import bundle
from reachlab.deploy.check import settings_of
from reachlab.deploy.export import export
from reachlab.deploy.onboard.controller import Controller
from reachlab.deploy.onboard.log import read_log
from reachlab.deploy.onboard.ways import DEADLINE, LOOK, PLACED, STILL, Told, Way
from reachlab.deploy.plant import Plant
from reachlab.robots.catalogue import ROBOTS
from reachlab.robots.loading import load_robot
from reachlab.settings.validation import InputError

WALL = [{"position": [0.45, 0.0, 0.3], "half": [0.15, 0.02, 0.3]}]
"""A wall between left and right of a Panda."""

START, GOAL = [0.9, 0.4, 0.0, -1.9, 0.0, 2.3, 0.8], [0.45, -0.4, 0.3]
"""Joints on one side of it, and a point on the other."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export("panda/clutter", tmp_path_factory.mktemp("hybrid") / "policy").folder


@pytest.fixture
def controller(folder: Path) -> Iterator[Controller]:
    made = Controller(folder)
    yield made
    made.close()


class Arm:
    """An arm whose joints take a share of their way to a command in a step."""

    def __init__(self, controller: Controller, *, paced: bool = True) -> None:
        self.controller, self.paced, self.q, self.qd = controller, paced, np.array(START), np.zeros(7)
        self.share, self.clock, self.path = 1 - np.exp(-controller.period / 0.1), 0.0, [self.q]
        controller.reset(START)

    def step(self, goal: Any = GOAL, obstacles: Any = WALL, **more: Any) -> np.ndarray:
        command = self.controller.step(self.q, self.qd, goal, self.clock, obstacles=obstacles, **more)
        moved = self.share * (command - self.q)
        self.q, self.qd = self.q + moved, moved / self.controller.period
        self.clock += self.controller.period
        self.path.append(self.q)
        if self.paced:
            time.sleep(self.controller.period / 2)
        return command

    def distance(self, goal: Any = GOAL) -> float:
        return float(np.linalg.norm(np.subtract(self.controller._tool(self.q.tolist())[0], goal)))


def mode(controller: Controller) -> str:
    assert controller._way is not None
    return controller._way._mode


def way_of(controller: Controller) -> Way:
    assert controller._way is not None
    return controller._way


def touches(path: list[np.ndarray], obstacles: list[dict[str, Any]], robot: str = "panda") -> bool:
    checker = CollisionChecker(arm_of(load_robot(robot)), len(obstacles))
    rows = [(6, one["position"], [1.0, 0.0, 0.0, 0.0], one["half"]) for one in obstacles]
    parts = [np.array(part) for part in zip(*rows, strict=True)]
    bodies: Any = type("Bodies", (), dict(zip(("kind", "position", "quaternion", "size"), parts, strict=True)))
    checker.place(bodies)
    return not all(checker.free(q) for q in path)


# --- what it does ---------------------------------------------------------------------------------


def test_it_comes_round_a_wall_that_its_policy_does_not_pass(folder: Path, controller: Controller) -> None:
    alone = Arm(Controller(folder, planner=False), paced=False)
    for _ in range(250):
        alone.step()
    assert alone.distance() > 0.1, "else this test asks for nothing"
    arm, modes, widest = Arm(controller), [], np.zeros(7)
    for _ in range(250):
        before = controller.motion.speed.copy()
        command = arm.step()
        assert controller.problem == ""
        modes.append(mode(controller))
        widest = np.maximum(widest, np.abs(controller.motion.speed - before) / controller.period)
        assert np.isfinite(command).all()
    assert arm.distance() < 0.005
    assert not touches(arm.path, WALL)
    assert {"wait", "follow"} <= set(modes)
    assert (widest <= controller.limits.acceleration * (1 + 1e-6)).all()


def test_the_policy_moves_first_and_goes_on_where_nothing_is_in_its_way(controller: Controller) -> None:
    arm, modes, first, goal = Arm(controller), [], None, [0.4, 0.0, 0.3]  # it gets there however late it is answered
    for step in range(150):
        arm.step(goal, obstacles=[])
        modes.append(mode(controller))
        if first is None and np.abs(controller.motion.speed).max() > 0:
            first = step
            assert modes[-1] == "wait", "its first command is given while the planner is asked"
    assert arm.distance(goal) < 0.005
    assert modes[-1] == "policy"
    assert "follow" not in modes


def test_a_motion_begins_at_rest_where_it_was_planned_from_though_the_goal_changed_on_the_way(
    controller: Controller,
) -> None:
    arm, begun, way = Arm(controller), [], way_of(controller)
    there_and_back = [GOAL, [0.45, 0.4, 0.3]]
    for part in range(4):
        for _ in range(45):
            before = controller.motion
            arm.step(there_and_back[part % 2])
            if way._motion is not None and mode(controller) == "follow" and way._step == 1:
                begun.append((np.abs(before.position - way._motion.command[0]).max(), np.abs(before.speed).max()))
    assert len(begun) >= 3, "else nothing was planned on the way"
    assert max(aside for aside, _ in begun) <= PLACED
    assert max(speed for _, speed in begun) <= STILL


def test_a_planner_that_hangs_is_asked_once_however_often_the_controller_is_reset(controller: Controller) -> None:
    asked, way = list[Any](), way_of(controller)
    way.planner.close()
    way.planner = SimpleNamespace(ask=asked.append, answer=lambda: None, close=lambda: None)
    for number in range(50):
        arm = Arm(controller, paced=False)  # which resets it
        for _ in range(3):
            arm.step([0.45, -0.4 + 0.001 * number, 0.3])
    assert len(asked) == 1, "a pipe that nobody reads is full some day, and then a step would wait"
    arm = Arm(controller, paced=False)
    for _ in range(round(DEADLINE / controller.period) + 5):
        arm.step()
    assert "the planner has not answered for 5 s" in controller.problem


def test_a_body_that_moves_into_its_way_has_it_planned_again(controller: Controller) -> None:
    arm = Arm(controller)
    for _ in range(200):
        arm.step()
        if mode(controller) == "follow":
            break
    assert controller._way is not None
    motion = controller._way._motion
    assert motion is not None
    tool = controller._tool(motion.q[len(motion.q) * 2 // 3].tolist())[0]
    there = [*WALL, {"position": list(tool), "half": [0.03, 0.03, 0.03]}]
    for _ in range(400):
        arm.step(obstacles=there)
        assert controller.problem == ""
    assert controller._way._motion is not motion
    assert not touches(arm.path[-300:], there)
    assert arm.distance() < 0.005


def test_where_there_is_no_way_it_says_so_until_there_is_one(controller: Controller) -> None:
    arm, box = Arm(controller), [{"position": GOAL, "half": [0.15, 0.15, 0.15]}]
    for _ in range(1000):
        arm.step(obstacles=box)
        if controller.problem:
            break
    assert controller.problem == "the planner finds no way to the goal"
    assert controller.braking
    for _ in range(20):
        arm.step(obstacles=box)
    np.testing.assert_allclose(controller.motion.speed, 0.0, atol=1e-12)
    for _ in range(300):
        arm.step(obstacles=WALL)
    assert controller.problem == ""
    assert arm.distance() < 0.005


def test_a_policy_that_comes_no_nearer_is_taken_over_from(
    controller: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, way = Arm(controller), controller._way
    assert way is not None
    answer = way.planner.answer

    def hopeful() -> Any:
        told = answer()
        return {"number": told["number"], "policy": True} if told and "q" in told and way._trust else told

    monkeypatch.setattr(way.planner, "answer", hopeful)
    modes = []
    for _ in range(500):
        arm.step()
        modes.append(mode(controller))
    assert modes.index("policy") < modes.index("follow")
    assert arm.distance() < 0.005


def test_after_measurements_were_lost_it_plans_from_where_it_stands(controller: Controller) -> None:
    arm = Arm(controller)
    while mode(controller) != "follow":
        arm.step()
    for _ in range(15):
        arm.step()
    q = arm.q
    for _ in range(30):
        controller.step(None, None, GOAL, arm.clock, obstacles=WALL)
        arm.clock += controller.period
    assert controller.braking
    arm.q, arm.qd = controller.motion.position, np.zeros(7)
    assert np.abs(arm.q - q).max() > 0.0
    for _ in range(300):
        arm.step()
    assert arm.distance() < 0.005
    assert not touches(arm.path, WALL)


def test_after_a_clock_that_ran_back_it_plans_anew(controller: Controller) -> None:
    arm = Arm(controller)
    while mode(controller) != "follow":
        arm.step()
    for _ in range(5):
        arm.step()
    arm.clock -= 10.0
    arm.step()
    assert controller.problem.startswith("the clock runs back")
    while controller.braking:
        assert mode(controller) == "follow"
        arm.step()
    assert mode(controller) != "follow", "the arm has left the motion"
    for _ in range(200):
        arm.step()
    assert arm.distance() < 0.005
    assert not touches(arm.path, WALL)


def test_a_log_is_taken_again_to_the_last_bit(folder: Path, controller: Controller, tmp_path: Path) -> None:
    arm = Arm(controller)
    for _ in range(150):
        arm.step()
    controller.save_log(tmp_path / "log.jsonl")
    answers = [
        entry["planned"] for entry in read_log(tmp_path / "log.jsonl", controller._policy) if entry.get("planned")
    ]
    assert any("q" in answer for answer in answers)
    again = Controller(folder)
    assert again.replay(tmp_path / "log.jsonl") == 0.0
    again.close()


def test_it_keeps_limits_that_were_lowered(folder: Path, tmp_path: Path) -> None:
    slow = tmp_path / "policy"
    shutil.copytree(folder, slow)
    facts = json.loads((slow / "policy.json").read_text())
    for limits in facts["limits"].values():
        limits["speed"], limits["acceleration"] = 0.5 * limits["speed"], 0.3 * limits["acceleration"]
    (slow / "policy.json").write_text(json.dumps(facts))
    made = Controller(slow)
    arm, away = Arm(made), 0.0
    for _ in range(400):
        arm.step()
        assert made.problem == ""
        if mode(made) == "follow" and made._way is not None and made._way._motion is not None:
            q = made._way._motion.q
            away = max(away, np.abs(arm.q - q[min(made._way._step, len(q) - 1)]).max())
    assert arm.distance() < 0.005
    assert not touches(arm.path, WALL)
    assert away < 0.03
    made.close()


# --- faults ---------------------------------------------------------------------------------------


def test_without_ompl_it_brakes_and_says_so_and_runs_the_policy_alone_if_asked(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "policy"
    shutil.copytree(folder, copy)
    (copy / "ompl.py").write_text("raise ModuleNotFoundError('ompl')\n")
    made = Controller(copy)
    arm = Arm(made)
    for _ in range(40):
        arm.step(obstacles=[])
    assert made.problem.startswith("the planner has ended: it needs mujoco, ompl and toppra")
    np.testing.assert_allclose(made.motion.speed, 0.0, atol=1e-12)
    alone = Controller(copy, planner=False)
    arm = Arm(alone, paced=False)
    for _ in range(150):
        arm.step(obstacles=[])
        assert alone.problem == ""
    assert arm.distance() < 0.005


def test_a_planner_that_is_killed_brakes_the_arm(controller: Controller) -> None:
    arm = Arm(controller)
    while mode(controller) != "follow":
        arm.step()
    assert controller._way is not None
    os.kill(controller._way.planner._process.pid, signal.SIGKILL)
    for _ in range(50):
        arm.step()
    assert controller.problem.startswith("the planner has ended")
    np.testing.assert_allclose(controller.motion.speed, 0.0, atol=1e-12)


def test_a_planner_that_does_not_answer_is_not_waited_for_in_a_step(controller: Controller) -> None:
    assert controller._way is not None
    controller._way.planner.close()
    controller._way.planner = Told()
    arm, longest = Arm(controller, paced=False), 0.0
    arm.step()
    arm.clock -= 1000.0  # what a clock does that runs back
    for _ in range(round(DEADLINE / controller.period) + 40):
        begun = time.perf_counter()
        arm.step()
        longest = max(longest, time.perf_counter() - begun)
    assert controller.problem == "the planner has not answered for 5 s"
    assert controller.braking
    assert longest < DEADLINE / 2


def test_its_process_ends_with_the_controller_and_with_its_parent(folder: Path) -> None:
    made = Controller(folder)
    assert made._way is not None
    process = made._way.planner._process
    assert process.poll() is None
    made.close()
    assert process.poll() is not None
    code = f"""
import sys, time
sys.path.insert(0, {str(folder)!r})
from controller import Controller
controller = Controller({str(folder)!r})
print(controller._way.planner._process.pid, flush=True)
time.sleep(600)
"""
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    assert running(child)
    parent.kill()
    parent.communicate()
    end = time.monotonic() + 30
    while running(child) and time.monotonic() < end:
        time.sleep(0.05)
    assert not running(child)


def running(process: int) -> bool:
    """Whether there is a process of that number, and it is more than an entry in a table."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_what_it_is_asked_is_answered_in_lines_whatever_libraries_print(folder: Path) -> None:
    command, pipe = [sys.executable, str(folder / "planner.py"), str(folder)], subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
    far = {"kind": [2], "position": [0.0, 0.0, -10.0], "quaternion": [1.0, 0.0, 0.0, 0.0], "size": [0.0, 0.0, 0.0]}
    request = {"start": START, "goal": [-one if not i else one for i, one in enumerate(START)], "policy": False}
    out, _ = process.communicate(json.dumps({**request, "number": 7, "bodies": far}) + "\n", timeout=120)
    ready, answer = map(json.loads, out.splitlines())
    assert ready == {"ready": True}
    assert answer["number"] == 7
    np.testing.assert_allclose(answer["q"][0], START, atol=1e-6)


# --- what is exported -----------------------------------------------------------------------------


def test_a_planner_is_exported_where_there_is_something_to_plan(folder: Path, tmp_path: Path) -> None:
    assert "planner.py" in json.loads((folder / "policy.json").read_text())["files"], "its hash is looked at"
    assert not (export("panda/clutter", tmp_path / "alone", "trained").folder / "planner.py").exists()
    with pytest.raises(InputError, match="agent 'hybrid' is exported for goals whose joints are known"):
        export("panda/precise", tmp_path / "precise", "hybrid")
    with pytest.raises(InputError, match="agent of an export 'planner' is not one of: hybrid, trained"):
        export("panda/precise", tmp_path / "precise", "planner")
    assert not (tmp_path / "precise").exists()


def test_names_that_are_defined_twice_are_refused() -> None:
    sources = {"reachlab.one": '"""One."""\n\nSAME = 1\n', "reachlab.two": '"""Two."""\n\nSAME = 2\n'}
    with pytest.raises(ValueError, match="define SAME twice"):
        bundle._joined(sources, {})
    assert "from controller import" in bundle.planner_source()


@pytest.mark.usefixtures("few_scenes")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "scene"), [("panda", "bin"), ("ur5e", "shelf"), ("iiwa14", "posts"), ("panda", "pose")]
)
def test_held_out_scenes_are_solved(robot: str, scene: str, tmp_path: Path) -> None:
    run = f"{robot}/clutter"
    if scene == "pose":  # no policy comes with it: one that has learnt nothing
        run, scene = lively_run(tmp_path / "run", "clutter_pose", robot=robot), "shelf"
    made = export(run, tmp_path / "policy", scene=(scene,)).folder
    plant, controller = Plant(settings_of(made, None), 1), Controller(made)
    for number in range(6):
        plant.begin(number)
        controller.reset(plant.q)
        success = done = False
        for step in range(plant.steps):
            measured = plant.measure()
            given = measured.q, measured.qd, measured.goal, step * plant.period
            command = controller.step(*given, **measured.beside)
            time.sleep(10 * plant.period * (mode(controller) == "wait"))  # a slow machine's plans come as early
            done, success = plant.step(command)
            if done:
                break
        assert success, f"{robot} {scene} {number}: {controller.problem or mode(controller)}"
    plant.close()
    controller.close()


# --- what planning knows of an arm ----------------------------------------------------------------


@pytest.mark.parametrize("robot", sorted(ROBOTS))
def test_an_arm_in_plain_numbers_touches_what_the_engines_arm_touches(robot: str) -> None:
    made = load_robot(robot)
    arm, spec = arm_of(made), made.spec(pictures=False)
    add_contacts(spec, made, 2)
    model, checker = spec.compile(), CollisionChecker(arm, 2)
    data, n = mujoco.MjData(model), arm.n
    model.pair_margin[:] = NEAR
    near = 0
    for q in np.random.default_rng(1).uniform(arm.lower, arm.upper, (100, n)):
        data.qpos[:n] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        own = (model.geom_bodyid[data.contact.geom] > 0).all(axis=1)
        expected = [min(data.contact.dist[rows], default=0.1) for rows in (~own, own)]
        np.testing.assert_allclose(checker.distances(q), expected, atol=1e-9)
        near += min(expected) < 0.1
    assert near > 10


@pytest.mark.parametrize("robot", ["panda", "ur5e", "so101", "gen3"])
def test_branches_have_their_pose(robot: str) -> None:
    arm, rng = arm_of(load_robot(robot)), np.random.default_rng(0)
    tools = arm.links_at(rng.uniform(arm.lower, arm.upper, (40, arm.n)))[:, -1]
    found = branches(arm, tools[:, :3, 3], tools[:, :3, :3], rng)
    assert np.mean([len(one) > 0 for one in found]) > 0.85
    assert np.mean([len(one) for one in found]) > 3
    for tool, one in zip(tools, found, strict=True):
        there = arm.links_at(one)[:, -1]
        np.testing.assert_allclose(there[:, :3, 3], np.broadcast_to(tool[:3, 3], (len(one), 3)), atol=1.1e-5)
        if arm.poses:
            np.testing.assert_allclose(there[:, :3, :3], np.broadcast_to(tool[:3, :3], (len(one), 3, 3)), atol=2e-4)
        elif len(one):  # the tilt alone, where the hand points outward
            down = there[:, 2, :3] @ arm.approach
            assert np.abs(down - tool[2, :3] @ arm.approach).min() < 0.05
        assert ((arm.lower <= one) & (one <= arm.upper)).all()


def test_what_times_a_motion_says_nothing_where_python_compiles_it_anew(tmp_path: Path) -> None:
    program = """if True:
        import numpy as np
        from reachlab.control.planning.timing import timed
        assert timed(np.eye(3), np.ones(3), np.ones(3), 0.02) is not None
    """
    command = [sys.executable, "-W", "error", "-X", f"pycache_prefix={tmp_path}", "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("robot", ["panda", "ur5e", "iiwa14", "gen3"])
def test_commands_of_a_smoothed_motion_are_within_limits(robot: str) -> None:
    made = load_robot(robot)
    limits = MotionLimits(*made.commands, period=0.02)
    arm = arm_of(made, (0.1,) * made.chain.n, 0.02).within(limits)
    plans, rng = Plans(arm, 1, turns=True), np.random.default_rng(3)
    middle, half, lags = (arm.lower + arm.upper) / 2, np.minimum((arm.upper - arm.lower) / 2, 2.0), []
    for _ in range(5):
        path = middle + rng.uniform(-0.5, 0.5, (4, arm.n)) * half
        motion = plans._planner._timed(path, 1.0)
        assert motion is not None
        state = limits.at_rest(motion.command[0])
        for command in motion.command[1:]:
            state = limits.advance(state, command)
            lags.append(np.abs(state.position - command).max())
    assert max(lags) < 0.02


def test_smoothed_motions_end_where_they_lead() -> None:
    path = np.linspace([0.0, 1.0], [1.0, 0.0], 50)
    motion = smoothed(path, 5, np.array([0.2, 0.3]))
    for part in motion:
        np.testing.assert_allclose(part[0], path[0])
        np.testing.assert_allclose(part[-1], path[-1], atol=0.01)
    np.testing.assert_allclose(motion.q[1:], motion.q[:-1] + [0.2, 0.3] * (motion.command[1:] - motion.q[:-1]))


def test_a_look_that_takes_too_long_brakes_the_arm_until_it_is_answered(controller: Controller) -> None:
    arm, way = Arm(controller), controller._way
    assert way is not None
    while mode(controller) != "follow":
        arm.step()
    real, way.planner = way.planner, Told()
    there = [{**WALL[0], "position": [0.45, 0.001, 0.3]}]
    said = set()
    for _ in range(round(LOOK / controller.period) + 15):
        arm.step(obstacles=there)
        said.add(controller.problem)
    assert said == {"", "the planner has not answered for 0.2 s"}
    np.testing.assert_allclose(controller.motion.speed, 0.0, atol=1e-12)
    way.planner, way._outstanding = real, None
    for _ in range(300):
        arm.step(obstacles=there)
    assert controller.problem == ""
    assert arm.distance() < 0.005
    assert not touches(arm.path, there)
