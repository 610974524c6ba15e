"""Where a configuration is settled, once: names, what fits together, and what the arm can reach."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Mapping
from typing import Any

from reachlab.robots.chain import significant
from reachlab.robots.loading import load_robot
from reachlab.robots.robot import Robot
from reachlab.settings.config import RunConfig
from reachlab.settings.consistency import check_consistency
from reachlab.settings.json_form import flatten, override, to_json
from reachlab.settings.needs import Facts
from reachlab.settings.presets import configure, in_simulator, preset
from reachlab.settings.rules import Rules, TaskConfig
from reachlab.settings.validation import InputError, choose
from reachlab.sims import SIMULATORS
from reachlab.tasks import TASKS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.observations import OBSERVATIONS
from reachlab.tasks.paths import PATHS
from reachlab.tasks.reach import AT_GOAL
from reachlab.tasks.reachability import SAMPLES, survey
from reachlab.tasks.rewards import REWARDS
from reachlab.tasks.targets import TARGETS
from reachlab.tasks.task import Task, TaskSetup

NAMES: dict[str, tuple[str, Mapping[str, object]]] = {
    "task": ("task", TASKS),
    "sim": ("simulator", SIMULATORS),
    "observation": ("observation", OBSERVATIONS),
    "action": ("action", ACTIONS),
    "reward": ("reward", REWARDS),
    "targets": ("targets", TARGETS),
    "at_goal": ("at_goal", AT_GOAL),
    "goal_paths": ("goal path", PATHS),
}
"""Settings that are names of tables, or lists of them, and what they are called."""

MOST_OUT_OF_REACH = 0.05
"""Share of goals out of reach from which it is said that those fail whatever is learnt."""

log = logging.getLogger(__name__)


def check_names(config: RunConfig) -> None:
    """Make sure that what a configuration names is there.

    Raises:
        InputError: it is not; the sentence lists the names and the nearest one.
    """
    settings = flatten(to_json(config))
    for setting, (kind, table) in NAMES.items():
        chosen = settings[setting]
        for name in (chosen,) if isinstance(chosen, str) else chosen:
            choose(kind, name, table)


def check(config: RunConfig, base: RunConfig | None = None) -> None:
    """Make sure that settings make sense together, and say what follows from those changed from `base`.

    Args:
        config: the settings.
        base: what they are changed from; without it their preset.

    Raises:
        InputError: a name that does not exist, settings that contradict each other, or one without effect.
    """
    check_names(config)
    observation, action = OBSERVATIONS[config.rules.observation], ACTIONS[config.rules.action]
    task: Task = TASKS[config.task].load()
    facts = Facts(
        pictures=observation.pictured,
        dynamics=SIMULATORS[config.sim].dynamics,
        scale=action.scale,
        turns=action.turns,
        asks_orientation=config.rules.asks_orientation,
        needs_pose=observation.needs_pose,
        needs_velocity=observation.needs_velocity,
        needs_obstacles=observation.needs_obstacles,
        moves=task.move is not None,
        obstructed=task.sample_obstacles is not None,
        contacts=SIMULATORS[config.sim].obstacles,
    )
    check_consistency(config, facts, base)


def configure_env(task: str, settings: Mapping[str, Any]) -> RunConfig:
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
        InputError: a name that does not exist, or a rule that does not fit the arm.
    """
    check_names(config)
    task: Task = TASKS[config.task].load()
    robot = load_robot(config.robot, config.rules.tool, kind=task.tool, base=config.base, packages=config.package)
    setup = TaskSetup(task, _on_arm(config.rules, robot), robot, config.physics.control_period, (0.0,) * robot.chain.n)
    task.check(setup)
    return setup


def settled(config: RunConfig, setup: TaskSetup) -> RunConfig:
    """The configuration with the lengths that its rules take from the arm."""
    rules = {entry.name: getattr(setup.rules, entry.name) for entry in dataclasses.fields(TaskConfig)}
    return dataclasses.replace(config, rules=TaskConfig(**rules))


def _on_arm(rules: TaskConfig, robot: Robot) -> Rules:
    """The rules with lengths in proportion to the arm's workspace where none are given, to six significant digits."""
    usual, scale = Rules(), robot.scale
    lengths: dict[str, Any] = {
        "tool_scale": usual.tool_scale * scale,
        "success_distance": usual.success_distance * scale,
        "approach_weight": usual.approach_weight / scale,
        "goal_jump": usual.goal_jump * scale,
        "target_height": float(robot.workspace[0][2]) + usual.target_height * scale,
    }
    lengths = {name: significant(value) for name, value in lengths.items()}
    given: dict[str, Any] = {
        name: value for name, value in vars(rules).items() if value is not None or name not in lengths
    }
    return Rules(**(lengths | given))


def in_evaluation(trained: RunConfig, sim: str, **changed: Any) -> RunConfig:
    """Settings of a run in a simulator for an evaluation: without what varied in training, but for what is `changed`.

    Raises:
        InputError: no such simulator, or a setting without effect there.
    """
    config = in_simulator(trained, choose("simulator", sim, [*SIMULATORS, "all"]))
    plain = override(config, gui=False, slow=False, randomise=())
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
    rules = config.rules
    box = (rules.target_low, rules.target_high) if rules.targets == "box" else rules.target_height
    starts = rules.start_noise if rules.ends_outside else 0.0
    return (
        config.robot,
        config.base,
        rules.tool,
        rules.targets,
        box,
        rules.success_distance,
        rules.ends_outside,
        starts,
    )


def _point(corner: Any) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in corner) + ")"
