"""The study of a sweep: Optuna suggests settings and judges trials; all it knows is in the sweep's folder."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from reachlab.scale.goals import Goal
from reachlab.scale.space import Dimension, label, size
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError, needing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAME = "sweep"
"""The study's name in its journal."""

UNPRUNED = 5
"""Trials that are not pruned, for those after them to be compared with."""

GUESSED = 10
"""Trials whose settings are drawn at random, until enough is known to suggest better ones."""

MOST_LISTED = 1000
"""Settings of which a list is made though they are not all tried."""

WHY = "why"
"""Attribute of a failed trial: a sentence."""

PLOTS = {
    "history": "plot_optimization_history",
    "importances": "plot_param_importances",
    "parallel": "plot_parallel_coordinate",
    "validations": "plot_intermediate_values",
}
"""Pictures, by the name of their file, and Optuna's function that draws each."""

NAMED = ("history", "parallel")
"""Those on which Optuna writes what the goal is called."""

SIZE, DPI = (8.0, 5.0), 120
"""Of a picture [inches], and its points an inch."""


class Trial(NamedTuple):
    """A setting that was or is tried.

    Attributes:
        number: in order, from 0.
        settings: those that vary.
        state: "complete", "pruned", "fail" or "running".
        value: of the goal; None before it is complete, or if it was not reached.
        why: what failed.
    """

    number: int
    settings: dict[str, Any]
    state: str
    value: float | None
    why: str


class Study:
    """Suggestions and values, written to a journal at once."""

    def __init__(self, journal: Path, space: list[Dimension], goal: Goal, config: RunConfig) -> None:
        """Study of a journal, or a new one, whose first trial is `config` itself where the space holds it.

        Raises:
            InputError: Optuna is not installed, the journal cannot be used, or it is of another space or goal.
        """
        self._optuna = load_optuna()
        self._space, self._seed = space, config.seed
        new = not journal.exists()
        if not new:
            _mend(journal)
        backend = self._optuna.storages.journal.JournalFileBackend(str(journal))
        try:
            self._study = self._optuna.create_study(
                storage=self._optuna.storages.JournalStorage(backend),
                study_name=NAME,
                direction="maximize" if goal.maximise else "minimize",
                pruner=self._optuna.pruners.MedianPruner(n_startup_trials=UNPRUNED),
                load_if_exists=True,
            )
        except (OSError, ValueError, KeyError, TypeError, AssertionError) as error:
            raise InputError(f"study '{journal}' cannot be used ({error}): begin a new sweep.") from None
        known = self._study.user_attrs
        for name, asked in (("goal", ".".join(goal.path)), ("space", json.dumps(space))):
            if name not in known:
                self._study.set_user_attr(name, asked)
            elif known[name] != asked:
                raise InputError(f"study '{journal}' was begun with another {name}, {known[name]}: begin a new sweep.")
        if new and (own := self._within(config)):
            self._study.enqueue_trial(own)

    def _suggest(self, trial: Any) -> Any:
        for one in self._space:
            if one.choices:
                trial.suggest_categorical(one.name, [label(choice) for choice in one.choices])
            elif one.whole:
                trial.suggest_int(one.name, int(one.low), int(one.high), log=one.log)
            else:
                trial.suggest_float(one.name, float(one.low), float(one.high), log=one.log)
        return trial

    def _within(self, config: RunConfig) -> dict[str, Any] | None:
        """The configuration's own settings as the study writes them down; None if one is not in the space."""
        now, own = flatten(to_json(config)), {}
        for one in self._space:
            value = now[one.name]
            if one.choices and value in one.choices:
                own[one.name] = label(value)
            elif not one.choices and value is not None and one.low <= value <= one.high:
                own[one.name] = value
            else:
                return None
        return own

    # --- trials -----------------------------------------------------------------------------------

    def wants(self, total: int) -> bool:
        """Whether there is one trial more: fewer were begun than there may be, and some settings are untried."""
        tried = {label(sorted(one.settings.items())) for one in self.trials}
        return len(self.trials) < total and len(tried) < size(self._space)

    def ask(self, total: int) -> Any:
        """A new trial, as Optuna has it, of `total`.

        What is suggested depends on the sweep's seed, the number, and what is known of the trials before. Where all
        settings can be tried, each of them is, once; where they are few, none of the first is suggested twice.
        """
        number, settings = len(self._study.get_trials(deepcopy=False)), size(self._space)
        self._seed_sampler(number)
        usual = self._study.sampler
        if settings <= (max(total, MOST_LISTED) if number < GUESSED else total):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that it is experimental
                self._study.sampler = self._optuna.samplers.BruteForceSampler(seed=self._seed_of(number))
        trial = self._suggest(self._study.ask())
        self._study.sampler = usual  # the other one would end the study itself
        return trial

    def begun(self) -> list[Any]:
        """The trials that an earlier process began and did not end."""
        running = self._optuna.trial.TrialState.RUNNING
        found = []
        for frozen in self._study.get_trials(deepcopy=False, states=(running,)):
            self._seed_sampler(frozen.number)
            # What is suggested already stays; its process may have died before all was.
            found.append(self._suggest(self._optuna.trial.Trial(self._study, frozen._trial_id)))
        return found

    def _seed_sampler(self, number: int) -> None:
        self._study.sampler = self._optuna.samplers.TPESampler(n_startup_trials=GUESSED, seed=self._seed_of(number))

    def _seed_of(self, number: int) -> int:
        return (self._seed * 1_000_003 + number) % 2**32

    def settings(self, trial: Any) -> dict[str, Any]:
        """Settings of a trial that vary."""
        named = {one.name: {label(choice): choice for choice in one.choices} for one in self._space}
        return {name: named[name].get(value, value) for name, value in trial.params.items()}

    def is_poor(self, trial: Any, validations: Mapping[int, float]) -> bool:
        """Whether a new validation of a trial, by its number, is poorer than half of the others; all are noted."""
        known = self._study.get_trials(deepcopy=False)[trial.number].intermediate_values
        for number in sorted(validations.keys() - known.keys()):
            trial.report(validations[number], number)
            if trial.should_prune():
                return True
        return False

    def end(self, trial: Any, value: float | None = None, why: str = "") -> None:
        """End a trial with its value; one without is not worth more time, or has failed for a reason."""
        states = self._optuna.trial.TrialState
        if why:
            trial.set_user_attr(WHY, why)
        self._study.tell(trial, value, None if value is not None else states.FAIL if why else states.PRUNED)

    # --- what came of it --------------------------------------------------------------------------

    @property
    def trials(self) -> list[Trial]:
        """All trials so far, without those that wait to be suggested."""
        waiting = self._optuna.trial.TrialState.WAITING
        return [
            Trial(
                number=one.number,
                settings=self.settings(one),
                state=one.state.name.lower(),
                value=one.value if one.state.name == "COMPLETE" and math.isfinite(one.value) else None,
                why=one.user_attrs.get(WHY, ""),
            )
            for one in self._study.get_trials(deepcopy=False)
            if one.state != waiting
        ]

    @property
    def ranked(self) -> list[Trial]:
        """The trials that came to a value, the best one first; of those that are equal, the first."""
        sign = -1 if self._study.direction.name == "MAXIMIZE" else 1
        return sorted((one for one in self.trials if one.value is not None), key=lambda one: sign * (one.value or 0.0))

    def draw(self, folder: Path, goal: str) -> list[Path]:
        """Draw Optuna's pictures of the study; those that it has too few trials for are left out."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from optuna.visualization import matplotlib as drawn

        files = []
        for name, function in PLOTS.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that these are experimental
                try:
                    axes = vars(drawn)[function](self._study, **({"target_name": goal} if name in NAMED else {}))
                except (ValueError, RuntimeError):
                    continue
            figure = next(iter(getattr(axes, "flat", [axes]))).figure
            figure.set_size_inches(*SIZE)
            _make_readable(figure)
            FigureCanvasAgg(figure)
            files.append(folder / f"{name}.png")
            figure.savefig(files[-1], dpi=DPI, bbox_inches="tight")
        return files


def _make_readable(figure: Figure) -> None:
    """Lines on white instead of a grid on grey, and numbers on white where lines cross them."""
    for axes in figure.axes:
        axes.set_facecolor("white")
        axes.grid(visible=False)
        axes.spines[["left", "right"]].set_color("0.6")
        for words in axes.get_yticklabels():
            words.set_bbox({"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1})


def load_optuna() -> Any:
    """The module `optuna`.

    Raises:
        InputError: it is not installed.
    """
    with needing("sweep needs Optuna: {}.", "sweep"):
        import optuna
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


def _mend(journal: Path) -> None:
    """Cut off a last line that was not written to its end."""
    said = journal.read_bytes()
    if not said.endswith(b"\n"):
        with journal.open("r+b") as file:
            file.truncate(said.rfind(b"\n") + 1)
