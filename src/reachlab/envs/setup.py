"""Where a configuration is settled, once: names, what fits together, and what the arm can reach."""

from __future__ import annotations

import dataclasses
import logging
from typing import Any

from reachlab.envs.consistency import check, check_env
from reachlab.envs.delays import age
from reachlab.envs.presets import configure, in_simulator, of_other_tasks, preset
from reachlab.robots.kinematics.chain import significant
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.rules import TaskSettings
from reachlab.settings.validation import BY_ARM, InProportion, InputError, choose, hints
from reachlab.sims import SIMULATORS
from reachlab.tasks.checked import checked
from reachlab.tasks.reachability import SAMPLES, survey
from reachlab.tasks.task import Task, TaskSetup

MOST_OUT_OF_REACH = 0.05
"""Share of goals out of reach from which it is said that those fail whatever is learnt."""

log = logging.getLogger(__name__)


def configure_env(task: str, **settings: Any) -> RunConfig:
    """Configuration of an environment for other learners: a preset with the settings changed.

    What varies in the training that a preset describes does not vary in it, unless it is asked for.

    Raises:
        InputError: a setting that does not exist, a value that is not allowed, or see `check`.
    """
    config = configure(task, **{"randomise": (), **settings})
    check(config)
    return config


def make_setup(config: RunConfig) -> TaskSetup:
    """The task of a configuration on its arm, whose joints follow at once.

    Raises:
        InputError: a name that does not exist, settings that contradict each other, or one that does not fit the arm.
    """
    check_env(config)
    task = _task(type(config.rules))
    robot = load_robot(
        config.robot,
        config.rules.tool,
        kind=task.tool,
        base=config.base,
        packages=config.package,
        gripper=config.rules.mounts,
        grips=config.rules.grips,
    )
    lag = (0.0,) * robot.chain.n
    period = config.physics.control_period
    late = age(period) if "delay" in config.randomise else 0.0
    rules, shaped = on_arm(config.rules, robot), config.physics.shaping
    setup = TaskSetup(robot, period, lag, task, rules, late=late, shaped=shaped)
    task.check(setup)
    return setup


_tasks: dict[type[TaskSettings], tuple[Task, Task]] = {}


def _task(kind: type[TaskSettings]) -> Task:
    """The task of settings as it is now, checked; raises `InputError` where one that was added lacks a function."""
    given = kind.task()  # a notebook may have other functions by now
    if kind not in _tasks or _tasks[kind][0] != given:
        _tasks[kind] = given, checked(given, kind.__name__)
    return _tasks[kind][1]


def settled(config: RunConfig, setup: TaskSetup) -> RunConfig:
    """The configuration with the lengths that its rules take from the arm."""
    return dataclasses.replace(config, rules=setup.rules)


def on_arm(rules: TaskSettings, robot: Robot) -> TaskSettings:
    """The rules with lengths in proportion to the arm's workspace where none are given, to six significant digits."""
    floor, lengths = float(robot.workspace[0][2]), {}
    for name, hint in hints(type(rules)).items():
        for limit in getattr(hint, "__metadata__", ()):
            if isinstance(limit, InProportion) and getattr(rules, name) is BY_ARM:
                lengths[name] = significant(limit.on_arm(robot.scale, floor))
    return dataclasses.replace(rules, **lengths)


def in_evaluation(trained: RunConfig, sim: str | None, **changed: Any) -> RunConfig:
    """Settings of a run for an evaluation, by default in its own simulator: nothing varies but what is `changed`.

    Raises:
        InputError: no such simulator, or a setting without effect there.
    """
    config = in_simulator(trained, choose("simulator", sim or trained.sim, [*SIMULATORS, "all"]))
    plain = override(config, gui=False, slow=False, randomise=())
    for name in changed:
        if sentence := of_other_tasks(name, plain):
            raise InputError(sentence)
    config = override(plain, **changed)
    check(config, plain)
    return config


# --- what the arm can reach -----------------------------------------------------------------------


def check_reach(config: RunConfig) -> None:
    """Say what share of the goals the arm can reach, if they or the arm are not the preset's; JAX is started.

    Raises:
        InputError: it can reach none.
    """
    if _places(config) == _places(preset(config.task)):
        return
    setup = make_setup(config)
    found, workspace = survey(setup), " to ".join(_point(corner) for corner in setup.robot.workspace)
    if not found.reached:
        low, high = setup.task.goal_box(setup)
        limits = f" inside its workspace, {workspace} m" if config.rules.ends_outside else ""
        raise InputError(
            f"none of the targets, {_point(low)} to {_point(high)} m, can be reached: the tool comes to none within"
            f" the success distance of {setup.rules.success_distance:g} m{limits}; `reachlab robot {config.robot}`"
            " shows its boxes."
        )
    lost = "; the others fail whatever is learnt" if found.reached < 1 - MOST_OUT_OF_REACH else ""
    log.warning("reachlab: the arm can reach %.3g %% of %d random targets%s.", 100 * found.reached, SAMPLES, lost)
    if found.outside:
        log.warning(
            "reachlab: %.3g %% of the episodes begin with the tool outside its workspace, %s m, and end at their first"
            " step: choose less --start-noise.",
            100 * found.outside,
            workspace,
        )


def _places(config: RunConfig) -> tuple[Any, ...]:
    """All that decides what can be reached."""
    rules = vars(config.rules)
    named = ("tool", "targets", "target_low", "target_high", "target_height", "success_distance")
    bounded = config.rules.ends_outside
    starts = config.rules.start_noise if bounded else 0.0
    return (config.robot, config.base, *(rules.get(name) for name in named), bounded, starts)


def _point(corner: Any) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in corner) + ")"
