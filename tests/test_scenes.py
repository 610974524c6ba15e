"""Scenes of furniture: drawn once, with a way through each that is not straight, by the engine's own contacts."""

from __future__ import annotations

import json
import logging
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mounted import mounted
from reachlab.control.bodies import Bodies
from reachlab.control.contact_model import arm_of
from reachlab.control.planning.collision import CollisionChecker
from reachlab.envs.core import Env
from reachlab.envs.presets import configure
from reachlab.envs.random_streams import env_keys
from reachlab.envs.setup import configure_env, make_setup
from reachlab.evaluation.report import evaluate
from reachlab.robots.kinematics.forward import forward_kinematics
from reachlab.robots.loading import load_robot
from reachlab.settings.validation import InputError
from reachlab.tasks.scenes import bank, kinds
from reachlab.tasks.scenes.kinds import KINDS
from reachlab.tasks.scenes.sampling import goal_box

pytestmark = pytest.mark.usefixtures("few_scenes")

EPISODES = 6

ON_A_BLOCK = {"shape": "box", "position": [0.45, 0.0, 0.15], "size": [0.3, 0.02, 0.15]}


def scenes(robot: str, *names: str) -> tuple[Env, bank.Bank]:
    env = Env(configure("clutter", robot=robot, scene=names, randomise=()), EPISODES)
    return env, env.setup.prepared


def checkers(env: Env, drawn: bank.Bank, kind: int = 0) -> Any:
    """Start, goal and a checker of each scene."""
    checker = CollisionChecker(arm_of(env.setup.robot), drawn.bodies.kind.shape[-1])
    for row in range(len(drawn.start)):
        bodies: Bodies = jax.tree.map(lambda x, row=row: x[row, kind], drawn.bodies)
        checker.place(bodies)
        yield drawn.start[row, kind], drawn.joints[row, kind], checker


@pytest.mark.parametrize("name", KINDS)
def test_start_and_goal_are_free_and_no_straight_way_is(name: str) -> None:
    env, drawn = scenes("panda", name)
    assert drawn.start.shape == (16, 1, 7)
    for start, goal, checker in checkers(env, drawn):
        checker.keep(bank.CLEAR * env.setup.robot.scale - 1e-4, 0.0)
        assert checker.free(start)
        assert checker.free(goal)
        assert not checker.straight(start, goal)
    low, high = env.setup.task.goal_box(env.setup)
    points = np.asarray(forward_kinematics(env.setup.robot.chain, jnp.array(drawn.joints[:, 0])).position)
    assert ((points >= low) & (points <= high)).all()
    env.close()


@pytest.mark.parametrize(("place", "yaw"), [("0.1 0.5 0.8", 0.0), ("0 0 0.3", np.pi / 2)])
def test_scenes_are_where_the_arm_stands_and_what_it_faces(place: str, yaw: float, tmp_path: Path) -> None:
    kind, there = (kinds.kind_of("wall", load_robot(mounted(tmp_path, *at))) for at in (("0 0 0", 0.0), (place, yaw)))
    base, turn = np.array([float(x) for x in place.split()]), Rotation.from_rotvec([0.0, 0.0, yaw])
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (8, 3))
    np.testing.assert_allclose(there.place(points), base + turn.apply(kind.place(points)), atol=0.02)
    robot = load_robot(mounted(tmp_path, place, yaw))
    starts, goals, bodies = zip(*bank.drawn_scenes(robot, "wall", 4), strict=True)
    walls = np.array([one.position[0] for one in bodies]) - base
    assert (turn.inv().apply(walls)[:, 0] > 0.3).all(), "they are before it"
    assert np.linalg.norm(np.array(starts) - np.array(goals), axis=1).min() > 0.1


def test_scenes_are_where_an_arm_stands_within_its_file(tmp_path: Path) -> None:
    text = Path(mounted(tmp_path)).read_text()
    begin, end = text.index("<body "), text.rindex("</body>") + len("</body>")
    pedestal = f'<body name="pedestal"><body name="mount" pos="0.2 -0.5 0.6">{text[begin:end]}</body></body>'
    (tmp_path / "pedestal.xml").write_text(text[:begin] + pedestal + text[end:])
    base = kinds.kind_of("wall", load_robot(str(tmp_path / "pedestal.xml"))).base
    np.testing.assert_allclose(base[:2], (0.2, -0.5), atol=0.02)
    np.testing.assert_allclose(base[2], 0.6, atol=0.05)


def test_bodies_are_as_large_as_the_arm_is() -> None:
    walls = [scenes(robot, "wall")[1].bodies.size[..., 0].max() for robot in ("iiwa14", "so101")]
    np.testing.assert_allclose(walls[1] / walls[0], load_robot("so101").scale / load_robot("iiwa14").scale, rtol=1e-5)


def test_they_are_drawn_once_and_a_damaged_file_is_drawn_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = make_setup(configure("clutter", robot="panda")).robot
    first = bank.bank_of(robot, "posts")
    (file,) = [file for file in bank.cache_folder().rglob("*") if file.stem in bank._banks and kept(file, first)]
    for damage in (b"", file.read_bytes()[:-9]):
        file.write_bytes(damage)
        bank._banks.clear()
        again = bank.bank_of(robot, "posts")
        jax.tree.map(np.testing.assert_array_equal, again, first)
    bank._banks.clear()
    monkeypatch.delattr(bank, "_drawn")  # that of the file is read
    jax.tree.map(np.testing.assert_array_equal, bank.bank_of(robot, "posts"), first)


def kept(file: Path, drawn: bank.Bank) -> bool:
    return drawn.joints.tobytes() in file.read_bytes()


def test_those_to_evaluate_in_are_others_than_those_to_train_in() -> None:
    env, drawn = scenes("panda", "wall", "posts")
    trained, held_out = ({row.tobytes() for row in part.reshape(-1, 7)} for part in np.split(drawn.start, 2))
    assert not trained & held_out
    for init, allowed in ((env.init, trained), (env.init_held_out, held_out)):
        begun = init(env_keys(0, EPISODES))
        assert {row.tobytes() for row in np.asarray(begun.arm.q)} <= allowed
        count = np.asarray(begun.arm.bodies.present).sum(axis=1)
        assert {1} < set(count.tolist()), "walls and posts"
    env.close()


def test_a_report_says_how_many_ask_for_no_avoiding() -> None:
    env, _ = scenes("panda", "bin")
    assert evaluate(env, "zero", episodes=EPISODES).straight == 0.0
    env.close()
    balls = Env(configure("clutter", obstacles=(0, 1), randomise=(), max_steps=12), EPISODES)
    assert evaluate(balls, "zero", episodes=EPISODES).straight == 1.0
    balls.close()


def test_an_episode_lasts_longer_where_ways_are_long() -> None:
    assert configure("clutter", scene=("shelf",)).rules.max_steps == 250
    assert configure("clutter", scene=("shelf",), max_steps=90).rules.max_steps == 90
    assert configure("clutter").rules.max_steps == 150


def test_bodies_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.json"
    file.write_text(
        json.dumps({"bodies": [ON_A_BLOCK, {"shape": "ball", "position": [0.5, 0.3, 0.6], "size": [0.05]}]})
    )
    env, drawn = scenes("panda", str(file))
    np.testing.assert_allclose(drawn.bodies.size[:, 0, 0], np.tile([0.3, 0.02, 0.15], (16, 1)), rtol=1e-6)
    before = env.identity
    env.close()
    ON_A_BLOCK["size"][2] = 0.14  # it is another scene then
    file.write_text(json.dumps({"bodies": [ON_A_BLOCK]}))
    env, _ = scenes("panda", str(file))
    assert env.identity != before
    env.close()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, "does not exist: put it there"),
        ("[]", "cannot be read"),
        ('{"bodies": []}', "has 0 bodies: 1 to 16 are allowed"),
        (
            '{"bodies": [{"shape": "cone", "position": [0, 0, 0], "size": [1]}]}',
            "shape 'cone' is not one of: ball",
        ),
        ('{"bodies": [{"shape": "ball", "position": [0, 0], "size": [1]}]}', "a ball needs a position of 3 numbers"),
        ('{"bodies": [{"shape": "ball", "position": [0, 0, 0], "size": 0.1}]}', "and one of 1 as its size"),
        ('{"bodies": [{"shape": "ball", "position": [0, 0, 0], "size": [-1]}]}', "a size is not positive"),
        ('{"bodies": [{"shape": "ball", "position": [0, 0, NaN], "size": [1]}]}', "a ball needs"),
        ('{"bodies": [{"shape": "ball", "position": [0, 0, 1], "size": [true]}]}', "is not of numbers"),
        ('{"bodies": [{"shape": "ball", "position": [0, 0, 1], "size": [1], "yaw": "1"}]}', "is not of numbers"),
        ('{"bodies": [{"position": [0, 0, 1], "size": [1]}]}', "a body has no 'shape'"),
        ("[" * 200_000, "cannot be read"),
        (f'{{"bodies": [{{"shape": "ball", "position": [0, 0, 1{400 * "0"}], "size": [1]}}]}}', "cannot be read"),
        ('{"bodies": [{"shape": "ball", "position": [0, 0, 1e9], "size": [1]}]}', "larger than 100 m, or farther"),
        (
            '{"bodies": [{"shape": "ball", "position": [0, 0, 1], "size": [1], "Yaw": 1}]}',
            "nothing of a body is called Yaw",
        ),
        (
            '{"bodies": [{"shape": "ball", "position": [0, 0, 1], "size": [1]}], "bodys": []}',
            "nothing is called bodys",
        ),
    ],
)
def test_a_file_that_says_something_else_is_refused(tmp_path: Path, content: str | None, sentence: str) -> None:
    file = tmp_path / "mine.json"
    if content is not None:
        file.write_text(content)
    with pytest.raises(InputError, match=sentence):
        Env(configure("clutter", scene=(str(file),)), 1)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"scene": ("shelv",)}, r"scene 'shelv' is not one of: .* Did you mean 'shelf'\?"),
        ({"scene": ("balls", "shelf")}, "name balls or moving alone, or others"),
        ({"scene": ()}, "name balls or moving alone, or others"),
        ({"scene": ("shelf",), "obstacles": (1, 2)}, "obstacles are those of scene balls, not of shelf"),
    ],
)
def test_what_cannot_be_is_refused(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        configure_env("clutter", **settings)


def test_a_kind_that_does_not_fit_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bank, "MOST_DRAWN", 4)
    monkeypatch.setattr(CollisionChecker, "free", lambda *_: False)
    bank._banks.clear()
    with pytest.raises(InputError, match=r"scene 'table' does not fit robot 'gen3': only 0 of 128"):
        scenes("gen3", "table")


def test_without_ompl_there_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl", None)
    with pytest.raises(InputError, match=r"^scene 'wall' needs OMPL: pip install .*\[planner\]'\.$"):
        scenes("gen3", "wall")


def test_where_there_is_no_terminal_one_sentence_says_what_is_waited_for_the_first_time(
    caplog: pytest.LogCaptureFixture, capfd: Any
) -> None:
    with caplog.at_level(logging.DEBUG, logger="reachlab"):
        for _ in range(2):
            scenes("xarm7", "bin")[0].close()
    said = [record.getMessage() for record in caplog.records]
    assert said == ["reachlab: drawing 16 scenes 'bin' for xarm7, kept for later, in one to five minutes."]
    assert capfd.readouterr().out == ""


def test_goals_of_an_arm_whose_front_is_not_x_have_a_box() -> None:
    panda = load_robot("panda")
    low, high = (np.array(corner)[[1, 0, 2]] for corner in panda.workspace)
    turned = replace(panda, workspace=(tuple(low.tolist()), tuple(high.tolist())))
    assert turned.front == pytest.approx(np.pi / 2)
    setup: Any = SimpleNamespace(rules=SimpleNamespace(scene=("wall",)), robot=turned)
    ahead: Any = SimpleNamespace(rules=SimpleNamespace(scene=("wall",)), robot=panda)
    (low, high), (plain_low, plain_high) = goal_box(setup), goal_box(ahead)
    assert (low < high).all()
    assert high - low == pytest.approx((plain_high - plain_low)[[1, 0, 2]], abs=1e-6)
