"""The verb `eval`."""

from __future__ import annotations

import contextlib
import itertools
import json as jsonlib
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from reachlab.agents import AGENTS
from reachlab.cli.eval_subjects import Subject, find_subjects, other_goals
from reachlab.cli.flags import Eval
from reachlab.cli.preparation import prepare
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError, choose

if TYPE_CHECKING:
    from reachlab.cli.progress import Bar

ELSEWHERE = 0.9
"""Success in another simulator than that of training below which is said why that may be."""


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
    from reachlab.cli.progress import Bar
    from reachlab.envs.core import Env
    from reachlab.envs.setup import in_evaluation
    from reachlab.sims import SIMULATORS

    subjects = find_subjects(arguments, arguments.agent)
    several = arguments.sim == "all"
    names = list(SIMULATORS) if several else [arguments.sim or subjects[0].config.sim]
    changed = {name: vars(arguments)[name] for name in ("gui", "slow", "randomise")} | other_goals(arguments)
    configs = {name: [in_evaluation(one.config, name, **changed) for one in subjects] for name in names}
    reports: list[dict[str, Any]] = []
    failed: list[str] = []

    @contextlib.contextmanager
    def attempt(name: str) -> Iterator[None]:
        """Of several simulators one may fail; the reason is printed."""
        try:
            yield
        except (InputError, FloatingPointError) as error:
            if not several:
                raise
            note(f"{name}: {error}")
            failed.append(name)

    try:
        with Bar() as display:
            for name in names if several else ():  # found before minutes are spent on the others
                with attempt(name):
                    Env(configs[name][0], 1).close()
            for name in [name for name in names if name not in failed]:
                with attempt(name):
                    for subject, config in zip(subjects, configs[name], strict=True):
                        # The first one has the baselines.
                        agents = [one for one in arguments.agent if subject is subjects[0] or AGENTS[one].trained]
                        for report in _reports(arguments, subject, config, agents, display):
                            baseline = report["agent"] in AGENTS and not AGENTS[report["agent"]].trained
                            of = {"run": "" if baseline else subject.name}
                            reports.append((of if len(subjects) > 1 else {}) | report)
    finally:  # the reports that there are, whatever ended the evaluation
        several_rows = len(names) * len(arguments.agent) * len(subjects) > 1
        _show_evaluation(reports, subjects, configs[names[0]][0], as_list=several_rows, json=arguments.json)
    if failed:
        raise InputError(f"no result in {', '.join(failed)}: the reason is above.")


def _reports(
    arguments: Eval, subject: Subject, config: RunConfig, agents: Sequence[str], display: Bar
) -> Iterator[dict[str, Any]]:
    """Report of each agent in one simulator; where it cannot be saved in the run a warning has been printed.

    Those of a model are not saved; nor are those of a policy that comes with reachlab, or on other goals than the
    run's, which would stand in for those on its own.
    """
    from reachlab.cli.console import note
    from reachlab.envs.core import Env
    from reachlab.evaluation.episodes import BATCH
    from reachlab.evaluation.report import examine
    from reachlab.runs.shipped import is_shipped
    from reachlab.sims import SIMULATORS

    name, episodes, run = config.sim, arguments.episodes, subject.run
    num_envs = 1 if arguments.gui else min(episodes, SIMULATORS[name].most_envs or BATCH)
    with contextlib.closing(Env(config, num_envs)) as env:
        given: dict[str, Any] = {"seed": arguments.seed, "episodes": episodes, "watch": display.count}
        for agent in agents:
            acting, policy, checkpoint = subject.acting(env, agent)
            display.expect(f"{agent} in {name}", episodes)
            result, played = examine(env, acting, policy, **given, checkpoint=checkpoint)
            report = result.to_json()
            if run and not is_shipped(run) and not other_goals(arguments):
                rows = {"goal": played.goal, "distance": played.distance, "success": played.success}
                try:
                    run.write_report("-".join((name, agent, str(arguments.seed), *arguments.randomise)), report, rows)
                except InputError as error:
                    note(f"Warning: {error}")
            yield report


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
        _say_elsewhere(reports, subjects)
        if means:
            note("Means are over trainings; their intervals are Student's, and a dash where all trainings are equal.")


def _say_elsewhere(reports: Sequence[dict[str, Any]], subjects: Sequence[Subject]) -> None:
    """Say why the policy of a run may fail in another simulator than that of its training."""
    from reachlab.cli.console import say

    for subject, report in itertools.product(subjects, reports):
        own, other, failed = subject.config.sim, report["sim"], report["success_rate"] < ELSEWHERE
        trained = report["agent"] in AGENTS and AGENTS[report["agent"]].trained
        known = subject.run is not None and report.get("run", subject.name) == subject.name
        if known and failed and trained and other != own:
            varied = "lag" in subject.config.randomise
            advice = (
                f"reachlab deploy check --sim {other} plays its exported controller, which goes on as in training"
                if varied
                else "with --sim mujoco, --randomise lag trains for both, see docs/deploy.md"
            )
            say(
                f"{subject.name} was trained in {own}, where joints follow their commands otherwise than in {other}:"
                f" {advice}."
            )


def _means(reports: Sequence[dict[str, Any]], subjects: Sequence[Subject]) -> list[dict[str, Any]]:
    """Means over the runs that differ by their seeds alone, of each agent in each simulator."""
    from reachlab.evaluation.intervals import mean_report

    groups: dict[str, dict[int, str]] = {}
    for subject in subjects:
        alike = jsonlib.dumps(flatten(to_json(subject.config)) | {"seed": 0})
        groups.setdefault(alike, {}).setdefault(subject.config.seed, subject.name)
    made = []
    kinds = dict.fromkeys((report["sim"], report["agent"]) for report in reports)
    for names, kind in itertools.product(groups.values(), kinds):
        of_kind = [report for report in reports if (report["sim"], report["agent"]) == kind]
        own = [report for report in of_kind if report.get("run") in names.values()]
        if len(own) > 1:
            made.append(mean_report(own) | {"run": f"mean of {len(own)} seeds"})
    return made
