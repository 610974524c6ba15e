"""What is given from Python: taken as one would expect, or refused in one sentence."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import jax
import numpy as np
import pytest

import reachlab
from reachlab.agents.acting import _is_told
from reachlab.cli import main as cli
from reachlab.control import CONTROLLERS
from reachlab.control.bodies import absent
from reachlab.control.situation import Goal
from reachlab.envs.consistency import check
from reachlab.envs.gymnasium_single import ReachEnv
from reachlab.envs.random_streams import env_keys
from reachlab.learn.load import POLICY
from reachlab.runs.shipped import find_run
from reachlab.scale.training import failure_file, run_training
from reachlab.settings import extensions
from reachlab.settings.config import RunConfig
from reachlab.settings.tables import Lazy
from reachlab.settings.validation import InputError
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.rewards import REWARDS, reward_terms
from reachlab.tasks.schema import Observation, Term
from reachlab.tasks.task import Control
from reachlab.tasks.terms import TOOL


@pytest.mark.parametrize(
    ("config", "sentence"),
    [
        (lambda: reachlab.configure("precise", randomise=("dynamic",)), "randomise 'dynamic' is not one of"),
        (lambda: reachlab.configure("precise", observation="push"), "observation 'push' needs an object beside"),
        (lambda: reachlab.configure("tutorial", observation="pose"), "observation 'pose' needs a goal whose joints"),
        (lambda: reachlab.configure("push", sim="kinematic"), "task 'push' needs objects that move"),
        (lambda: reachlab.configure("precise", hold_steps=200), "cannot be held for hold_steps 200 in an episode of"),
        (
            lambda: RunConfig(task="precise"),
            "rules of 'precise' are a Precise, got TaskSettings: begin with `configure`",
        ),
        (lambda: reachlab.configure("slide", beyond=(0.4, 0.1)), "beyond has a least distance above the largest"),
    ],
)
def test_environments_that_cannot_be_are_refused(config: Any, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        reachlab.Env(config(), 2)


def test_an_environment_is_told_what_shapes_it_takes() -> None:
    env = reachlab.Env(reachlab.configure("tutorial"), 2)
    assert repr(env) == "<Env of 2 'tutorial' with 'iiwa14' in 'kinematic'>"
    key = jax.random.key(0)
    for given, kind in ((0, r"int of shape \(\)"), (key, r"PRNGKeyArray of shape \(\)"), (None, "NoneType")):
        with pytest.raises(InputError, match=rf"begin by a key each, as jax.random.split.*, got {kind}"):
            env.init(cast(Any, given))
    state = env.init(jax.random.split(jax.random.PRNGKey(0), 2))  # a key of the old kind
    for action in (np.zeros(3), np.zeros((2, 5)), np.zeros((3, 3))):
        with pytest.raises(InputError, match=r"actions of these environments have shape \(2, 3\), got "):
            env.step(state, action)


def test_what_is_named_by_its_initials_is_found() -> None:
    with pytest.raises(InputError, match=r"setting 'lr' does not exist\. Did you mean 'learning_rate'\?"):
        reachlab.configure("tutorial", lr=1e-3)


@pytest.mark.parametrize("beyond", [(float("nan"), 1.0), (0.1, float("inf")), (-5.0, -4.0)])
def test_distances_are_numbers_above_0(beyond: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="beyond"):
        check(reachlab.configure("slide", beyond=beyond))


def test_numbers_of_numpy_are_numbers() -> None:
    config = reachlab.configure("precise", seed=np.int64(3), success_distance=np.float32(0.5), hold_steps=np.array(4))
    assert (config.seed, config.rules.success_distance, vars(config.rules)["hold_steps"]) == (3, 0.5, 4)
    assert type(config.seed) is int
    with pytest.raises(InputError, match=r"seed must be a whole number.*, got 0\.5"):
        reachlab.configure("precise", seed=np.float64(0.5))


def test_a_file_of_a_scene_is_found_from_any_folder() -> None:
    config = reachlab.configure("clutter", scene=("mine.json", "wall"))
    assert vars(config.rules)["scene"] == (str(Path("mine.json").absolute()), "wall")


def test_joints_may_be_numbers_of_any_kind() -> None:
    chain = reachlab.load_robot("panda").chain
    expected = reachlab.forward_kinematics(chain, jax.numpy.array([0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0]))
    for q in ([0, 1, 0, -1, 0, 1, 0], np.array([0, 1, 0, -1, 0, 1, 0]), np.array([0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0])):
        pose = reachlab.forward_kinematics(chain, q)
        np.testing.assert_array_equal(pose.position, expected.position)
        np.testing.assert_array_equal(pose.quaternion, expected.quaternion)
    with pytest.raises(InputError, match=r"have 7 numbers in their last axis, and the shape is \(2,\)"):
        reachlab.forward_kinematics(chain, [0.0, 1.0])
    found = reachlab.inverse_kinematics(chain, expected, [0] * 7, jax.random.key(0))
    assert found.converged
    double = expected._replace(quaternion=2.0 * expected.quaternion)
    with pytest.raises(InputError, match="quaternions of poses are of length 1, and one of the target's has 2"):
        reachlab.inverse_kinematics(chain, double, [0] * 7, jax.random.key(0))


def test_a_function_is_told_where_episodes_begin_if_it_asks_for_it() -> None:
    told = (lambda seen, begins: (seen, begins), lambda seen, begins=None: (seen, begins))
    others = (lambda seen: seen, lambda seen, speed=0.6: speed * seen, lambda *seen: seen, max, np.tanh)
    assert all(map(_is_told, told))
    assert not any(map(_is_told, cast("Any", others)))


@pytest.mark.parametrize(
    ("terms", "sentence"),
    [
        ({"success": np.zeros(3)}, "has a term 'success', which is the verdict's name: call it another"),
        ({"near": np.zeros((3, 1))}, r"gives term 'near' as float\[3, 1\]: a name and one number an env"),
        ({"near": [0.0, 0.0, 0.0]}, r"gives term 'near' as \[float\[\], float\[\], float\[\]\]: a name and"),
        ({"near": np.zeros(3, complex)}, r"gives term 'near' as .*: a name and one number an env"),
        ({1: np.zeros(3)}, r"gives term 1 as float\[3\]: a name and one number an environment are needed, float\[3\]"),
        (np.zeros(3), "gives ndarray: it has to give terms by name"),
    ],
)
def test_a_reward_of_another_form_is_refused(terms: Any, sentence: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(REWARDS, "mine", lambda *_: terms)
    outcome: Any = SimpleNamespace(gap=np.zeros(3))
    with pytest.raises(InputError, match=f"reward 'mine' {sentence}"):
        reward_terms(SimpleNamespace(reward="mine"), outcome)


def _far(_: Any, outcome: Any) -> dict[str, Any]:
    return {"near": -outcome.dist}


def _asks(_: Any, outcome: Any) -> dict[str, Any]:
    return {"near": 1.0 if outcome.gap < 0.1 else 0.0}


def _alone(rules: Any) -> dict[str, Any]:
    return {"near": rules.max_steps}


@pytest.mark.parametrize(
    ("reward", "sentence"),
    [
        (_far, r"at test_python_input.py:\d+: .* has no attribute 'dist'. An outcome has errors, gap_before, "),
        (_asks, r"at test_python_input.py:\d+: .*: use jnp.where in place of if"),
        (_alone, ": .*takes 1 positional argument but 2 were given"),
    ],
)
def test_a_reward_that_fails_says_where(reward: Any, sentence: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(REWARDS, "mine", reward)
    env = reachlab.Env(reachlab.configure("tutorial", reward="mine"), 2)
    state = env.init(env_keys(0, 2))
    with pytest.raises(InputError, match=f"reward 'mine' fails ?{sentence}"):
        env.step(state, np.zeros((2, 3), np.float32))


def test_a_training_that_fails_at_its_start_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(REWARDS, "mine", _far)
    for _ in range(2):
        with pytest.raises(InputError, match="reward 'mine' fails at"):
            reachlab.train(reachlab.configure("tutorial", reward="mine"), tmp_path / "run")
        assert not [*tmp_path.iterdir()]


def test_lists_are_taken_and_what_is_loaded_is_short() -> None:
    config = reachlab.configure("precise", randomise=["dynamics"], hidden=[32, 32])
    assert (config.randomise, config.learner.hidden) == (("dynamics",), (32, 32))
    shown = repr(reachlab.load("panda/precise"))
    assert shown.startswith("LoadedRun(task='precise', robot='panda', sim='mujoco', <Policy of ")
    assert len(shown) < 120


def test_what_is_loaded_has_the_settings_of_its_training_and_the_name_of_its_weights() -> None:
    loaded = reachlab.load("panda/precise", sim="kinematic")
    assert (loaded.config.sim, loaded.config.randomise) == ("mujoco", ("dynamics",))
    assert (loaded.env.config.sim, loaded.env.config.randomise) == ("kinematic", ())
    assert loaded.checkpoint == find_run("panda/precise").read_identified(POLICY, loaded.policy)[0]


def test_a_sweep_of_nothing_and_by_nobody_is_refused_before_it_begins(tmp_path: Path) -> None:
    config, out = reachlab.configure("tutorial"), tmp_path / "sweep"
    space = reachlab.SweepConfig(space={"learning_rate": [1e-3, 1e-2]})
    for workers in (0, "2"):
        with pytest.raises(InputError, match="workers must be a whole number from 1 to 1024"):
            reachlab.sweep(config, space, out, workers=cast("Any", workers))
    with pytest.raises(InputError, match=r"space must name a setting that varies, as .*, got \{\}"):
        reachlab.sweep(config, reachlab.SweepConfig(space={}), out)
    with pytest.raises(InputError, match=r"sinks must be a list of names, as \['tensorboard'\]"):
        reachlab.train(config, out, sinks="tensorboard")
    assert not out.exists()


def test_what_is_no_environment_agent_or_setting_is_told_so(tmp_path: Path) -> None:
    env = reachlab.Env(reachlab.configure("tutorial"), 2)
    for given, sentence in (
        ((ReachEnv("tutorial"), "ik"), r"evaluate needs an Env, as reachlab.Env\(.*, got ReachEnv"),
        ((env, SimpleNamespace()), r"evaluate needs a name or a function \(.* as agent, got SimpleNamespace"),
        (
            (env, lambda _: [0.0, 0.0, 0.0]),
            r"action must have shape \(2, 3\), a row for each environment, got \(3,\)",
        ),
        ((env, "trained", reachlab.load("panda/precise")), "needs a Policy, .* got LoadedRun: give its `policy`"),
    ):
        with pytest.raises(InputError, match=sentence):
            reachlab.evaluate(*cast("Any", given))
    config: Any = reachlab.configure("tutorial")
    for call, sentence in (
        (lambda: reachlab.train(cast("Any", "x"), tmp_path / "run"), "train needs a RunConfig, .* as config, got 'x'"),
        (lambda: reachlab.train(config, cast("Any", None)), "train needs a path as out, got None"),
        (lambda: reachlab.train(config, tmp_path / "run", cast("Any", 3)), "train needs a function as watch, got 3"),
        (lambda: reachlab.configure("tutorial", config=config), "setting 'config' is not one of"),
        (lambda: reachlab.record(env, "ik", None, "x", config), r"needs a RecordConfig, as reachlab.RecordConfig\("),
        (lambda: reachlab.distil(config, tmp_path / "run"), "distil needs a DistilRunConfig, .* got RunConfig"),
        (
            lambda: reachlab.load("panda/precise").policy.act(cast("Any", ReachEnv("precise").reset(seed=0))),
            r"an observation is needed, got a tuple with infos: `observation, _ = env.reset\(\)`",
        ),
        (lambda: reachlab.load_robot(cast("Any", 3)), "load_robot needs a path as name, got 3"),
        (lambda: reachlab.view(cast("Any", env.setup)), "view needs an Env, .*, as env, got TaskSetup"),
    ):
        with pytest.raises(InputError, match=sentence):
            call()
    assert not [*tmp_path.iterdir()]


def test_a_path_is_a_robot_as_its_text_is(tmp_path: Path) -> None:
    assert reachlab.configure(robot=tmp_path / "arm.urdf").robot == str(tmp_path / "arm.urdf")


PAID = {"each": 1.0}


def test_a_number_that_a_reward_uses_counts_as_it_is_when_an_environment_is_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(REWARDS, "mine", lambda _, outcome: {"paid": 0 * outcome.gap + PAID["each"]})
    for paid in (1.0, 2.0):
        monkeypatch.setitem(PAID, "each", paid)
        env = ReachEnv("tutorial", reward="mine")
        env.reset(seed=0)
        assert env.step(np.zeros(3, np.float32))[1] == paid


def test_a_reward_that_was_changed_counts_from_the_next_environment_on(monkeypatch: pytest.MonkeyPatch) -> None:
    for paid in (1.0, 2.0):
        monkeypatch.setitem(REWARDS, "mine", lambda _, outcome, paid=paid: {"paid": 0 * outcome.gap + paid})
        env = ReachEnv("tutorial", reward="mine")
        env.reset(seed=0)
        assert env.step(np.zeros(3))[1] == paid


def _mine(value: Any, low: Any = -1.0, high: Any = 1.0) -> Observation:
    bounds: Any = lambda _: (np.atleast_1d(low), np.atleast_1d(high)) if high is not None else None  # noqa: E731
    return Observation("mine", (Term("q", "1", value, bounds),))


@pytest.mark.parametrize(
    ("design", "sentence"),
    [
        (_mine(lambda _, now: now.tool_position), r"gives numbers in shape \(1, 3\): by its bounds they are \(1, 1\)"),
        (_mine(lambda *_: 1.0), r"gives numbers in shape \(\): by its bounds"),
        (_mine(lambda _, now: now.tool), r"fails at test_python_input.py:\d+: .* A situation has q, qd, "),
        (_mine(lambda _: 1.0), "fails: .*takes 1 positional argument but 2 were given"),
        (_mine(None, low=1.0, high=-1.0), "the bounds of term 'q' must be as many numbers"),
        (_mine(None, low=[0.0, np.nan], high=[1.0, 1.0]), "the bounds of term 'q' must be as many numbers"),
        (_mine(None, high=None), "the bounds of term 'q' must be two arrays of numbers"),
        (Observation("nothing", ()), "the observation 'nothing' has no terms"),
        (Observation("both", (TOOL, TOOL)), "the terms of the observation 'both' are tool, tool: name each once"),
        (Observation("odd", (), needs=frozenset({"love"})), "observation 'mine' needs 'love', which nothing gives"),
    ],
)
def test_an_observation_that_cannot_be_is_refused(
    design: Observation, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(OBSERVATIONS, "mine", design)
    with pytest.raises(InputError, match=sentence):
        ReachEnv("tutorial", observation="mine").reset(seed=0)


def test_whole_numbers_of_an_observation_become_real(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OBSERVATIONS, "mine", _mine(lambda _, now: jax.numpy.ones_like(now.q[:, :1], int)))
    seen, _ = ReachEnv("tutorial", observation="mine").reset(seed=0)
    assert (seen.dtype, seen.tolist()) == (np.float32, [1.0])


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (lambda _, now, __: now.command[:, :3], r"gives a command in shape \(1, 3\): one number an actuator is needed"),
        (lambda *_: 0.0, r"gives a command in shape \(\)"),
        (lambda _, now, action: now.command + action, "fails at test_python_input.py"),
    ],
)
def test_an_action_that_gives_no_command_is_refused(
    command: Any, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ACTIONS, "mine", replace(ACTIONS["tool_delta"], command=command))
    with pytest.raises(InputError, match=f"action 'mine' {sentence}"):
        ReachEnv("tutorial", action="mine").reset(seed=0)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"sample_goal": None}, "task needs a function as `sample_goal`, got None"),
        ({"errors": lambda _, now: now.tol}, "`errors` fails at test_python_input.py"),
        ({"sample_goal": lambda setup, _: setup.nothing}, "`sample_goal` fails at test_python_input.py"),
        ({"near": lambda *_: 1 / 0}, "`near` fails at test_python_input.py:.*: division by zero"),
        ({"check": lambda _: next(iter([]))}, "`check` fails at"),
        (
            {"errors": lambda _, now: now.tool_position},
            r"`errors` gives float\[1, 3\]: it must give Errors\(distance=float\[1\], angle=float\[1, 0\]\) or",
        ),
        ({"goal_box": lambda _: (0.0, 1.0)}, r"`goal_box` gives \(float\[\], float\[\]\): it must give two corners"),
        (
            {"sample_goal": lambda *_: Goal.at(jax.numpy.zeros(2))},
            r"`sample_goal` gives Goal\(position=float\[2\], .*: it must give Goal\(position=float\[3\]",
        ),
        ({"sample_goal": lambda *_: jax.numpy.zeros(3)}, r"gives float\[3\]: it must give a Goal"),
        ({"sample_start": lambda *_: jax.numpy.zeros(3)}, r"gives float\[3\]: it must give float\[7\]"),
        ({"sample_bodies": lambda *_: absent(2)}, r"gives Bodies\(.*: it must give Bodies\(position=float\[0, 3\]"),
        ({"scene": lambda _: None}, "gives None: it must give Scene"),
        ({"near": lambda _, errors: errors.distance}, r"`near` gives float\[1\]: it must give bool\[1\]"),
        (
            {"begin": lambda _, errors: errors.distance, "update": lambda *_: ()},
            r"`update` gives \(\): it must give float\[1\]",
        ),
        ({"move": lambda _, goal, *__: goal}, r"`move` gives Goal\(.*: it must give \(Goal\("),
    ],
)
def test_a_task_that_cannot_be_is_refused(
    changed: dict[str, Any], sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind: Any = TASKS["tutorial"].load()
    task = replace(kind.task(), **changed)
    monkeypatch.setattr(kind, "task", staticmethod(lambda: task))
    with pytest.raises(InputError, match=sentence):
        _stepped("tutorial")


def test_a_controller_that_fails_is_told_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    mine: Any = SimpleNamespace(load=lambda: lambda _, now: now.nothing)
    monkeypatch.setitem(CONTROLLERS, "mine", mine)
    kind: Any = TASKS["precise"].load()
    task = replace(kind.task(), control=Control("mine", residual_gain=1.0))
    monkeypatch.setattr(kind, "task", staticmethod(lambda: task))
    env = reachlab.Env(reachlab.configure("precise", sim="kinematic", max_steps=3, hold_steps=1), 2)
    with pytest.raises(InputError, match=r"controller 'mine' fails at test_python_input.py:\d+"):
        reachlab.evaluate(env, "ik", episodes=2)


def test_a_controller_may_be_entered_as_the_function_that_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(CONTROLLERS, "mine", cast("Any", lambda _, now: 0 * now.q))
    kind: Any = TASKS["precise"].load()
    task = replace(kind.task(), control=Control("mine", residual_gain=1.0))
    monkeypatch.setattr(kind, "task", staticmethod(lambda: task))
    env = reachlab.Env(reachlab.configure("precise", sim="kinematic", max_steps=3, hold_steps=1, randomise=()), 2)
    assert reachlab.evaluate(env, "ik", episodes=2).success_rate == 0


def _stepped(task: str) -> None:
    env = ReachEnv(task)
    env.reset(seed=0)
    env.step(env.action_space.sample())


@pytest.mark.parametrize("entry", [Lazy("mine", "reachlab.tasks.task:stay"), int])
def test_an_entry_that_is_no_task_is_refused(entry: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TASKS, "mine", entry)
    with pytest.raises(InputError, match=r"task 'mine' is .*: add it as Lazy"):
        reachlab.configure("mine")


@pytest.mark.parametrize(
    "changed",
    [{"episodes": 0}, {"episodes": 1.5}, {"fps": 0.0}, {"fps": -1.0}, {"fps": np.nan}, {"seed": -1}, {"speed": np.inf}],
)
def test_a_film_of_odd_numbers_is_refused(changed: dict[str, Any], tmp_path: Path) -> None:
    env = reachlab.Env(reachlab.configure("tutorial", max_steps=5), 1)
    with pytest.raises(InputError, match=f"{next(iter(changed))} must be"):
        reachlab.write_video(env, "ik", None, tmp_path / "a.webp", **changed)


def test_what_cannot_be_filmed_drawn_or_made_an_environment_is_told_so(tmp_path: Path) -> None:
    odd: Any = "tutorial"
    for call, sentence in (
        (
            lambda: reachlab.write_video(odd, "ik", None, tmp_path / "a.webp"),
            "write_video needs an Env, .*'tutorial'",
        ),
        (lambda: reachlab.plot([], tmp_path / "a.png"), "name at least one"),
        (lambda: reachlab.load(cast("Any", None)), r"a run is given by its directory .*, got NoneType"),
        (lambda: reachlab.export(cast("Any", 3), tmp_path / "export"), r"a run is given by its directory .*, got int"),
        (lambda: reachlab.forward_kinematics(cast("Any", odd), [0.0]), r"a chain is needed, .*, got str"),
        (lambda: reachlab.Env(odd, 2), "settings are needed, as reachlab.configure"),
        (
            lambda: reachlab.train(reachlab.configure(), tmp_path / "run", threads=-3),
            "threads must be a whole number",
        ),
    ):
        with pytest.raises(InputError, match=sentence):
            call()
    assert not [*tmp_path.iterdir()]


def test_films_of_environments_take_their_time() -> None:
    assert ReachEnv("tutorial").metadata["render_fps"] == 240
    assert ReachEnv("precise").metadata["render_fps"] == 50


def test_xla_is_quiet_in_a_program_that_imports_reachlab() -> None:
    code = "import os, reachlab; print(os.environ['TF_CPP_MIN_LOG_LEVEL'])"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env={}, check=True)
    assert told.stdout == "3\n"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["train", "--resume", "run", "--config", "a.json"],
            "goes on with the settings that are there: leave --config",
        ),
        (["train", "--engine", "nonsense", "--out", "run"], "engine 'nonsense' is not one of"),
    ],
)
def test_flags_without_effect_are_refused(
    words: list[str], sentence: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(words) == cli.WRONG_INPUT
    assert sentence in capsys.readouterr().err


def test_a_training_of_a_sweep_imports_what_is_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = {"format": 2, "task": "nowhere", "imports": []}
    run_training(str(tmp_path / "run"), config, "success_rate", 1)
    said = json.loads(failure_file(tmp_path / "run").read_text())["error"]
    assert said.startswith("task 'nowhere' is not one of: ")
    assert said.endswith("One of your own is imported first: by --import FILE, or in Python.")
    entries = [EntryPoint("mine", "nowhere_at_all", extensions.GROUP)]
    monkeypatch.setattr(extensions, "entry_points", lambda group: entries if group == extensions.GROUP else [])
    extensions.import_installed.cache_clear()
    try:
        run_training(str(tmp_path / "run"), config, "success_rate", 1)
        said = json.loads(failure_file(tmp_path / "run").read_text())["error"]
        assert said.startswith("extension 'nowhere_at_all' cannot be imported")
    finally:
        extensions.import_installed.cache_clear()
