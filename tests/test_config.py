from __future__ import annotations

import dataclasses
import json
import math
from importlib import metadata

import jax.numpy as jnp
import numpy as np
import pytest

from reachlab.envs.earlier_configs import from_json
from reachlab.envs.presets import configure, in_simulator, preset
from reachlab.settings.config import LearnerConfig, LoopConfig, PPOConfig, RunConfig, SimConfig
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.preset_record import Preset, Rule
from reachlab.settings.validation import InputError, choose, installing
from reachlab.tasks import TASKS

PHYSICS = to_json(preset())["physics"]

RULES = [rule for task in TASKS.values() for rule in task.load().preset.rules]


def plain(**changes):
    """JSON form of the tutorial's preset, through text, with top-level entries changed."""
    return json.loads(json.dumps(to_json(preset("tutorial")))) | changes


# --- names -------------------------------------------------------------------------------------------


def test_choose_gives_the_name_itself():
    assert choose("reward", "dense", ["sparse", "dense"]) == "dense"


def test_choose_names_what_is_allowed_and_what_is_near():
    with pytest.raises(InputError) as refused:
        choose("reward", "spars", ["sparse", "dense"])
    assert str(refused.value) == "reward 'spars' is not one of: dense, sparse. Did you mean 'sparse'?"


def test_choose_guesses_nothing_where_nothing_is_near():
    with pytest.raises(InputError, match=r"is not one of: dense, sparse\.$"):
        choose("reward", "xyz", ["sparse", "dense"])


def test_unknown_setting_is_refused_with_the_nearest():
    with pytest.raises(
        InputError,
        match=r"setting 'learning_rat' does not exist. Did you mean 'learning_rate'\?",
    ):
        configure(learning_rat=1e-3)


@pytest.mark.parametrize("name", ["rules", "physics", "loop", "learner", "ppo"])
def test_sections_are_no_settings(name):
    with pytest.raises(InputError, match="setting"):
        configure("tutorial", **{name: None})


# --- configure ---------------------------------------------------------------------------------------


def test_configure_changes_only_what_is_named_wherever_it_lives():
    config = configure("tutorial", seed=3, action="joint_delta", control_period=0.01, gamma=0.9)
    before = preset("tutorial")
    assert (config.seed, config.rules.action, config.physics.control_period, config.ppo.gamma) == (
        3,
        "joint_delta",
        0.01,
        0.9,
    )
    assert dataclasses.replace(config.rules, action=before.rules.action) == before.rules
    assert dataclasses.replace(config.ppo, gamma=before.ppo.gamma) == before.ppo
    assert config.robot == before.robot


@pytest.mark.parametrize("task", TASKS)
def test_configure_without_settings_is_the_preset(task):
    assert configure(task) == preset(task)
    assert preset(task).task == task


@pytest.mark.parametrize("chosen", [{"reward": "sparse"}, {"observation": "image"}, {"sim": "pybullet"}], ids=str)
def test_a_choice_brings_defaults_which_settings_change(chosen):
    config = configure(**chosen)
    assert len(differing(config, preset())) > 2
    assert differing(configure(**chosen, gamma=0.5), config) == {"gamma"}


@pytest.mark.parametrize("chosen", [{"reward": "sparse"}, {"observation": "image"}], ids=str)
def test_where_the_target_is_held_actions_are_not_repeated(chosen):
    assert differing(configure("precise", **chosen, action="joint_delta"), preset("precise", action="joint_delta")) == (
        set(chosen)
    )


def test_what_observes_pictures_corrects_no_controller_that_knows_more():
    assert configure("precise", observation="image").rules.action == "joint_delta"
    assert configure("tutorial", observation="image").rules.action == preset("tutorial").rules.action


def test_a_later_rule_outranks_an_earlier_one_and_what_is_chosen_all(monkeypatch):
    rules = tuple(Rule(lambda _: True, {"gamma": value, "sim": "mujoco"}) for value in (0.1, 0.2))
    monkeypatch.setattr("reachlab.tasks.precise.Precise.preset", Preset(rules=rules))
    config = preset("precise", sim="kinematic")
    assert (config.ppo.gamma, config.sim) == (0.2, "kinematic")


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: ", ".join(list(rule.settings)[:3]))
def test_every_rule_is_for_some_configuration_and_names_settings(rule):
    choices = [{}, {"sim": "pybullet"}, {"sim": "mujoco"}, {"reward": "sparse"}, {"observation": "image"}]
    actions = [{"action": "joint_delta"}, {"action": "heading"}]
    presets = [preset(task, **chosen) for task in TASKS for chosen in [*choices, *actions]]
    assert any(rule.when(config) for config in presets)
    assert rule.settings.keys() <= flatten(to_json(preset())).keys()


def test_what_was_changed_from_a_preset_stays_in_another_simulator():
    changed = in_simulator(configure(num_envs=4, gamma=0.5), "pybullet")
    assert (changed.loop.num_envs, changed.ppo.gamma) == (4, 0.5)
    assert in_simulator(configure(), "pybullet") == configure(sim="pybullet")
    assert in_simulator(in_simulator(configure(), "pybullet"), "kinematic") == configure()


def differing(one, other):
    """Names of the settings in which two configurations differ."""
    a, b = flatten(to_json(one)), flatten(to_json(other))
    return {name for name in a if a[name] != b[name]}


def test_a_setting_belongs_to_one_section():
    for task in TASKS.values():
        sections = (RunConfig, task.load(), SimConfig, LoopConfig, LearnerConfig, PPOConfig)
        names = [field.name for section in sections for field in dataclasses.fields(section)]
        assert len(names) == len(set(names))


def test_settings_cannot_be_changed_behind_the_checks():
    with pytest.raises(dataclasses.FrozenInstanceError):
        preset("tutorial").ppo.gamma = 2.0  # pyright: ignore[reportAttributeAccessIssue]


# --- values ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("gamma", 1.01, r"gamma must be at least 0 and at most 1, got 1\.01"),
        ("gamma", -0.01, "gamma must be"),
        ("learning_rate", 0.0, r"learning_rate must be above 0, got 0\.0"),
        ("learning_rate", math.nan, "learning_rate must be above 0, got nan"),
        ("learning_rate", math.inf, r"learning_rate must be above 0 and at most 1e\+12, got inf"),
        ("learning_rate", 1e308, r"learning_rate must be above 0 and at most 1e\+12, got 1e\+308"),
        (
            "target_low",
            (math.nan, 0.0, 0.0),
            "each entry of target_low must be at least -1000 and at most 1000, got nan",
        ),
        ("target_high", (0.0, math.inf, 0.0), "each entry of target_high must be at least -1000 and at most 1000"),
        ("target_high", (0.0, 0.0, 1e308), "each entry of target_high must be at least -1000 and at most 1000"),
        ("keep_checkpoints", 2**31, "keep_checkpoints must be at least 1 and at most 2147483647"),
        ("physics_steps", 2**31 - 1, "physics_steps must be at least 1 and at most 1000"),
        ("validation_episodes", 10**6, "validation_episodes must be at least 1 and at most 100000"),
        ("max_steps", 10**6, "max_steps must be at least 1 and at most 100000"),
        ("epochs", 2**31 - 1, "epochs must be at least 1 and at most 1000"),
        ("target_height", -math.inf, "target_height must be"),
        ("approach_weight", -1.0, "approach_weight must be at least 0"),
        ("num_envs", 0, "num_envs must be at least 1 and at most 131072, got 0"),
        ("seed", -1, "seed must be"),
        ("seed", 2**31, "seed must be"),
        ("hidden", (64, 0), r"each entry of hidden must be at least 1 and at most 4096, got 0"),
        ("control_period", -0.01, "control_period must be at least 1e-05 and at most 10"),
    ],
)
def test_number_out_of_range_is_refused(name, value, message):
    with pytest.raises(InputError, match=message):
        configure("tutorial", **{name: value})


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("num_envs", 1.5, "num_envs must be a whole number, got 1.5"),
        ("num_envs", "256", "num_envs must be a whole number, got '256'"),
        ("gamma", "0.9", "gamma must be a number, got '0.9'"),
        ("gamma", None, "gamma must be a number, got None"),
        ("clip_actions", "no", "clip_actions must be true or false, got 'no'"),
        ("clip_actions", 1, "clip_actions must be true or false, got 1"),
        ("reward", 3, "reward must be a name, got 3"),
        ("hidden", (64, "64"), "each entry of hidden must be a whole number, got '64'"),
        ("hidden", 64, "hidden must be a list, each entry a whole number, got 64"),
        ("target_low", (0.0, 0.0), r"target_low must be a list of 3, each entry a number, got \(0.0, 0.0\)"),
    ],
)
def test_value_of_the_wrong_type_is_refused(name, value, message):
    with pytest.raises(InputError, match=message):
        configure("tutorial", **{name: value})


@pytest.mark.parametrize("name", ["num_envs", "gamma", "seed"])
def test_truth_value_is_no_number(name):
    with pytest.raises(InputError, match=f"{name} must be"):
        configure("tutorial", **{name: True})


def test_whole_number_will_do_where_a_number_is_asked_for():
    assert configure(gamma=1, learning_rate=1, target_height=0).ppo.gamma == 1


@pytest.mark.parametrize(("name", "value"), [("gamma", 0.0), ("gamma", 1.0), ("seed", 2**31 - 1), ("num_envs", 1)])
def test_bounds_of_a_range_belong_to_it(name, value):
    config = configure("tutorial", **{name: value})
    assert flatten(to_json(config))[name] == value


# --- JSON --------------------------------------------------------------------------------------------


def test_config_survives_json_text():
    config = configure("tutorial", hidden=(32, 16, 8), seed=5, control_period=1 / 240, learning_rate=1e-3 / 3)
    again = from_json(json.loads(json.dumps(to_json(config))))
    assert again == config
    assert again.learner.hidden == (32, 16, 8)
    assert hash(again) == hash(config)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([], "must be an object of settings, got list"),
        (None, "must be an object of settings, got NoneType"),
        (plain(colour="red"), "holds an unknown setting 'colour'"),
        (plain(ppo=[]), "ppo, must be an object of settings"),
        (plain(format=3), "has format 3, and this version reads 1 to 2"),
        (plain(physics=PHYSICS | {"gravity": 1}), "physics, holds an unknown setting 'gravity'"),
        (plain(physics=PHYSICS | {"control_period": "fast"}), "control_period must be a number, got 'fast'"),
        (
            plain(physics=PHYSICS | {"control_period": math.nan}),
            "control_period must be at least 1e-05 and at most 10, got nan",
        ),
        (plain(seed=None), "seed must be"),
        (plain(seed=1.0), "seed must be"),
        (plain(seed=[1]), "seed must be"),
        (plain(learner=plain()["learner"] | {"hidden": "64"}), "hidden"),
        (plain(learner=plain()["learner"] | {"hidden": [64, None]}), "hidden"),
    ],
)
def test_damaged_json_is_refused(data, message):
    with pytest.raises(InputError, match=message):
        from_json(data)


@pytest.mark.parametrize(
    ("origin", "command"),
    [
        ('{"url": "file:///a%20b/arm", "dir_info": {"editable": true}}', "pip install -e '/a b/arm[video]'"),
        ('{"url": "file:///arm", "dir_info": {}}', "pip install '/arm[video]'"),
        ('{"url": "file:///reachlab.whl", "archive_info": {}}', "pip install 'reachlab[video]'"),
        (None, "pip install 'reachlab[video]'"),
    ],
)
def test_an_extra_is_installed_in_the_way_in_which_reachlab_was(
    origin: str | None, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metadata.Distribution, "read_text", lambda _self, _name: origin, raising=False)
    monkeypatch.setattr(metadata.PathDistribution, "read_text", lambda _self, _name: origin)
    assert installing("video") == command


@pytest.mark.parametrize("kind", [list, tuple, np.array, jnp.array])
def test_lists_and_arrays_are_what_a_list_of_flags_is(kind):
    corner = (0.25, -0.5, 0.125)
    config = configure("precise", target_low=kind(corner), hidden=kind((16, 8)))
    assert config == configure("precise", target_low=corner, hidden=(16, 8))
    assert from_json(json.loads(json.dumps(to_json(config)))) == config
