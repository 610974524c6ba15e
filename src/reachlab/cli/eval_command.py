"""The verb `eval`."""

from __future__ import annotations

import json as jsonlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from reachlab.agents import AGENTS
from reachlab.cli.eval_subjects import Subject, find_subjects
from reachlab.cli.flags import Eval
from reachlab.cli.preparation import prepare
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError, choose

if TYPE_CHECKING:
    from reachlab.cli.progress import EvalDisplay


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
    from reachlab.cli.progress import EvalDisplay
    from reachlab.sims import SIMULATORS

    subjects = find_subjects(arguments)
    trained, several = subjects[0].config, arguments.sim == "all"
    names = list(SIMULATORS) if several else [arguments.sim or trained.sim]
    configs = {name: [_evaluated_config(arguments, one.config, name) for one in subjects] for name in names}
    reports: list[dict[str, Any]] = []
    failed: list[str] = []
    unsaved: list[str] = []
    try:
        with EvalDisplay(arguments.episodes) as display:
            if several:  # found before minutes are spent on the others
                failed += [name for name, (config, *_) in configs.items() if not _can_be_used(config)]
            for name in names:
                if name in failed:
                    continue
                try:
                    for report, warning in _in_simulator(arguments, subjects, configs[name], display):
                        reports.append(report)
                        unsaved += warning
                except (InputError, FloatingPointError) as error:
                    if not several:
                        raise
                    note(f"{name}: {error}")
                    failed.append(name)
    finally:  # the reports that there are, whatever ended the evaluation
        several_rows = len(names) * len(arguments.agent) * len(subjects) > 1
        _show_evaluation(reports, subjects, configs[names[0]][0], as_list=several_rows, json=arguments.json)
    for warning in unsaved:
        note(f"Warning: {warning}")
    if failed:
        raise InputError(f"no result in {', '.join(failed)}: the reason is above.")


def _evaluated_config(arguments: Eval, trained: RunConfig, name: str) -> RunConfig:
    """Settings of an evaluation in a simulator.

    Raises:
        InputError: there is no such simulator, or a flag does not apply to it.
    """
    from reachlab.envs.setup import in_evaluation

    pybullet = {"gui": arguments.gui, "slow": arguments.slow}
    return in_evaluation(trained, name, **pybullet, randomise=arguments.randomise, **_other_goals(arguments))


def _other_goals(arguments: Eval) -> dict[str, Any]:
    """Settings of the goals that the flags change."""
    return {name: value for name, value in vars(arguments.goals).items() if value is not None}


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


def _in_simulator(
    arguments: Eval, subjects: Sequence[Subject], configs: Sequence[RunConfig], display: EvalDisplay
) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """What `_evaluated` gives for each subject, with its name where there are several; the first has the baselines."""
    agents = arguments.agent
    for subject, config in zip(subjects, configs, strict=True):
        for report, warning in _evaluated(arguments, subject, config, agents, display):
            told = {"run": subject.name if AGENTS[report["agent"]].trained else ""} if len(subjects) > 1 else {}
            yield told | report, warning
        agents = tuple(agent for agent in agents if AGENTS[agent].trained)


def _evaluated(
    arguments: Eval, subject: Subject, config: RunConfig, agents: Sequence[str], display: EvalDisplay
) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """Report of each agent in one simulator, and where it could not be saved in the run a list with the reason.

    Agent `trained` is the policy of a run, or a model, whose reports are not saved; nor are those of a policy that
    comes with reachlab, or on other goals than the run's, which would stand in for those on its own.
    """
    from reachlab.envs.core import Env
    from reachlab.evaluation.episodes import BATCH
    from reachlab.evaluation.report import examine
    from reachlab.learn.load import load_saved
    from reachlab.runs.shipped import is_shipped
    from reachlab.sims import SIMULATORS

    name, episodes, run, model = config.sim, arguments.episodes, subject.run, subject.model
    env = Env(config, 1 if arguments.gui else min(episodes, SIMULATORS[name].most_envs or BATCH))
    try:
        if model:
            model.check(env.schema)
        if run and not subject.saved:
            subject.saved = load_saved(run, env)
        policy, checkpoint = (subject.saved.policy, subject.saved.checkpoint) if subject.saved else (None, None)
        checkpoint = model.checkpoint if model else checkpoint
        for agent in agents:
            display.begin(agent, name)
            acting = model.act if model and AGENTS[agent].trained else agent
            result, played = examine(
                env, acting, policy, seed=arguments.seed, episodes=episodes, watch=display, checkpoint=checkpoint
            )
            report = result.to_json()
            rows = {"goal": played.goal, "distance": played.distance, "success": played.success}
            title = "-".join((name, agent, str(arguments.seed), *arguments.randomise))
            try:
                if run and not is_shipped(run) and not _other_goals(arguments):
                    run.write_report(title, report, rows)
            except InputError as error:
                yield report, [str(error)]
            else:
                yield report, []
    finally:
        env.close()


def _show_evaluation(
    reports: list[dict[str, Any]], subjects: Sequence[Subject], config: RunConfig, *, as_list: bool, json: bool
) -> None:
    """Print the reports, if there are any: as JSON a single report, or a list of them."""
    from reachlab.cli.console import note, print_reports

    means = _means(reports, subjects)
    if reports and json:
        print(jsonlib.dumps([*reports, *means] if as_list else reports[0]))
    elif reports:
        print_reports([*reports, *means], config)
        if means:
            note("Means are over trainings; their intervals are Student's, and a dash where all trainings are equal.")


def _means(reports: Sequence[dict[str, Any]], subjects: Sequence[Subject]) -> list[dict[str, Any]]:
    """Means over the runs that differ by their seeds alone, in each simulator."""
    from reachlab.evaluation.intervals import mean_report

    groups: dict[str, dict[int, str]] = {}
    for subject in subjects:
        same = flatten(to_json(subject.config)) | {"seed": 0}
        groups.setdefault(jsonlib.dumps(same), {}).setdefault(subject.config.seed, subject.name)
    made = []
    for names in groups.values():
        parts = [report for report in reports if report.get("run") in names.values()]
        for sim in dict.fromkeys(report["sim"] for report in parts):
            own = [report for report in parts if report["sim"] == sim]
            if len(own) > 1:
                made.append(mean_report(own) | {"run": f"mean of {len(own)} seeds"})
    return made
