"""The verb `eval`."""

from __future__ import annotations

import json as jsonlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reachlab.agents import AGENTS
from reachlab.cli.flags import Eval
from reachlab.cli.preparation import prepare
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, override, to_json
from reachlab.settings.presets import preset
from reachlab.settings.validation import InputError, choose

if TYPE_CHECKING:
    from pathlib import Path

    from reachlab.agents.sb3_policy import SavedModel
    from reachlab.cli.progress import EvalDisplay
    from reachlab.deploy.onnx_network import OnnxNetwork
    from reachlab.learn.load import Saved
    from reachlab.runs.directory import RunDirectory


@dataclass
class _Subject:
    """What is evaluated: a run, a model, or without either the settings that the flags name.

    What is `saved` in a run is loaded once: all simulators get the same checkpoint, even where a training writes newer
    ones meanwhile.
    """

    name: str
    config: RunConfig
    run: RunDirectory | None = None
    model: SavedModel | OnnxNetwork | None = None
    saved: Saved | None = None


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

    subjects = _subjects(arguments)
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


def _subjects(arguments: Eval) -> list[_Subject]:
    """What the flags name; several runs are of one task on one arm.

    Raises:
        InputError: they are not, or one of them is named twice or cannot be used.
    """
    from reachlab.runs.shipped import find_run

    made = []
    for path in arguments.runs or (None,):
        run = find_run(path) if path and not _is_model(path) else None
        model = _model(arguments, path)
        made.append(_Subject(str(path or ""), _settings(arguments, run, model), run, model))
    first, *others = made
    for other in others:
        for name in ("task", "robot") + (() if arguments.sim else ("sim",)):
            one, another = getattr(first.config, name), getattr(other.config, name)
            if one != another:
                remedy = "add --sim" if name == "sim" else "evaluate them one by one"
                raise InputError(
                    f"one table is of one {name}: '{first.name}' is of {one}, '{other.name}' of {another}: {remedy}."
                )
    if len({subject.name for subject in made}) < len(made):
        raise InputError("a run is named twice: name each once.")
    return made


def _is_zip(path: Path) -> bool:
    """Whether a path names a model of Stable-Baselines3."""
    return path.suffix == ".zip" and not path.is_dir()


def _is_onnx(path: Path) -> bool:
    """Whether a path names a policy in ONNX, or the folder of an export."""
    return (path.suffix == ".onnx" and not path.is_dir()) or (path / "policy.onnx").is_file()


def _is_model(path: Path) -> bool:
    """Whether a path names a policy of another kind than a run directory."""
    return _is_zip(path) or _is_onnx(path)


def _model(arguments: Eval, path: Path | None) -> SavedModel | OnnxNetwork | None:
    """The model of Stable-Baselines3 or the policy in ONNX that is named, if one is.

    Raises:
        InputError: it is not trusted or cannot be loaded, or there is none and flags speak of one.
    """
    if not any(map(_is_zip, arguments.runs)):
        for name in ("trust", "normaliser"):
            if getattr(arguments, name):
                raise InputError(f"--{name} goes with a model of Stable-Baselines3: name its .zip, or leave it out.")
    if path is None or not _is_model(path):
        return None
    if not _is_zip(path):
        from reachlab.deploy.onnx_network import OnnxNetwork

        return OnnxNetwork(path)
    if not arguments.trust:
        raise InputError(
            f"'{path}' is a model of Stable-Baselines3, which is unpickled and may run any code: add --trust"
            " if you know where it comes from."
        )
    from reachlab.agents.sb3_policy import load_model

    return load_model(path, arguments.normaliser)


def _settings(arguments: Eval, run: RunDirectory | None, model: SavedModel | OnnxNetwork | None) -> RunConfig:
    """Settings of the run or the model, or without one those of the task and the robot that the flags name.

    Raises:
        InputError: no such run, one that is missing or not needed, or a robot that is not named right.
    """
    arm = {name: vars(arguments)[name] for name in ("robot", "tool", "base", "package")}
    named = {"task": arguments.task} | arm
    known = model.config if model else None
    said = {name: value for name, value in named.items() if value}
    if known and said == {"task": known.task}:
        said = {}
    if (run or known) and (given := [f"--{name}" for name in said]):
        raise InputError(f"a run has its own task and robot: leave {' and '.join(given)} out, or the run.")
    if run:
        return run.read_config()
    if known:
        return known
    if not model and (needing := [agent for agent in arguments.agent if AGENTS[agent].trained]):
        others = ", ".join(name for name, entry in AGENTS.items() if not entry.trained)
        raise InputError(
            f"agent {needing[0]!r} needs a run: name its directory or a policy of `reachlab list`, or choose --agent"
            f" among {others}."
        )
    config = preset(arguments.task or "tutorial")
    return override(config, **{name: value for name, value in arm.items() if value})


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
    arguments: Eval, subjects: Sequence[_Subject], configs: Sequence[RunConfig], display: EvalDisplay
) -> Iterator[tuple[dict[str, Any], list[str]]]:
    """What `_evaluated` gives for each subject, with its name where there are several; the first has the baselines."""
    agents = arguments.agent
    for subject, config in zip(subjects, configs, strict=True):
        for report, warning in _evaluated(arguments, subject, config, agents, display):
            told = {"run": subject.name if AGENTS[report["agent"]].trained else ""} if len(subjects) > 1 else {}
            yield told | report, warning
        agents = tuple(agent for agent in agents if AGENTS[agent].trained)


def _evaluated(
    arguments: Eval, subject: _Subject, config: RunConfig, agents: Sequence[str], display: EvalDisplay
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
    reports: list[dict[str, Any]], subjects: Sequence[_Subject], config: RunConfig, *, as_list: bool, json: bool
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


def _means(reports: Sequence[dict[str, Any]], subjects: Sequence[_Subject]) -> list[dict[str, Any]]:
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
