"""The controller of an exported policy: what it loads, which limits hold, and what it makes of what it is given."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from faults.controllers import broken, hostile_commands, written
from reachlab.cli import main as cli
from reachlab.control.bodies import Shape
from reachlab.deploy.check import PipeLink, start_controller
from reachlab.deploy.onboard.aiming import Aim
from reachlab.deploy.onboard.bodies import GONE, OLD, Beside, placed
from reachlab.deploy.onboard.controller import NO_GOAL, Controller
from reachlab.deploy.onboard.reading import read_bodies
from reachlab.deploy.onboard.watching import FOLLOWED
from reachlab.deploy.onboard.ways import Told, Way
from reachlab.deploy.ros2 import PolicyNode
from reachlab.deploy.topics import Topics
from reachlab.settings.validation import InputError

GOAL = [0.5, 0.2, 0.4]
"""A goal in the workspace of the iiwa [m]."""

FIRST, SECOND = "joint_1", "joint_2"

Facts = dict[str, Any]


@pytest.fixture(scope="module")
def precise(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("precise") / "policy", "precise")


@pytest.fixture(scope="module")
def clutter(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("clutter") / "policy", "clutter", robot="ur5e")


@pytest.fixture
def folder(precise: Path, tmp_path: Path) -> Path:
    """A copy that may be changed."""
    return shutil.copytree(precise, tmp_path / "policy")


def change(folder: Path, edit: Callable[[Facts], Any]) -> None:
    facts = json.loads((folder / "policy.json").read_text())
    edit(facts)
    (folder / "policy.json").write_text(json.dumps(facts))


def limit(name: str, value: Any, joint: str = FIRST) -> Callable[[Facts], Any]:
    return lambda facts: facts["limits"][joint].update({name: value})


def play(controller: Any, steps: int, first: int = 0, **call: Any) -> list[str]:
    """Problems of so many steps of an arm that follows at once, from where the commands are."""
    q, problems = controller.motion.position, []
    qd = 0 * q
    for number in range(first, first + steps):
        given = {"q": q, "qd": qd, "goal": GOAL, "time": number * controller.period, **call}
        command = controller.step(**given)
        problems.append(controller.problem)
        q, qd = command, (command - q) / controller.period
    return problems


# --- the folder -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["policy.safetensors", "policy.onnx", "controller.py", "step.py", "reachlab_policy.c"])
def test_a_file_of_another_export_is_refused(
    folder: Path, clutter: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with (folder / name).open("ab") as file:
        file.write(b"\n")
    if name != "controller.py":
        shutil.copyfile(clutter / name, folder / name)
    with pytest.raises(ValueError, match=rf"{name}' is not the file that was exported with the policy.json"):
        Controller(folder)
    for words in (["deploy", "check"], ["eval"]):
        assert cli.main([*words, str(folder)]) == cli.WRONG_INPUT
        assert "different exports" in capsys.readouterr().err


def test_a_file_that_the_controller_does_not_need_may_be_absent(folder: Path) -> None:
    for name in ("policy.onnx", "README.md"):
        (folder / name).unlink()
    assert play(Controller(folder), 3) == [""] * 3
    (folder / "policy.safetensors").unlink()
    with pytest.raises(ValueError, match="does not hold the weights"):
        Controller(folder)


CHANGED: dict[str, tuple[Callable[[Facts], Any], str]] = {
    "arm": (lambda facts: facts["arm"]["home"].__setitem__(0, 0.5), "was changed beside its `limits`"),
    "widest": (lambda facts: facts["joints"][0]["widest"].update(speed=99.0), "was changed beside"),
    "hash": (lambda facts: facts["files"].update({"policy.onnx": "0"}), "was changed beside"),
    "no_hash": (lambda facts: facts.pop("sha256"), "is not complete"),
    "format": (lambda facts: facts.update(format=4), "has format 4, and formats 1 to 3 are read here"),
    "no_format": (lambda facts: facts.pop("format"), "cannot be read as what `reachlab export` wrote"),
    "upper": (limit("upper", 99.0), f"'{FIRST}'.*upper must be -2.9.* to 2.9.*, got 99.0.*never widened"),
    "lower": (limit("lower", -99), "lower must be"),
    "speed": (limit("speed", 99.0), "speed must be above 0 and at most 1.48.*, got 99.0"),
    "still": (limit("speed", 0), "speed must be above 0"),
    "acceleration": (limit("acceleration", -1.0), "acceleration must be above 0"),
    "jerk": (limit("jerk", 10**400), "jerk must be above 0"),
    "nan": (limit("speed", float("nan")), "speed must be a finite number, got nan"),
    "text": (limit("speed", "slow"), "speed must be a finite number, got 'slow'"),
    "crossed": (lambda facts: facts["limits"][FIRST].update(lower=1.0, upper=0.5), "lower must be below upper"),
    "missing": (lambda facts: facts["limits"][FIRST].pop("jerk"), "they must be lower, upper, speed"),
    "joint": (lambda facts: facts["limits"].pop(FIRST), f"must be those of the joints {FIRST}"),
    "list": (lambda facts: facts.update(limits=[1]), "limits"),
}


@pytest.mark.parametrize("name", CHANGED)
def test_a_description_that_was_changed_is_refused_in_one_sentence(folder: Path, name: str) -> None:
    edit, sentence = CHANGED[name]
    change(folder, edit)
    with pytest.raises(ValueError, match=sentence):
        Controller(folder)
    with pytest.raises(InputError, match=sentence):
        start_controller(folder)


@pytest.mark.parametrize("text", ["", "[]", "{", "\xff", "[" * 100_000], ids=["empty", "list", "half", "bytes", "deep"])
def test_a_description_that_is_none_is_refused(folder: Path, text: str) -> None:
    (folder / "policy.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match="cannot be read as what `reachlab export` wrote"):
        Controller(folder)


def test_limits_that_are_lowered_hold_and_are_all_that_is_shown(folder: Path) -> None:
    def lower(facts: Facts) -> None:
        for limits in facts["limits"].values():
            limits.update(speed=0.2, acceleration=1, lower=-0.3, upper=0.3)

    change(folder, lower)
    controller = Controller(folder)
    assert controller.limits.speed == pytest.approx(0.2)
    assert controller.limits.acceleration == pytest.approx(1.0)
    assert (controller.limits.lower == -0.3).all()
    with pytest.raises(ValueError, match=rf"'{SECOND}' is at 0.6, out of its limits -0.3 to 0.3"):
        controller.reset([0.0, 0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert hostile_commands(folder, 1500).wrong == []


def test_a_description_may_be_laid_out_anew(folder: Path) -> None:
    text = (folder / "policy.json").read_text()
    facts = json.loads(text, parse_float=lambda one: int(one[:-2]) if one.endswith(".0") else float(one))
    (folder / "policy.json").write_text(json.dumps(facts, sort_keys=True, indent=4))
    assert play(Controller(folder), 1) == [""]


def test_a_folder_of_a_format_before_names_its_own_controller() -> None:
    earlier = Path(__file__).parent / "earlier" / "format_1" / "clutter-export"
    with pytest.raises(ValueError, match=r"was exported by an earlier version: use the controller\.py of its own"):
        Controller(earlier)
    start_controller(earlier)


def test_a_check_whose_arm_begins_outside_lowered_limits_says_so() -> None:
    pipe = SimpleNamespace(send=lambda _: None, poll=lambda _: True, recv=lambda: "joint 'j1' is at 2")
    with pytest.raises(InputError, match="joint 'j1' is at 2"):
        PipeLink(pipe).begin(np.zeros(1))  # type: ignore[arg-type]


# --- obstacles ------------------------------------------------------------------------------------

BALL: dict[str, Any] = {"position": [0.4, 0.0, 0.3], "radius": 0.05}

BAD = {
    "radius": ({**BALL, "radius": -1}, "obstacle 2 must have a radius of at least 0 m, got -1"),
    "half": ({**BALL, "half": [0.1, -0.1, 0.1]}, r"a half of at least 0 m, got \[0.1, -0.1, 0.1\]"),
    "no_turn": ({**BALL, "quaternion": [0, 0, 0, 0]}, "a quaternion of length 1"),
    "long_turn": ({**BALL, "quaternion": [2, 0, 0, 0]}, "a quaternion of length 1"),
    "unknown": ({**BALL, "size": 0.1}, "has 'size', and an obstacle is made of position, quaternion, half, radius"),
    "nowhere": ({"radius": 0.1}, "has no position"),
    "short": ({**BALL, "half": [1.0]}, r"a half of 3 finite numbers, got \[1\]"),
    "nan": ({"position": [np.nan] * 3}, "a position of 3 finite numbers"),
    "none": ({**BALL, "radius": None}, "a radius of 1 finite numbers, got None"),
    "far": ({**BALL, "velocity": [0, 1e300, 0]}, r"a velocity within 100 m/s, got \[0, 1e\+300, 0\]: is it in mm/s"),
    "huge": ({**BALL, "radius": 10**400}, "a radius of 1 finite numbers, got not made of numbers"),
}


@pytest.mark.parametrize("name", BAD)
def test_an_obstacle_that_cannot_be_is_refused(name: str) -> None:
    obstacle, sentence = BAD[name]
    with pytest.raises(ValueError, match=sentence):
        placed(read_bodies([BALL, obstacle]), 4)


def test_more_obstacles_than_the_policy_knows_are_refused() -> None:
    with pytest.raises(ValueError, match="there are 3 obstacles, and the policy knows 2 at most"):
        placed(read_bodies([BALL] * 3), 2)


@pytest.mark.parametrize(
    ("obstacle", "kind", "size"),
    [
        ({"radius": 0.05}, Shape.BALL, [0.05, 0.0, 0.0]),
        ({"radius": 0.05, "half": [0.0, 0.0, 0.2]}, Shape.CAPSULE, [0.05, 0.2, 0.0]),
        ({"half": [0.1, 0.2, 0.3]}, Shape.BOX, [0.1, 0.2, 0.3]),
        ({"half": [0.1, 0.2, 0.3], "radius": 0.1}, Shape.BOX, [0.2, 0.3, 0.4]),
    ],
)
def test_an_obstacle_is_a_body(obstacle: dict[str, Any], kind: Shape, size: list[float]) -> None:
    body = placed(read_bodies([{"position": [1.0, 2.0, 3.0], **obstacle}]), 2)
    assert body["kind"] == [kind, Shape.BALL]
    assert body["size"][:3] == pytest.approx(size)
    assert body["position"][:3] == [1.0, 2.0, 3.0]
    assert body["position"][5] < 0, "the other is not there"


def test_a_quaternion_a_little_off_is_taken_as_a_turn() -> None:
    around = placed(read_bodies([{**BALL, "quaternion": [1.004, 0.0, 0.0, 0.0]}]), 1)
    assert around["quaternion"] == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("bad", ["wall", [1.0], [{**BALL, "radius": -1}]], ids=str)
def test_the_problem_stays_while_obstacles_stay_bad(clutter: Path, bad: Any) -> None:
    controller = Controller(clutter)
    middle = controller.goal_box.mean(axis=0)
    assert play(controller, 60, goal=middle, obstacles=[BALL])[-1] == ""
    problems = play(controller, 50, 60, goal=middle, obstacles=bad)
    assert len(set(problems)) == 1
    assert "obstacle" in problems[0]
    assert "Error" not in problems[0]
    assert controller.braking
    assert np.abs(controller.motion.speed).max() < 1e-9
    assert play(controller, 20, 110, goal=middle, obstacles=[BALL])[-1] == ""
    assert not controller.braking


# --- measurements ---------------------------------------------------------------------------------


class Raising:
    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("out of order")

    def __iter__(self) -> Any:
        raise KeyError("out of order")


class Sensor:
    """What is measured, in an object of its own."""

    def __init__(self, numbers: Any) -> None:
        self.numbers = np.array(numbers)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        del copy
        return self.numbers.astype(dtype)


MASKED = np.ma.array([0.1] * 7, mask=[True] + [False] * 6)
NO_NUMBERS = [np.full(7, 1j), ["0.1"] * 7, [True] * 7, MASKED]
ODD = [10**400, [10**400] * 7, [1j] * 7, Raising(), [Raising()] * 7, object(), {}, "seven", *NO_NUMBERS]


@pytest.mark.parametrize("odd", ODD, ids=lambda odd: str(odd)[:20])
@pytest.mark.parametrize("name", ["q", "qd", "goal", "time", "velocity"])
def test_what_is_odd_brakes_the_arm_raises_nothing_and_is_replayed(
    precise: Path, tmp_path: Path, name: str, odd: Any
) -> None:
    controller = Controller(precise)
    play(controller, 10)
    play(controller, 15, 10, **{name: odd})
    assert controller.problem
    assert controller.braking
    assert np.abs(controller.motion.speed).max() < 1e-9
    controller.save_log(tmp_path / "log.jsonl")
    assert Controller(precise).replay(tmp_path / "log.jsonl") == 0.0


def test_a_log_that_has_grown_too_long_is_replayed_from_a_later_reset_or_refused(precise: Path, tmp_path: Path) -> None:
    controller, file = Controller(precise), tmp_path / "log.jsonl"
    play(controller, 20)
    controller.save_log(file)
    kept = file.read_text().splitlines()[2:]
    file.write_text("\n".join(kept))
    with pytest.raises(ValueError, match=r"log\.jsonl' has no reset, from which on steps could be taken again"):
        Controller(precise).replay(file)
    controller = Controller(precise)
    controller.reset(controller.home)
    play(controller, 20)
    controller.save_log(file)
    file.write_text("\n".join([*kept, *file.read_text().splitlines()[1:]]))
    assert Controller(precise).replay(file) == 0.0


def test_reset_refuses_what_is_odd(precise: Path) -> None:
    controller = Controller(precise)
    for odd in (*ODD, None, np.zeros(6), np.full(7, np.nan)):
        with pytest.raises(ValueError, match="reset takes 7 measured joints, got"):
            controller.reset(odd)


def test_a_replay_is_the_same_where_the_caller_changes_its_own_lists(clutter: Path, tmp_path: Path) -> None:
    controller = Controller(clutter)
    goal, obstacle = controller.goal_box.mean(axis=0).tolist(), {"position": [0.5, 0.0, 0.3], "radius": 0.05}
    joints, q = [0.0] * 6, controller.home.tolist()
    for number in range(60):
        goal[0] += 0.001
        obstacle["position"][1] += 0.002  # type: ignore[index]
        joints[0] = 0.01 * number
        command = controller.step(
            Sensor(q) if number % 2 else q, [0.0] * 6, goal, 0.02 * number, obstacles=[obstacle], joints=joints
        )
        q[:] = command
    controller.save_log(tmp_path / "log.jsonl")
    assert Controller(clutter).replay(tmp_path / "log.jsonl") == 0.0


# --- what it says ---------------------------------------------------------------------------------


def test_without_a_goal_it_says_so_and_holds_the_arm(precise: Path) -> None:
    controller = Controller(precise)
    assert play(controller, 5, goal=None) == [NO_GOAL] * 5
    assert not controller.braking
    assert play(controller, 5, 5) == [""] * 5


def test_a_step_before_reset_away_from_home_stays_there_and_names_joint_and_remedy(
    precise: Path, tmp_path: Path
) -> None:
    controller = Controller(precise)
    there = controller.home + 0.3 * (np.arange(7) == 1)
    for number in range(10):
        assert controller.step(there, 0 * there, GOAL, 0.02 * number) == pytest.approx(there)
        assert re.search(
            rf"joint '{SECOND}' is measured at 0\.\d+, and without a reset .*call reset", controller.problem
        )
    controller.reset(there)
    assert play(controller, 10) == [""] * 10
    controller.save_log(tmp_path / "log.jsonl")
    assert controller.replay(tmp_path / "log.jsonl") == 0.0


def test_an_arm_that_is_not_where_it_was_reset_is_named_with_the_remedy(precise: Path) -> None:
    controller = Controller(precise)
    controller.reset(controller.home)
    play(controller, 5, q=controller.home + 0.3 * (np.arange(7) == 1))
    assert f"joint '{SECOND}' is measured at" in controller.problem
    assert "call reset" in controller.problem
    assert controller.braking


@pytest.mark.parametrize(("rate", "brakes"), [(25, False), (50, False), (60, False), (100, True)])
def test_calls_at_another_rate_are_named_and_too_many_brake_the_arm(precise: Path, rate: int, brakes: bool) -> None:
    controller = Controller(precise)
    problems = [play(controller, 1, time=number / rate)[0] for number in range(30)]
    said = f"step is called at {rate} Hz, and the policy's rate is 50 Hz: call it every 0.02 s"
    assert problems[-1] == ("" if rate in (50, 60) else said)
    assert controller.braking == brakes


@pytest.mark.parametrize("first", [None, [np.nan] * 7, [1e6] + [0.0] * 6, "x", [0.0] * 3])
def test_without_a_reset_nothing_moves_until_an_arm_was_measured(precise: Path, first: Any) -> None:
    controller = Controller(precise)
    for number in range(10):
        command = controller.step(first, [0.0] * 7, GOAL, number * controller.period)
        np.testing.assert_array_equal(command, controller.home)
    assert controller.braking
    assert controller.problem
    away = controller.home + 0.6
    np.testing.assert_allclose(controller.step(away, [0.0] * 7, GOAL, 10 * controller.period), away)
    assert "without a reset commands begin at home" in controller.problem


def test_after_a_long_time_without_a_call_it_goes_on_from_rest(precise: Path) -> None:
    controller = Controller(precise)
    controller.reset(controller.home)
    play(controller, 20)
    sent = controller.motion.position.copy()
    assert np.abs(controller.motion.speed).max() > 0.1, "else this test asks for nothing"
    commands = [sent] * 4
    for number in range(40):
        controller._watch.stop_watch = partial(float, 0.02 if number else 98.0)
        commands.append(controller.step(commands[-1], 0 * sent, GOAL, 100.0 + number * controller.period))
        if number == 0:
            assert controller.problem.startswith("called 99.")
    assert broken(commands, controller) == []
    assert (commands[-1] != sent).any(), "it moves again"


@pytest.mark.parametrize("jump", [-100.0, 1.5])
@pytest.mark.parametrize("stays", [False, True])
def test_a_clock_that_is_set_stops_an_arm_within_its_limits(
    precise: Path, tmp_path: Path, jump: float, stays: bool
) -> None:
    controller = Controller(precise)
    controller.reset(controller.home)
    measured, commands = controller.home, [controller.home] * 4
    for number in range(40):
        time = number * controller.period + jump * (number == 15 or (stays and number > 15))
        commands.append(controller.step(measured, (commands[-1] - measured) / controller.period, GOAL, time))
        measured = measured + 0.3 * (commands[-1] - measured)
        if number == 14:
            assert np.abs(controller.motion.speed).max() > 0.1, "else this test asks for nothing"
    assert broken(commands, controller) == []
    controller.save_log(tmp_path / "log.jsonl")
    assert controller.replay(tmp_path / "log.jsonl") == 0.0


def test_joints_that_are_not_those_of_the_goal_are_refused(clutter: Path) -> None:
    controller = Controller(clutter, planner=False)
    controller.reset(controller.home)
    place, _ = controller._tool(controller.home.tolist())
    around: dict[str, Any] = {"obstacles": [], "joints": controller.home}
    assert play(controller, 1, goal=place, **around) == [""]
    problem = play(controller, 1, first=1, goal=np.add(place, [0.0, 0.1, 0.0]), **around)[0]
    assert problem.startswith("the goal's joints have the tool at ")
    around["joints"] = controller.home + np.eye(len(controller.home))[-1] * 4 * np.pi
    assert "are out of the limits" in play(controller, 20, first=2, goal=place, **around)[-1]


def test_joints_that_have_the_tool_turned_otherwise_than_the_goal_are_refused(tmp_path: Path) -> None:
    controller = Controller(written(tmp_path / "pose", "pose"))
    controller.reset(controller.home)
    turned = controller.home - np.eye(len(controller.home))[-1]  # about its own axis: the tool stays where it is
    goal = np.concatenate(controller._tool(controller.home.tolist()))
    assert play(controller, 1, goal=goal, joints=controller.home) == [""]
    (problem,) = play(controller, 1, first=1, goal=goal, joints=turned)
    assert problem.startswith("the goal's joints have the tool turned to ")


def test_a_policy_of_obstacles_is_told_of_them(clutter: Path) -> None:
    controller = Controller(clutter, planner=False)
    controller.reset(controller.home)
    place, _ = controller._tool(controller.home.tolist())
    said = "it is not known what is beside the arm: give obstacles, [] where there are none"
    assert play(controller, 1, goal=place, joints=controller.home) == [said]
    assert play(controller, 20, first=1, goal=place, joints=controller.home, obstacles=[])[-1] == ""


@pytest.mark.parametrize("every", [1, 2, 3, 5])
def test_a_goal_that_moves_has_its_velocity_however_rarely_it_comes(every: int) -> None:
    facts = {"orientation": False, "moves": True, "joints": False, "fastest": 1.0}
    aim, seen = Aim({**facts, "low": [-1.0] * 3, "high": [1.0] * 3}, (-np.ones(7), np.ones(7)), {}), []
    for step in range(40):
        moved = min(step // every * every, 20)
        assert aim.take(np.array([0.004 * moved, 0.0, 0.0]), 0.02 * step, None, None, np.zeros(7)) == ""
        seen.append(cast("dict[str, Any]", aim.goal)["velocity"])
    np.testing.assert_allclose(seen[every:21], [[0.2, 0.0, 0.0]] * (21 - every), atol=1e-9)
    assert seen[-1] == [0.0, 0.0, 0.0], "it stands"


def test_numbers_are_printed_to_four_digits(precise: Path) -> None:
    problem = play(Controller(precise), 1, goal=[0.1 + 0.2, 3.0, 0.4])[0]
    assert problem.startswith("the goal [0.3, 3, 0.4] is out of the workspace, [")
    assert not re.search(r"\d\.\d{5}", problem)


def arrive(controller: Any, goal: Any, steps: int, begun: int = 0, **more: Any) -> list[tuple[bool, bool, str]]:
    """Of each step: whether the goal is reached, whether it could be and the arm rests, and what was said.

    The arm follows by 0.1 s, as in training.
    """
    q, qd, seen = controller.motion.position, np.zeros(7), list[tuple[bool, bool, str]]()
    for number in range(begun, begun + steps):
        command = controller.step(q, qd, goal, number * controller.period, **more)
        away = np.linalg.norm(np.subtract(controller._tool(q.tolist())[0], goal[:3]))
        assert controller.arrival.distance == pytest.approx(away)
        seen.append((controller.arrival.reached, bool(away < 0.01 and np.abs(qd).max() < 0.05), controller.problem))
        moved = (command - q) * (1 - np.exp(-controller.period / 0.1))
        q, qd = q + moved, moved / controller.period
    return seen


def test_a_goal_is_reached_once_the_tool_was_held_there_and_not_before(precise: Path) -> None:
    controller = Controller(precise)
    controller.reset(controller.home)
    reached, held, said = zip(*arrive(controller, GOAL, 200), strict=True)
    assert set(said) == {""}
    assert list(reached) == [all(held[max(step - 9, 0) : step + 1]) for step in range(200)], "of ten steps, as asked"
    assert reached[-1]
    play(controller, 1, first=200, goal=None)
    assert (controller.arrival.distance, controller.arrival.reached) == (np.inf, False)
    play(controller, 1, first=201, goal=np.add(GOAL, [0.0, 0.02, 0.0]))
    assert not controller.arrival.reached


def test_a_goal_that_is_not_come_nearer_to_is_told_until_there_is_another(precise: Path) -> None:
    controller = Controller(precise)
    controller.reset(controller.home)
    beyond = controller.goal_box[1] + 0.09
    reached, _, said = zip(*arrive(controller, beyond, 300), strict=True)
    assert not any(reached)
    assert not any(said[:150])
    assert re.search(r"the tool comes no nearer to the goal, [\d.]+ mm away: is it out of reach", said[-1])
    assert not controller.braking
    assert not any(said for _, _, said in arrive(controller, GOAL, 150, begun=300))


def test_nothing_is_reached_that_is_not_measured_or_while_the_arm_brakes(precise: Path) -> None:
    controller = Controller(precise)
    home = controller._tool(controller.home.tolist())[0]
    for unmeasured in (None, np.full(7, np.nan)):
        controller.reset(controller.home)
        for number in range(20):
            controller.step(unmeasured, unmeasured, home, number * controller.period)
            assert not controller.arrival.reached
    controller.reset(controller.home)
    arrive(controller, GOAL, 150)
    assert controller.arrival.reached
    controller.step(controller.motion.position, np.zeros(7), GOAL, cast("Any", None))
    assert not controller.arrival.reached
    controller.reset(controller.home)
    arrive(controller, GOAL, 150, begun=200)
    controller.stop()
    play(controller, 1, first=350)
    assert (controller.arrival.reached, controller.arrival.distance) == (False, np.inf)


def test_lowered_limits_give_an_arm_more_time_to_come_nearer(folder: Path) -> None:
    speeds = {
        joint: lower["speed"] for joint, lower in json.loads((folder / "policy.json").read_text())["limits"].items()
    }
    for joint, speed in speeds.items():
        change(folder, limit("speed", speed / 4, joint))
    controller = Controller(folder)
    controller.reset(controller.home)
    said = [said for _, _, said in arrive(controller, controller.goal_box[1] + 0.09, 1300)]
    assert not any(said[:600])
    assert "comes no nearer" in said[-1]


def test_where_an_object_is_moved_it_is_what_comes_to_the_goal(tmp_path: Path) -> None:
    controller = Controller(written(tmp_path / "policy", "push", robot="panda"))
    goal = np.mean(controller.goal_box, axis=0)
    near = [{"position": np.add(goal, [0.015, 0.0, 0.0]), "quaternion": [1.0, 0.0, 0.0, 0.0]}]
    play(controller, 12, goal=goal, objects=near)
    assert controller.arrival.distance == pytest.approx(0.015)
    play(controller, 1, first=12, goal=goal, objects="there")
    assert controller.arrival.distance == np.inf


def test_the_node_says_that_no_goal_has_come(precise: Path) -> None:
    pytest.importorskip("rclpy")
    from geometry_msgs.msg import PoseStamped
    from sensor_msgs.msg import JointState

    said: list[str] = []
    made = SimpleNamespace(publish=lambda _: None)
    node = SimpleNamespace(
        **dict.fromkeys(("create_publisher", "create_subscription", "create_timer"), lambda *_: made),
        get_logger=lambda: SimpleNamespace(warning=said.append),
    )
    controller = Controller(precise)
    policy = PolicyNode(node, controller, Topics(), trajectory=False)
    home = controller.home.tolist()
    policy._on_joints(JointState(name=controller.joints, position=home, velocity=[0.0] * 7))
    assert said == ["no goal has come on 'reachlab/goal', and the arm is held where it is"]
    message = PoseStamped()
    place = message.pose.position
    place.x, place.y, place.z = GOAL
    policy._on_goal(message)
    policy._step()
    assert said[1:] == ["all is well again"]


def test_what_moves_is_not_believed_for_long(clutter: Path) -> None:
    facts = json.loads((clutter / "policy.json").read_text())
    one = {"position": [0.5, 0.0, 0.3], "radius": 0.05, "time": 10.0}
    still, moving = Beside(facts), Beside(facts | {"obstacle_velocity": True})
    for beside in (still, moving):
        assert beside.numbers(read_bodies([one]), [], 10.0 + 0.9 * GONE)["bodies_position"][:3] == one["position"]
    assert still.numbers(read_bodies([one]), [], 3600.0), "what does not move may have been seen long ago"
    for when, said in (
        (10.0 + 1.1 * GONE, r"more than 0\.5 s ago, and they move"),
        (10.0 - 1.1 * OLD, "later than now"),
    ):
        with pytest.raises(ValueError, match=f"obstacle 1 was measured {said}"):
            moving.numbers(read_bodies([one]), [], when)
    for when, said in ((10.0 - 1.1 * OLD, "more than 0.1 s ago"), (10.0 + 1.1 * OLD, "later than now")):
        with pytest.raises(ValueError, match=f"object 1 was measured {said}"):
            placed([], 1, read_bodies([{"position": [0.5, 0.0, 0.3], "time": when}]), [2], [0.03], seconds=10.0)


# --- goals that are measured ----------------------------------------------------------------------

NOISE = np.random.default_rng(0).normal(0.0, 1e-4, (200, 3))


@pytest.fixture(scope="module")
def pose(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("pose") / "policy", "pose")


@pytest.mark.parametrize("kind", ["noise", "turned about", "drift"])
def test_a_goal_that_is_another_in_every_step_is_aimed_at(pose: Path, kind: str) -> None:
    controller = Controller(pose)
    controller.reset(controller.home)
    place = np.concatenate([GOAL, controller.home_quaternion])
    for step in range(60):
        goal = place.copy()
        goal[:3] += {"noise": NOISE[step], "drift": [0.0, 5e-4 * step, 0.0]}.get(kind, np.zeros(3))
        goal[3:] *= (-1) ** (step * (kind == "turned about"))
        assert play(controller, 1, first=step, goal=goal) == [""]
        if step > 20:
            aimed = cast("dict[str, Any]", controller._aim.goal)["position"]
            assert np.linalg.norm(aimed - goal[:3]) < (0.01 if kind == "drift" else 1e-3)
    assert controller.goal_joints is not None


def test_a_goal_far_from_the_one_before_is_aimed_at_alone(pose: Path) -> None:
    controller = at_once(Controller(pose))
    controller.reset(controller.home)
    ends = [np.concatenate([[0.5, side, 0.4], controller.home_quaternion]) for side in (-0.2, 0.2)]
    assert set(play(controller, 30, goal=ends[0])) == {""}
    assert play(controller, 1, first=30, goal=ends[1]) == [""]
    assert controller._aim.goal is None, "nothing moves until its joints are found"
    problems = [play(controller, 1, first=31 + step, goal=ends[step % 2])[0] for step in range(30)]
    assert problems[-1] == "the goal moves by more than 0.05 m before its joints are found, again and again"
    assert np.abs(controller.motion.speed).max() < 1e-9
    assert play(controller, 60, first=61, goal=ends[0])[-1] == ""
    assert controller.goal_joints is not None


def test_goals_beside_each_other_are_one_to_a_planner() -> None:
    facts = {"planner": {"arm": {"period": 0.02, "lag": [0.05], "speed": [2.0]}}, "goal": {"success_distance": 0.01}}
    way, asked = Way(facts, Told(), lambda _: ([0.0] * 3, [1.0, 0.0, 0.0, 0.0])), list[int]()
    bodies = {f"bodies_{name}": [] for name in ("kind", "position", "quaternion", "size")}
    for step, joint in enumerate((0.5, 0.5001, 0.4995, 0.9)):
        goal = {"joints": [joint], "position": [0.5, 0.0, 0.4]}
        way.command(goal, {"q": [0.0], "command": [0.0], **bodies}, 0.02 * step)
        asked.append(way._asked)
    assert asked[0] == asked[1] == asked[2] < asked[3]


# --- joints that follow otherwise than in training -----------------------------------------------


def at_once(controller: Any) -> Any:
    """A controller whose arm followed at once in training too."""
    controller._watch._lag *= 0
    return controller


ALIKE, ANY = (1.0, 1.0), (0.2, 1.5)
LATE = (
    (0.0, ALIKE, r"joints are measured 0.00 s behind their commands, and 0.10 s in training: the arm may swing about"),
    (0.05, ALIKE, r"joints are measured 0.0[345] s behind their commands, and 0.10 s in training"),
    (0.1, ALIKE, ""),
    (0.3, ALIKE, r"joints are measured 0.[23]\d s"),
    (0.0, ANY, ""),
    (0.15, ANY, ""),
    (0.4, ANY, r"joints are measured 0.[34]\d s behind their commands, and 0.02 to 0.15 s in training"),
)
"""Times by which joints follow [s], between which shares of the servos' lag they were in training, and what is said."""


@pytest.mark.parametrize(("lag", "trained", "said"), LATE)
def test_joints_that_follow_otherwise_than_in_training_are_told(
    precise: Path, lag: float, trained: tuple[float, float], said: str
) -> None:
    controller, sag = Controller(precise), 0.01
    controller._watch._lag_range = trained
    q, qd, told = controller.home, 0 * controller.home, list[str]()
    controller.reset(q)
    low, high = np.array(controller.goal_box)
    for step in range(400):  # to corners of the box, one after the other
        command = controller.step(q, qd, (low, high)[step // 100 % 2], step * controller.period)
        told.append(controller.problem)
        begin = q
        for _ in range(20 if lag else 0):  # servos, critically damped, that gravity displaces
            qd = qd + controller.period / 20 * ((command - sag - q) * (2 / lag) ** 2 - qd * 4 / lag)
            q = q + controller.period / 20 * qd
        if not lag:
            q, qd = command, (command - begin) / controller.period
    assert not controller.braking
    assert set(told[: FOLLOWED - 1]) == {""}
    assert re.match(said, told[-1])
    assert bool(said) == bool(told[-1])


def test_a_turn_that_a_driver_leaves_out_and_a_measurement_that_stays_are_named(precise: Path) -> None:
    controller = at_once(Controller(precise))
    controller._watch._lower, controller._watch._upper = controller._watch._lower - 9, controller._watch._upper + 9
    turn = np.eye(len(controller.home))[0] * 2 * np.pi
    controller.reset(controller.home)
    play(controller, 3)
    wrapped = ", by a full turn: give angles that go on where the driver begins anew"
    told = play(controller, 200, 3, q=controller.home + turn)
    assert told[0].endswith(f"is measured to have jumped{wrapped}")
    assert told[-1].endswith(f"is not where it was sent{wrapped}")
    assert controller.braking
    controller.reset(controller.home)
    stays = {"q": controller.home, "qd": 0.3 * np.ones(len(controller.home))}
    told = [one for one in play(controller, 60, **stays) if "not changed" in one]
    assert len(told) > 20
    assert len(set(told)) == 1, "one sentence, which logs tell once"


# --- what is given in other units, or is not believed ---------------------------------------------


def test_a_velocity_faster_than_goals_are_is_refused() -> None:
    facts = {"orientation": False, "moves": True, "joints": False, "fastest": 1.0}
    aim = Aim({**facts, "low": [-1.0] * 3, "high": [1.0] * 3}, (-np.ones(7), np.ones(7)), {})
    assert aim.take(np.zeros(3), 0.0, np.array([0.9, 0.0, 0.0]), None, np.zeros(7)) == ""
    problem = aim.take(np.zeros(3), 0.02, np.array([200.0, 0.0, 0.0]), None, np.zeros(7))
    assert problem == ("the goal's velocity is [200, 0, 0] m/s, and the policy knows 1 m/s at most: is it in mm/s?")


def test_joints_in_degrees_are_asked_about(precise: Path) -> None:
    controller, degrees = Controller(precise), np.rad2deg(Controller(precise).home) + 10
    with pytest.raises(ValueError, match=r"reset there, or are they not in rad and m\?"):
        controller.reset(degrees)
    controller.reset(controller.home)
    assert play(controller, 3, q=degrees)[-1].endswith("measured to rest, or are they not in rad and m?")
    assert controller.braking
    with pytest.raises(ValueError, match="got something not made of numbers"):
        controller.reset("home")


def test_what_is_not_measured_is_named(precise: Path) -> None:
    controller = Controller(precise)
    assert "no speeds of the joints have come" in play(controller, 1, qd=None)[0]
    assert play(controller, 1, first=1, time=np.array(0.02)) == [""]
    assert play(controller, 1, time=0.019) == ["the clock runs back or stands still, 0.001 s before the last step"]


@pytest.mark.parametrize(("share", "said"), [(1.0, ""), (0.8, ""), (0.0, ""), (-1.0, "does not fit where it is")])
def test_speeds_that_do_not_fit_the_joints_are_told(precise: Path, share: float, said: str) -> None:
    controller, told = at_once(Controller(precise)), list[str]()
    controller.reset(controller.home)
    q, qd = controller.home, 0 * controller.home
    for step in range(80):
        command = controller.step(q, share * qd, GOAL, step * controller.period)
        told.append(controller.problem)
        q, qd = command, (command - q) / controller.period
    assert any(said in one for one in told)
    assert bool(said) == any(told)


def test_obstacles_that_a_policy_does_not_know_are_told(precise: Path, clutter: Path) -> None:
    given: dict[str, Any] = {"obstacles": [BALL]}
    assert play(Controller(precise), 2, **given)[-1] == "the policy knows of no obstacles: it meets them"
    assert play(Controller(precise), 2, obstacles=[])[-1] == ""
    controller = Controller(clutter, planner=False)
    middle = controller.goal_box.mean(axis=0)
    for obstacle, problem in (
        ({"position": [0.5, 0.0, 0.3]}, "has no size: give its radius, or its half lengths"),
        ({"position": [500.0, 0.0, 300.0], "radius": 50.0}, "a position within 100 m, got [500, 0, 300]: is it in mm?"),
    ):
        assert play(controller, 60, goal=middle, obstacles=[obstacle])[-1].endswith(problem)


def test_a_log_is_taken_again_by_its_own_policy_alone(precise: Path, pose: Path, tmp_path: Path) -> None:
    controller, file = Controller(precise), tmp_path / "log.jsonl"
    play(controller, 5)
    controller.save_log(file)
    with pytest.raises(ValueError, match="is the log of another policy"):
        Controller(pose).replay(file)
    file.write_text(file.read_text()[:-20])
    with pytest.raises(ValueError, match=r"log\.jsonl', line 7, is no entry of a log: was the file cut\?"):
        Controller(precise).replay(file)
