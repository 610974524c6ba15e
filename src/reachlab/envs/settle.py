"""Settings that make no sense together, told before any time is spent: the one place where a configuration is settled.

What is changed from its preset and has no effect is refused; what has another effect than one may expect is said.
Presets and defaults trouble nobody.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from reachlab.robots.loading import load_robot
from reachlab.settings.config import CHOICES, PICTURED, RunConfig, flatten, in_simulator, override, preset, to_json
from reachlab.settings.validation import InputError, choose
from reachlab.sims import SIMULATORS
from reachlab.tasks.reach import ACTIONS, OBSERVATIONS, REWARDS, TARGETS, make_reach
from reachlab.tasks.reachability import SAMPLES, survey

Settings = Mapping[str, Any]
"""Every setting of a run by name, whatever part holds it."""

NAMES: dict[str, tuple[str, Mapping[str, object]]] = {
    "sim": ("simulator", SIMULATORS),
    "observation": ("observation", OBSERVATIONS),
    "action": ("action", ACTIONS),
    "reward": ("reward", REWARDS),
    "targets": ("targets", TARGETS),
}
"""Settings that are names of tables, and what they are called."""

MOST_OUT_OF_REACH = 0.05
"""Share of targets out of reach from which it is said that those fail whatever is learnt."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Need:
    """What a setting needs to have an effect: in words, and as a question to the settings."""

    words: str
    met: Callable[[Settings], bool]
    vital: bool = True
    """Whether a training without that effect is not the one that was asked for: it is refused, else this is said."""


MUJOCO = Need("sim mujoco", lambda s: s["sim"] == "mujoco")
PYBULLET = Need("sim pybullet", lambda s: s["sim"] == "pybullet")
TABLE = Need("targets table", lambda s: s["targets"] == "table")
BOX = Need("targets box", lambda s: s["targets"] == "box")
PRECISE = Need("reward precise", lambda s: s["reward"] == "precise")
STOP_EARLY = Need("stop_early", lambda s: s["stop_early"], vital=False)

NEEDS: dict[str, Need] = {
    "tool_scale": Need("action tool_delta", lambda s: s["action"] == "tool_delta"),
    "joint_scale": Need("an action of the joints, as joint_delta", lambda s: s["action"] != "tool_delta"),
    "target_height": TABLE,
    "target_low": BOX,
    "target_high": BOX,
    "hold_speed": Need("hold_steps above 0 or reward precise", lambda s: s["hold_steps"] or s["reward"] == "precise"),
    "approach_weight": Need("reward dense or precise", lambda s: s["reward"] != "sparse"),
    "closeness_weight": PRECISE,
    "closeness_scale": Need(
        "reward precise and closeness_weight above 0", lambda s: s["reward"] == "precise" and s["closeness_weight"] > 0
    ),
    "effort_weight": PRECISE,
    "physics_steps": MUJOCO,
    "collisions": MUJOCO,
    "gravity_compensation": MUJOCO,
    "gui": PYBULLET,
    "slow": PYBULLET,
    "randomise_view": Need("an observation with a picture, as image", lambda s: s["observation"] in PICTURED),
    "stop_success": STOP_EARLY,
    "stop_streak": STOP_EARLY,
    "validation_episodes": STOP_EARLY,
    "validation_interval": STOP_EARLY,
    "randomise": Need("arms that are not perturbed anyway", lambda s: not s["perturb"]),
}
"""What settings need to have an effect; those that are not here always have one."""


def _held_too_long(s: Settings) -> str | None:
    if s["hold_steps"] > s["max_steps"]:
        return (
            f"the tool cannot be held for hold_steps {s['hold_steps']} in an episode of max_steps {s['max_steps']}:"
            " choose fewer --hold-steps or more --max-steps."
        )
    return None


def _crossed_box(s: Settings) -> str | None:
    for axis, low, high in zip("xyz", s["target_low"], s["target_high"], strict=True):
        if s["targets"] == "box" and low > high:
            return f"target_low is above target_high in {axis}, {low:g} against {high:g} m: exchange them."
    return None


def _minibatches(s: Settings) -> str | None:
    if s["num_envs"] % s["minibatches"]:
        return f"num_envs {s['num_envs']} cannot be divided among {s['minibatches']} minibatches: choose a divisor."
    return None


CONTRADICTIONS: tuple[Callable[[Settings], str | None], ...] = (_held_too_long, _crossed_box, _minibatches)
"""What can never be, wherever the settings are from: each gives its sentence, or nothing."""


def _action_held_too_long(s: Settings, changed: set[str]) -> str | None:
    if "action_repeat" in changed and s["action_repeat"] > s["max_steps"]:
        return (
            f"an action cannot be held for action_repeat {s['action_repeat']} in an episode of max_steps"
            f" {s['max_steps']}: choose a lower --action-repeat or more --max-steps."
        )
    return None


def _alike(s: Settings, changed: set[str]) -> str | None:
    named = sorted({"perturb", "randomise"} & changed)
    if named and s[named[0]] and s["sim"] != "mujoco":
        return (
            f"{named[0]} adds noise to what is measured and nothing else in simulator {s['sim']!r}: arms differ with"
            " --sim mujoco."
        )
    return None


def _annealed_too_late(s: Settings, changed: set[str]) -> str | None:
    if "anneal_steps" in changed and s["anneal_steps"] > s["total_steps"]:
        return (
            f"training ends after total_steps {s['total_steps']:,}, before the learning rate has fallen to its end"
            f" after anneal_steps {s['anneal_steps']:,}."
        )
    return None


CONSEQUENCES: tuple[Callable[[Settings, set[str]], str | None], ...] = (_alike, _annealed_too_late)
"""What is said of changed settings that have another effect than one may expect."""


def check(config: RunConfig, base: RunConfig | None = None) -> None:
    """Make sure that settings make sense together, and say what follows from those changed from `base`.

    Args:
        config: the settings.
        base: what they are changed from; without it the preset of their task, simulator, observation and reward.

    Raises:
        InputError: a name that does not exist, settings that contradict each other, or one without effect.
    """
    settings = flatten(to_json(config))
    for name, (kind, table) in NAMES.items():
        choose(kind, settings[name], table)
    for contradiction in CONTRADICTIONS:
        _refuse(contradiction(settings))
    before = base or preset(config.task, *(settings[name] for name in CHOICES))
    usual = flatten(to_json(before))
    changed = {name for name, value in settings.items() if usual.get(name, value) != value}
    _refuse(_action_held_too_long(settings, changed))
    for name in sorted(NEEDS.keys() & changed):
        if not NEEDS[name].met(settings):
            sentence = f"{name} has an effect only with {NEEDS[name].words}: leave it out, or choose that."
            _refuse(sentence if NEEDS[name].vital else None)
            log.warning("reachlab: %s", sentence)
    for consequence in CONSEQUENCES:
        if sentence := consequence(settings, changed):
            log.warning("reachlab: %s", sentence)


def _refuse(sentence: str | None) -> None:
    if sentence:
        raise InputError(sentence)


def in_evaluation(trained: RunConfig, sim: str, **flags: bool) -> RunConfig:
    """Settings of a run in a simulator for an evaluation: on arms and in the view as they are, but for the flags.

    Raises:
        InputError: no such simulator, or a flag without effect there.
    """
    config = in_simulator(trained, choose("simulator", sim, [*SIMULATORS, "all"]))
    as_it_is = override(config, gui=False, slow=False, perturb=False, randomise_view=False)
    sees = config.rules.observation
    if flags.get("randomise_view") and sees not in PICTURED:
        raise InputError(f"perturb_view has an effect only on a policy that sees pictures: {sees!r} holds none.")
    config = override(as_it_is, **flags)
    check(config, as_it_is)
    return config


# --- what the arm can reach -----------------------------------------------------------------------


def check_reach(config: RunConfig) -> None:
    """Say what share of the targets the arm can reach, if they or the arm are not the preset's; JAX is started.

    Raises:
        InputError: it can reach none.
    """
    if _places(config) == _places(preset(config.task)):
        return
    robot = load_robot(config.robot, config.rules.tool)
    reach = make_reach(config.rules, robot, config.physics.control_period, (0.0,) * robot.chain.n)
    found, workspace = survey(reach), " to ".join(_point(corner) for corner in reach.robot.workspace)
    if not found.reached:
        low, high = TARGETS[config.rules.targets](reach)
        limits = "" if config.rules.hold_steps else f" inside its workspace, {workspace} m"
        raise InputError(
            f"none of the targets, {_point(low)} to {_point(high)} m, can be reached: the tool comes to none within"
            f" the success distance of {config.rules.success_distance:g} m{limits}."
        )
    lost = "; the others fail whatever is learnt" if found.reached < 1 - MOST_OUT_OF_REACH else ""
    log.warning("reachlab: the arm can reach %.3g %% of the targets (%d drawn)%s.", 100 * found.reached, SAMPLES, lost)
    if found.outside:
        log.warning(
            "reachlab: %.3g %% of the episodes begin with the tool outside its workspace, %s m, and end at their first"
            " step: choose less --start-noise, or give the robot's file a keyframe 'home' inside.",
            100 * found.outside,
            workspace,
        )


def _places(config: RunConfig) -> tuple[Any, ...]:
    """All that decides what can be reached."""
    rules = config.rules
    box = (rules.target_low, rules.target_high) if rules.targets == "box" else rules.target_height
    starts = rules.start_noise if not rules.hold_steps else 0.0
    return config.robot, rules.tool, rules.targets, box, rules.success_distance, not rules.hold_steps, starts


def _point(corner: Any) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in corner) + ")"
