"""Which settings make sense together: pure rules on settings, told before any time is spent.

What is changed from its preset and has no effect is refused; what has another effect than one may expect is said.
Presets and defaults trouble nobody.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.needs import NEEDS, Asked, Facts
from reachlab.settings.presets import preset_of
from reachlab.settings.validation import InputError, choose

RANDOMISED = ("dynamics", "delay", "view")
"""What can vary from episode to episode; see `RunConfig.randomise`."""

log = logging.getLogger(__name__)


def _moves(s: Asked) -> str | None:
    low, high = s["goal_speed"]
    if s.facts.needs_velocity and not s.facts.moves:
        return f"observation {s['observation']!r} needs a goal that moves, as that of task 'track'."
    if not s.facts.moves:
        return None
    if not s["goal_paths"]:
        return "goal_paths names no path: choose one of those that `reachlab list` shows, or several."
    if low > high:
        return f"goal_speed has a least speed above the largest, {low:g} against {high:g} m/s: exchange them."
    if s["settle_steps"] >= s["max_steps"]:
        return (
            f"no step would count after settle_steps {s['settle_steps']} in an episode of max_steps {s['max_steps']}:"
            " choose fewer --settle-steps or more --max-steps."
        )
    if s["targets"] != "box" or s["target_turn"] is not None:
        return (
            f"the goal of task {s['task']!r} is a point that moves in a box: set targets to 'box', and leave"
            " target_turn out."
        )
    if s["at_goal"] != "continue" or s["hold_steps"] or s["end_outside"]:
        return (
            "a goal that moves is followed to the end of the episode: set at_goal to 'continue', hold_steps to 0 and"
            " end_outside to false."
        )
    return None


def _obstructed(s: Asked) -> str | None:
    if s.facts.needs_obstacles and not s.facts.obstructed:
        return f"observation {s['observation']!r} needs obstacles, as those of task 'clutter'."
    if not s.facts.obstructed:
        return None
    if not s.facts.contacts:
        return f"task {s['task']!r} has obstacles, and simulator {s['sim']!r} has none: use --sim mujoco."
    fewest, most = s["obstacles"]
    if fewest > most:
        return f"obstacles has a fewest number above the most, {fewest} against {most}: exchange them."
    if s["chained_starts"]:
        return (
            f"with chained_starts {s['chained_starts']:g} episodes would start inside obstacles, which leave"
            " only a start near home free: leave it out."
        )
    if s["targets"] != "box" or s["target_turn"] is not None:
        return f"the goal of task {s['task']!r} is a point in a box: set targets to 'box', and leave target_turn out."
    return None


def _orientation(s: Asked) -> str | None:
    turned = s.facts.asks_orientation
    if not turned and s.facts.needs_pose:
        return (
            f"observation {s['observation']!r} needs a goal with an orientation: set target_turn, or targets to 'any'."
        )
    if turned and not s.facts.turns:
        return (
            f"action {s['action']!r} holds the tool's orientation and cannot bring it into another: choose one of the"
            " joints, as joint_delta."
        )
    return None


def _at_goal(s: Asked) -> str | None:
    if s["at_goal"] == "hold" and s["hold_steps"]:
        return (
            f"at_goal 'hold' holds the arm at the target, and hold_steps {s['hold_steps']} asks the policy to do so:"
            " set at_goal to 'continue', or hold_steps to 0."
        )
    return None


def _held_too_long(s: Asked) -> str | None:
    if s["hold_steps"] > s["max_steps"]:
        return (
            f"the tool cannot be held for hold_steps {s['hold_steps']} in an episode of max_steps {s['max_steps']}:"
            " choose fewer --hold-steps or more --max-steps."
        )
    return None


def _crossed_box(s: Asked) -> str | None:
    if s["targets"] != "box" or s["target_low"] is None or s["target_high"] is None:
        return None
    for axis, low, high in zip("xyz", s["target_low"], s["target_high"], strict=True):
        if low > high:
            return f"target_low is above target_high in {axis}, {low:g} against {high:g} m: exchange them."
    return None


def _minibatches(s: Asked) -> str | None:
    if s["num_envs"] % s["minibatches"]:
        return f"num_envs {s['num_envs']} cannot be divided among {s['minibatches']} minibatches: choose a divisor."
    return None


def _randomised(s: Asked) -> str | None:
    for name in s["randomise"]:
        choose("randomise", name, RANDOMISED)
    if "view" in s["randomise"] and not s.facts.pictures:
        return (
            f"randomise view has an effect only with an observation with a picture, as image: {s['observation']!r}"
            " holds none."
        )
    return None


def _action_held_too_long(s: Asked) -> str | None:
    if "action_repeat" in s.changed and s["action_repeat"] > s["max_steps"]:
        return (
            f"an action cannot be held for action_repeat {s['action_repeat']} in an episode of max_steps"
            f" {s['max_steps']}: choose a lower --action-repeat or more --max-steps."
        )
    return None


CONTRADICTIONS: tuple[Callable[[Asked], str | None], ...] = (
    *(
        _moves,
        _obstructed,
        _at_goal,
        _orientation,
        _held_too_long,
        _crossed_box,
        _minibatches,
        _randomised,
        _action_held_too_long,
    ),
)
"""What cannot be: each gives its sentence, or nothing."""


def _same_arms(s: Asked) -> str | None:
    if "randomise" in s.changed and "dynamics" in s["randomise"] and not s.facts.dynamics:
        return (
            f"randomise dynamics adds noise to what is measured and nothing else in simulator {s['sim']!r}: arms"
            " differ with --sim mujoco."
        )
    return None


def _annealed_too_late(s: Asked) -> str | None:
    if "anneal_steps" in s.changed and s["anneal_steps"] > s["total_steps"]:
        return (
            f"training ends after total_steps {s['total_steps']:,}, before the learning rate has fallen to its end"
            f" after anneal_steps {s['anneal_steps']:,}."
        )
    return None


CONSEQUENCES: tuple[Callable[[Asked], str | None], ...] = (_same_arms, _annealed_too_late)
"""What is said of changed settings that have another effect than one may expect."""


def check_consistency(config: RunConfig, facts: Facts, base: RunConfig | None = None) -> None:
    """Make sure that settings make sense together, and say what follows from those changed from `base`.

    Args:
        config: the settings.
        facts: of the names in them.
        base: what they are changed from; without it their preset.

    Raises:
        InputError: settings that contradict each other, or one without effect.
    """
    settings, usual = (flatten(to_json(one)) for one in (config, base or preset_of(config)))
    changed = {name for name, value in settings.items() if usual.get(name, value) != value}
    asked = Asked(settings, changed, facts)
    for contradiction in CONTRADICTIONS:
        if sentence := contradiction(asked):
            raise InputError(sentence)
    for name in sorted(NEEDS.keys() & changed):
        if not NEEDS[name].met(asked):
            sentence = f"{name} has an effect only with {NEEDS[name].words}: leave it out, or choose that."
            if NEEDS[name].vital:
                raise InputError(sentence)
            log.warning("reachlab: %s", sentence)
    for consequence in CONSEQUENCES:
        if sentence := consequence(asked):
            log.warning("reachlab: %s", sentence)
