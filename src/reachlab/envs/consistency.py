"""Which settings make sense together: what cannot be is refused before any time is spent.

What is changed from its preset and has no effect is refused; what has another effect than one may expect is said.
Presets and defaults trouble nobody.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping

from reachlab.envs.presets import preset_of
from reachlab.envs.uses import MILD, unused, users
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError, choose
from reachlab.sims import SIMULATORS
from reachlab.tasks import TASKS, WORDS
from reachlab.tasks.actions import ACTIONS
from reachlab.tasks.handling import HANDS, SHAPES
from reachlab.tasks.observations import OBSERVATIONS, design_of
from reachlab.tasks.paths import PATHS
from reachlab.tasks.rewards import REWARDS
from reachlab.tasks.targets import TARGETS
from reachlab.tasks.tutorial import AT_GOAL

NAMES: dict[str, tuple[str, Mapping[str, object]]] = {
    "task": ("task", TASKS),
    "sim": ("simulator", SIMULATORS),
    "observation": ("observation", OBSERVATIONS),
    "action": ("action", ACTIONS),
    "reward": ("reward", REWARDS),
    "targets": ("targets", TARGETS),
    "at_goal": ("at_goal", AT_GOAL),
    "goal_paths": ("goal path", PATHS),
    "object_shape": ("object_shape", SHAPES),
    "gripper": ("gripper", HANDS),
}
"""Settings that are names of tables, or lists of them, and what they are called."""

LONGEST = 0.005
"""Longest step of the engine with which objects neither sink into what they lie on nor slip out of hands [s]."""

RANDOMISED = ("dynamics", "delay", "lag", "view", "objects", "sight")
"""Parts that can vary from episode to episode; see `RunConfig.randomise`."""

log = logging.getLogger(__name__)


def check_names(config: RunConfig) -> None:
    """Make sure that what a configuration names is there.

    Raises:
        InputError: it is not; the sentence lists the names and the nearest one.
    """
    settings = flatten(to_json(config))
    for setting, (kind, table) in NAMES.items():
        chosen = settings.get(setting, ())
        for name in (chosen,) if isinstance(chosen, str) else chosen or ():
            choose(kind, name, table)


def check_env(config: RunConfig) -> None:
    """Make sure that there are environments with these settings.

    Raises:
        InputError: no settings, a name that does not exist, or settings that contradict each other.
    """
    if not isinstance(config, RunConfig):
        raise InputError(f"settings are needed, as reachlab.configure('tutorial') gives, got {config!r}.")
    check_names(config)
    for sentence in _impossible(config):
        raise InputError(sentence)


def _impossible(config: RunConfig) -> Iterator[str]:
    """Sentences on settings with which there is no environment."""
    rules, sim = config.rules, config.sim
    if not isinstance(rules, kind := TASKS[config.task].load()):
        yield f"rules of {config.task!r} are a {kind.__name__}, got {type(rules).__name__}: begin with `configure`."
    observation, task = design_of(rules), rules.task()
    if sentence := rules.contradiction():
        yield sentence
    action = ACTIONS[rules.action]
    given = rules.gives | SIMULATORS[sim].gives | action.gives | observation.gives
    asked = frozenset({"wrench"} if rules.wrench else ())
    needs = {
        "setting wrench": asked,
        f"observation {rules.observation!r}": observation.needs - asked,
        f"task {config.task!r}": task.needs,
        f"action {rules.action!r}": action.needs,
    }
    for who, words in needs.items():
        for word in sorted(words - given):
            yield f"{who} needs {WORDS.get(word, f'{word!r}, which nothing gives')}."
    for name in config.randomise:
        choose("randomise", name, RANDOMISED)
    if "lag" in config.randomise and "dynamics" not in SIMULATORS[sim].gives:
        yield (
            f"randomise lag needs arms that differ, as in simulator mujoco: in {sim!r} all follow alike; name the"
            " others that vary, if any."
        )
    step, period = config.physics.control_period / config.physics.physics_steps, config.physics.control_period
    if "object" in rules.gives and "physics_steps" in SIMULATORS[sim].settings and step > LONGEST * (1 + 1e-6):
        yield (
            f"steps of the engine of {1000 * step:.3g} ms are too long for objects: with control_period {period:g},"
            f" physics_steps must be at least {math.ceil(period / LONGEST - 1e-6)}."
        )
    if "object" not in rules.gives and (of_objects := {"objects", "sight"}.intersection(config.randomise)):
        yield f"randomise {min(of_objects)} needs an object, as in task push, and {config.task!r} has none."


def _contradictions(config: RunConfig, changed: set[str]) -> Iterator[str]:
    """Sentences on settings that cannot be together in a training."""
    rules, loop = config.rules, config.loop
    if "view" in config.randomise and not design_of(rules).pictured:
        yield (
            "randomise view has an effect only with an observation with a picture, as image:"
            f" {rules.observation!r} holds none."
        )
    if loop.chained_starts and {"bodies", "object"} & rules.gives:
        yield (
            f"with chained_starts {loop.chained_starts:g} episodes would start inside bodies, which leave only a start"
            " near home free: leave it out."
        )
    if "collisions" in changed and config.physics.collisions and {"bodies", "object"} & rules.gives:
        yield "collisions has no effect beside other bodies, whose contacts are judged anyway: leave it out."
    if (ACTIONS[rules.action].method or config.method) == "ppo" and loop.num_envs % config.ppo.minibatches:
        yield (
            f"num_envs {loop.num_envs} cannot be divided among {config.ppo.minibatches} minibatches: choose a divisor."
        )
    if "hidden" in changed and not config.learner.hidden:
        yield "hidden needs a layer at least, as --hidden 64: without one a policy is linear, and learns little."
    if "initial_std" in changed and config.learner.initial_policy and config.ppo.final_std is None:
        yield "initial_std has no effect with initial_policy, which has the noise that it learnt: leave it out."
    yield from _remembered_otherwise(config)
    if "action_repeat" in changed and loop.action_repeat > rules.max_steps:
        yield (
            f"an action cannot be held for action_repeat {loop.action_repeat} in an episode of max_steps"
            f" {rules.max_steps}: choose a lower --action-repeat or more --max-steps."
        )


def _remembered_otherwise(config: RunConfig) -> Iterator[str]:
    """A sentence where a policy would remember other steps in training than when it acts."""
    repeat = config.loop.action_repeat
    if config.learner.memory and repeat > 1:
        fewer = f" --updates {max(48 // repeat, 1)} --guided {8 * repeat}" if config.method == "dagger" else ""
        yield (
            f"with action_repeat {repeat} a policy would remember one step in {repeat} in training, and every step when"
            f" it acts: choose --action-repeat 1{fewer}."
        )


def _consequences(config: RunConfig, changed: set[str]) -> Iterator[str]:
    """Sentences on changed settings that have another effect than one may expect."""
    if "randomise" in changed and "dynamics" in config.randomise and "dynamics" not in SIMULATORS[config.sim].gives:
        yield (
            f"randomise dynamics adds noise to what is measured and nothing else in simulator {config.sim!r}: arms"
            " differ with --sim mujoco."
        )
    if "anneal_steps" in changed and config.learner.anneal_steps > config.loop.total_steps:
        yield (
            f"training ends after total_steps {config.loop.total_steps:,}, before the learning rate has fallen to its"
            f" end after anneal_steps {config.learner.anneal_steps:,}."
        )


def check(config: RunConfig, base: RunConfig | None = None) -> None:
    """Make sure that settings make sense together, and say what follows from those changed from `base`.

    Args:
        config: the settings.
        base: what they are changed from; without it their preset.

    Raises:
        InputError: no settings, a name that does not exist, settings that contradict each other, or one without effect.
    """
    check_env(config)
    settings, usual = (flatten(to_json(one)) for one in (config, base or preset_of(config)))
    changed = {name for name, value in settings.items() if usual.get(name, value) != value}
    for sentence in _contradictions(config, changed):
        raise InputError(sentence)
    for name, choice in sorted(unused(settings).items()):
        if name not in changed:
            continue
        sentence = f"{name} has an effect only with {users(name, choice)}"
        if choice not in MILD:
            raise InputError(f"{sentence}: leave it out, or choose that.")
        log.warning("reachlab: %s, and has none here.", sentence)
    for sentence in _consequences(config, changed):
        log.warning("reachlab: %s", sentence)
