"""The verb `eval`."""

from __future__ import annotations

import json as jsonlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from reachlab.cli.flags import Eval
from reachlab.cli.preparation import prepare
from reachlab.settings.config import RunConfig
from reachlab.settings.names import AGENTS
from reachlab.settings.validation import InputError, choose

if TYPE_CHECKING:
    from reachlab.cli.displays import EvalDisplay
    from reachlab.learn.train import Saved
    from reachlab.runs.directory import RunDirectory

EVALUATION_NUM_ENVS = {"pybullet": 8}
"""Environments of an evaluation where fewer of them are faster."""


def evaluate(arguments: Eval) -> None:
    """Run `reachlab eval`.

    With several simulators, the results of the others are shown where one fails.

    Raises:
        InputError: a flag that does not fit, or a simulator that cannot be used: after the results of the others.
    """
    for agent in arguments.agent:
        choose("agent", agent, AGENTS)
    prepare()
    from reachlab.cli.console import note
    from reachlab.cli.displays import EvalDisplay
    from reachlab.runs.directory import RunDirectory
    from reachlab.sims import SIMULATORS

    run = RunDirectory(arguments.run)
    trained, several = run.read_config(), arguments.sim == "all"
    names = list(SIMULATORS) if several else [arguments.sim or trained.sim]
    configs = {name: _evaluated_config(arguments, trained, name) for name in names}
    reports: list[dict[str, Any]] = []
    failed: list[str] = []
    unsaved: list[str] = []
    loaded: list[Saved] = []
    try:
        with EvalDisplay(arguments.episodes) as display:
            if several:  # found before minutes are spent on the others
                failed += [name for name, config in configs.items() if not _can_be_used(config)]
            for name in names:
                if name in failed:
                    continue
                try:
                    for report, warning in _evaluated(arguments, run, configs[name], loaded, display):
                        reports.append(report)
                        unsaved += warning
                except (InputError, FloatingPointError) as error:
                    if not several:
                        raise
                    note(f"{name}: {error}")
                    failed.append(name)
    finally:  # the reports that there are, whatever ended the evaluation
        _show_evaluation(reports, trained, as_list=len(names) * len(arguments.agent) > 1, json=arguments.json)
    for warning in unsaved:
        note(f"Warning: {warning}")
    if failed:
        raise InputError(f"no result in {', '.join(failed)}: the reason is above.")


def _evaluated_config(arguments: Eval, trained: RunConfig, name: str) -> RunConfig:
    """Settings of an evaluation in a simulator.

    Raises:
        InputError: there is no such simulator, or a flag does not apply to it.
    """
    from reachlab.envs.settle import in_evaluation

    physics = {"gui": arguments.gui, "slow": arguments.slow, "perturb": arguments.perturb}
    return in_evaluation(trained, name, **physics, randomise_view=arguments.perturb_view)


def _can_be_used(config: RunConfig) -> bool:
    """Whether the simulator of a configuration can be used here; if it cannot, the reason has been printed."""
    from reachlab.cli.console import note
    from reachlab.envs.core import Env

    try:
        Env(config, 1).close()
    except InputError as error:
        note(f"{config.sim}: {error}")
        return False
    return True


def _evaluated(
    arguments: Eval, run: RunDirectory, config: RunConfig, loaded: list[Saved], display: EvalDisplay
) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """Report of each agent in one simulator, and where it could not be saved a list with the reason.

    What is already `loaded` is used again: all simulators get the same checkpoint, even where a training writes newer
    ones meanwhile.
    """
    from reachlab.envs.core import Env
    from reachlab.evaluation.report import LANES, examine
    from reachlab.learn.train import load_saved

    name = config.sim
    env = Env(config, 1 if arguments.gui else min(arguments.episodes, EVALUATION_NUM_ENVS.get(name, LANES)))
    try:
        if not loaded:
            loaded.append(load_saved(run, config, env))
        policy, checkpoint = loaded[0].policy, loaded[0].checkpoint
        for agent in arguments.agent:
            display.begin(agent, name)
            seed, episodes = arguments.seed, arguments.episodes
            result, played = examine(
                env, agent, policy, seed=seed, episodes=episodes, watch=display, checkpoint=checkpoint
            )
            report = result.to_json()
            rows = {"target": played.target, "distance": played.distance, "success": played.success}
            kind = "-perturbed" * arguments.perturb + "-views" * arguments.perturb_view
            try:
                run.write_report(f"{name}-{agent}-{seed}{kind}", report, rows)
            except InputError as error:
                yield report, [str(error)]
            else:
                yield report, []
    finally:
        env.close()


def _show_evaluation(reports: list[dict[str, Any]], config: RunConfig, *, as_list: bool, json: bool) -> None:
    """Print the reports, if there are any: as JSON a single report, or a list of them."""
    from reachlab.cli.console import print_reports

    if reports and json:
        print(jsonlib.dumps(reports if as_list else reports[0]))
    elif reports:
        print_reports(reports, config)
