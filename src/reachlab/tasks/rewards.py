"""Rewards: named terms whose sum is the reward of a step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from jax import Array

from reachlab.settings.tables import Table
from reachlab.settings.validation import InputError
from reachlab.tasks.answers import answer, form
from reachlab.tasks.judging import Outcome

OUTSIDE_REWARD = -0.1
"""Reward of leaving the workspace (the tutorial's)."""

TIMEOUT_REWARD = -0.1
"""Reward of running out of time (the tutorial's)."""

SUCCESS_REWARD = 1.0
"""Reward of reaching the target (the tutorial's)."""


GOAL_REWARDS: dict[str, Callable[[Any, Any], Any]] = {
    "goal": lambda near, _gap: -1.0 * ~near,
    "goal_distance": lambda _near, gap: -gap,
}
"""Rewards that follow from tool and goal alone, of `near` and `gap [...]` of a task's errors, in NumPy and JAX."""


def _goal(_config: Any, outcome: Outcome) -> dict[str, Array]:
    """-1 for every step that does not end at the goal: FetchReach's and panda-gym's, for hindsight replay."""
    return {"goal": GOAL_REWARDS["goal"](outcome.near, outcome.gap)}


def _goal_distance(_config: Any, outcome: Outcome) -> dict[str, Array]:
    """-1 for every metre between tool and target: their dense reward."""
    return {"goal_distance": GOAL_REWARDS["goal_distance"](outcome.near, outcome.gap)}


def _sparse(_config: Any, outcome: Outcome) -> dict[str, Array]:
    """1 for reaching the target, -0.1 for leaving the workspace or running out of time: the tutorial's.

    Where the episode continues at the target, losing it costs 1 again: a difference of potentials, so that coming and
    going pays nothing (Ng, Harada and Russell, "Policy invariance under reward transformations", ICML 1999).
    """
    return {
        "reach": SUCCESS_REWARD * outcome.gained,
        "outside": OUTSIDE_REWARD * outcome.outside,
        "timeout": TIMEOUT_REWARD * (outcome.timeout & ~outcome.success),
    }


def _dense(config: Any, outcome: Outcome) -> dict[str, Array]:
    """As sparse, and for every metre that the tool comes closer."""
    approach = config.approach_weight * (outcome.gap_before - outcome.gap)
    return {**_sparse(config, outcome), "approach": approach}


def _precise(config: Any, outcome: Outcome) -> dict[str, Array]:
    """For coming closer, for being within millimetres, for being still there, and against effort."""
    close = config.closeness_scale / (config.closeness_scale + outcome.gap)
    still = config.hold_speed / (config.hold_speed + outcome.speed)
    return {
        "approach": config.approach_weight * (outcome.gap_before - outcome.gap),
        "closeness": config.closeness_weight * close,
        "stillness": config.closeness_weight * close * still,
        "effort": -config.effort_weight * outcome.effort,
    }


def _closeness(config: Any, outcome: Outcome) -> dict[str, Array]:
    """For being within millimetres, and against effort."""
    close = config.closeness_scale / (config.closeness_scale + outcome.gap)
    return {"closeness": config.closeness_weight * close, "effort": -config.effort_weight * outcome.effort}


REWARDS: dict[str, Callable[[Any, Outcome], dict[str, Array]]] = Table(
    {
        "sparse": _sparse,
        "dense": _dense,
        "precise": _precise,
        "closeness": _closeness,
        "goal": _goal,
        "goal_distance": _goal_distance,
    }
)
"""Rewards by name; each gives named terms `[B]` whose sum is the reward."""


def reward_terms(rules: Any, outcome: Outcome) -> dict[str, Array]:
    """The terms `[B]` of a step's reward by name.

    Raises:
        InputError: a reward that was added fails, or gives something else.
    """
    terms = answer(f"reward {rules.reward!r}", REWARDS[rules.reward], rules, outcome)
    if not isinstance(terms, Mapping):
        raise InputError(
            f"reward {rules.reward!r} gives {type(terms).__name__}: it has to give terms by name, as"
            ' {"near": -outcome.gap}.'
        )
    for name, term in terms.items():
        if name == "success":
            raise InputError(
                f"reward {rules.reward!r} has a term 'success', which is the verdict's name: call it another."
            )
        needed = form(outcome.gap)
        if not isinstance(name, str) or form(term).replace("bool", "float").replace("int", "float") != needed:
            raise InputError(
                f"reward {rules.reward!r} gives term {name!r} as {form(term)}: a name and one number an environment are"
                f" needed, {needed}."
            )
    return dict(terms)
