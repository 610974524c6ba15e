"""Figures of a training's result that a sweep can seek."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from reachlab.evaluation.report import QUANTILES, WITHIN, WITHIN_PAIRS
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError, choose


@dataclass(frozen=True)
class Goal:
    """A figure of a result, by the names that lead to it.

    Attributes:
        path: names in the result's plain form, see `TrainResult.to_json`.
        maximise: the more the better.
        needs: what a training has to be for its result to have the figure: in words, and as a question.
    """

    path: tuple[str, ...]
    maximise: bool = False
    needs: tuple[str, Callable[[RunConfig], bool]] = ("", lambda _: True)

    @property
    def worst(self) -> float:
        """The value of a training that has none, as of a held error where nothing was held."""
        return -math.inf if self.maximise else math.inf

    def of(self, result: Mapping[str, Any]) -> float | None:
        """The figure in a result or report; None if it is not one of a report, as how long the training took."""
        if self.path[0] not in result:
            return None
        # A training whose validations never sufficed would have gone on: how long is not known.
        if self.path[0] in TRAINING and result["validated"] is not True:
            return self.worst
        value: Any = result
        for name in self.path:
            value = value[name] if value is not None else None
        return self.worst if value is None else float(value)


TRAINING = ("steps", "train_wall_s")
"""Figures of the training, not of its report."""

HELD = ("a task that does not end at the target: set --at-goal continue", lambda config: not config.rules.ends_at_goal)
TURNED = ("a goal with an orientation, as of task pose", lambda config: config.rules.asks_orientation)
MOVES = ("a goal that moves, as of task track", lambda config: config.task == "track")
STOPS = ("a training that ends once its validations suffice: set --stop-early", lambda config: config.loop.stop_early)


GOALS = {
    "success_rate": Goal(("success_rate",), maximise=True),
    "return_mean": Goal(("return_mean",), maximise=True),
    "time_to_reach_s": Goal(("time_to_reach_s",)),
    "jerk": Goal(("jerk",)),
    **{name: Goal((name,), needs=STOPS) for name in TRAINING},
    **{f"success_within.{mm}": Goal(("success_within", str(mm)), maximise=True, needs=HELD) for mm in WITHIN},
    **{
        f"success_within_pairs.{mm}": Goal(("success_within_pairs", f"{mm} mm, {rad} rad"), maximise=True, needs=TURNED)
        for mm, rad in WITHIN_PAIRS
    },
    **{f"final_error_mm.{name}": Goal(("final_error_mm", name)) for name in QUANTILES},
    **{f"final_angle_rad.{name}": Goal(("final_angle_rad", name), needs=TURNED) for name in QUANTILES},
    **{f"tracking.{name}": Goal(("tracking", name), needs=MOVES) for name in ("rms_mm", "median_mm", "p95_mm")},
}
"""Goals by name."""


def check_goal(name: str, config: RunConfig) -> Goal:
    """The goal of that name.

    Raises:
        InputError: there is none, or trainings with these settings do not have it.
    """
    goal = GOALS[choose("goal", name, GOALS)]
    words, met = goal.needs
    if not met(config):
        raise InputError(f"goal {name!r} needs {words}.")
    return goal
