"""Configurations: what goes with a task and with other choices, and what is changed of it."""

from __future__ import annotations

import dataclasses
import os
from typing import Any, TypeVar

from reachlab.settings.arguments import typed
from reachlab.settings.config import DistilRunConfig, PPOConfig, RunConfig
from reachlab.settings.extensions import IMPORTED, import_installed
from reachlab.settings.json_form import flatten, override, to_json
from reachlab.settings.preset_record import Preset
from reachlab.settings.rules import TaskSettings
from reachlab.settings.tables import Lazy
from reachlab.settings.validation import InputError, choose, hints
from reachlab.sims import SIMULATORS
from reachlab.tasks import TASKS

CHOICES = ("sim", "observation", "action", "reward")
"""Settings that, like the task, decide the defaults of others."""

DISTILLATION: dict[str, Any] = {
    "total_steps": 40 * 4096,
    "stop_early": False,
    "num_envs": 128,
    "rollout_steps": 8,
    "action_repeat": 4,
    "report_episodes": 200,
    "learning_rate": 3e-3,
    "final_learning_rate": 1e-4,
    "max_grad_norm": 1.0,
    "chained_starts": 0.0,
    "initial_policy": None,
}
"""Settings with which a distillation starts, beside those of its teacher's task."""

NOT_TAUGHT = frozenset({"chained_starts", *(entry.name for entry in dataclasses.fields(PPOConfig))})
"""Settings of a training by trial and error alone."""

Config = TypeVar("Config", bound=RunConfig)


def preset(task: str = "tutorial", **chosen: Any) -> RunConfig:
    """Configuration of a task with the settings of `CHOICES` that were `chosen`, and the defaults that follow.

    Raises:
        InputError: no such task, or a value that is not allowed.
    """
    import_installed()
    entry: Any = TASKS[choose("task", task, TASKS)]
    kind = entry.load() if isinstance(entry, Lazy) else None
    if not isinstance(kind, type) or not issubclass(kind, TaskSettings):
        raise InputError(
            f"task {task!r} is {kind or entry!r}: add it as Lazy('what is asked', 'module:Class'), where Class is a"
            " TaskSettings."
        )
    base: Preset = kind.preset
    config = RunConfig(
        task=task,
        sim=base.sim,
        robot=base.robot,
        randomise=base.randomise,
        imports=tuple(IMPORTED),
        rules=kind(),
        physics=base.physics,
        loop=base.loop,
        learner=base.learner,
        ppo=base.ppo,
    )
    config = override(config, **chosen)
    if "observation" in chosen and "action" not in chosen:
        config = override(config, action=_own_action(config))
    if config.sim in SIMULATORS:
        config = override(config, **SIMULATORS[config.sim].defaults)
    for rule in base.rules:
        if rule.when(config):
            config = override(config, **{name: value for name, value in rule.settings.items() if name not in chosen})
    return config


def preset_of(config: RunConfig, **changed: str) -> RunConfig:
    """The preset that a configuration started from, with the choices that are `changed`."""
    settings = flatten(to_json(config))
    return preset(config.task, **({name: settings[name] for name in CHOICES} | changed))


def configure(task: str = "tutorial", **settings: Any) -> RunConfig:
    """Preset with the named settings changed, e.g. `configure("tutorial", reward="sparse", seed=3)`.

    Args:
        task: name of the task.
        settings: settings by name, as the flags of `reachlab train` with underscores.

    Raises:
        InputError: a name that is no setting of the task, or a value that is not allowed.
    """
    settings |= {name: str(value) for name, value in settings.items() if isinstance(value, os.PathLike)}
    chosen = {name: settings[name] for name in CHOICES if settings.get(name) is not None}
    config = preset(task, **chosen)
    for name in settings:
        if sentence := of_other_tasks(name, config):
            raise InputError(sentence)
    return override(config, **settings)


def of_other_tasks(name: str, config: RunConfig) -> str | None:
    """A sentence on a setting that other tasks have and that of a configuration does not; None of any other name."""
    if name in flatten(to_json(config)) or name == "task":
        return None
    others = [task for task, entry in TASKS.items() if name in hints(entry.load())]
    if not others:
        return None
    return f"{name} is a setting of task {' or '.join(others)}, and not of {config.task}: leave it out, or choose that."


def in_simulator(config: Config, sim: str) -> Config:
    """A configuration in another simulator, with that one's defaults where it has those of its own."""
    if sim == config.sim:
        return config
    here, there = (flatten(to_json(preset_of(config, sim=name))) for name in (config.sim, sim))
    own = flatten(to_json(config))
    follow = {name for name in there if here[name] != there[name] and own[name] == here[name]}
    return override(config, **{name: there[name] for name in follow})


@typed
def distillation(teacher: str, taught: RunConfig, **settings: Any) -> DistilRunConfig:
    """Configuration of a student of the teacher in the run directory `teacher`, which was trained as `taught`.

    Args:
        teacher: run directory of the teacher.
        taught: its settings, as `load(teacher).config`.
        settings: settings of the student by name, where they differ.

    Raises:
        InputError: a name that is no setting or has no effect, or a value that is not allowed.
    """
    from reachlab.tasks.observations import OBSERVATIONS

    for name in settings:
        if name in NOT_TAUGHT:
            raise InputError(f"{name} has no effect on a student, which is taught by its teacher: leave it out.")
    parts = {entry.name: getattr(taught, entry.name) for entry in dataclasses.fields(RunConfig)}
    own = settings
    settings = {"observation": "image", **DISTILLATION, **TASKS[taught.task].load().preset.student} | own
    settings.setdefault("anneal_steps", settings["total_steps"])
    choose("observation", settings["observation"], OBSERVATIONS)
    config = DistilRunConfig(
        **parts,
        teacher=teacher,
        teacher_observation=taught.rules.observation,
        teacher_action=taught.rules.action,
        teacher_hidden=taught.learner.hidden,
    )
    config = override(config, **settings)
    config = override(config, action=settings.get("action", _student_action(config)))
    # Where things are in a picture is what its encoder finds: no layer comes after it.
    return config if "hidden" in own or not _points(config) else override(config, hidden=())


def _student_action(config: RunConfig) -> str:
    """Where things are in the picture, if the task's controller needs to know no more."""
    from reachlab.tasks.actions import ACTIONS
    from reachlab.tasks.observations import OBSERVATIONS

    given = config.rules.gives | OBSERVATIONS[config.rules.observation].gives
    return next((name for name, one in ACTIONS.items() if one.points and one.needs <= given), _own_action(config))


def _points(config: RunConfig) -> bool:
    from reachlab.tasks.actions import ACTIONS

    return ACTIONS[config.rules.action].points > 0


def _own_action(config: RunConfig) -> str:
    """The action of a configuration, without a controller that knows what a picture is there to show."""
    from reachlab.tasks.actions import ACTIONS
    from reachlab.tasks.observations import OBSERVATIONS

    name = config.rules.action
    action, observation = ACTIONS.get(name), OBSERVATIONS.get(config.rules.observation)
    if action and action.whole and observation and not action.needs <= observation.gives:
        return action.whole
    return name
