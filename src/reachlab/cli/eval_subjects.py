"""Subjects of `reachlab eval`: runs, models of other libraries, or baselines alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reachlab.agents import AGENTS
from reachlab.cli.deploy_flags import Export
from reachlab.cli.flags import Subjects
from reachlab.envs.presets import preset
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import override
from reachlab.settings.validation import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from reachlab.agents.acting import Function
    from reachlab.agents.policy import Policy
    from reachlab.agents.sb3_policy import SavedModel
    from reachlab.deploy.lerobot_policy import LeRobotPolicy
    from reachlab.deploy.onnx_network import OnnxNetwork
    from reachlab.envs.core import Env
    from reachlab.learn.load import Saved
    from reachlab.runs.directory import RunDirectory

    Model = SavedModel | OnnxNetwork | LeRobotPolicy


@dataclass
class Subject:
    """Subject of an evaluation: a run, a model, or without either the settings that the flags name.

    What is `saved` in a run is loaded once: all simulators get the same checkpoint, even where a training writes newer
    ones meanwhile.
    """

    name: str
    config: RunConfig
    run: RunDirectory | None = None
    model: Model | None = None
    saved: Saved | None = None

    def acting(self, env: Env, agent: str) -> tuple[str | Function, Policy | None, dict[str, Any] | None]:
        """An agent as it acts in an environment, the policy of the run and what identifies what has been trained.

        Agent `trained` is the policy of a run, or a model.
        """
        from reachlab.learn.load import load_saved

        if self.model:
            self.model.check(env)
        if self.run and not self.saved:
            self.saved = load_saved(self.run, env)
        judged = self.model or self.saved
        acts = self.model.act if self.model and AGENTS[agent].trained else agent
        return acts, self.saved.policy if self.saved else None, judged.checkpoint if judged else None


def other_goals(arguments: Subjects | Export) -> dict[str, Any]:
    """Settings of the goals that the flags change."""
    return {name: value for name, value in vars(arguments.goals).items() if value is not None}


def find_subjects(arguments: Subjects, agents: Sequence[str]) -> list[Subject]:
    """Subjects that the flags name, and that such agents need; several runs are of one task on one arm.

    A model that does not say what it was trained for is evaluated on what the first subject was.

    Raises:
        InputError: they are not, or one of them is named twice or cannot be used.
    """
    check_trust(arguments)
    first, *others = made = [find_subject(arguments, agents, path) for path in arguments.runs or (None,)]
    for other in others:
        if other.model and not other.model.config and not arguments.task:
            other.config = first.config
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


def find_subject(arguments: Subjects, agents: Sequence[str], path: Path | None) -> Subject:
    """The subject at a path or, without one, that of a task.

    Raises:
        InputError: it cannot be used.
    """
    from reachlab.runs.shipped import find_run

    model = _find_model(arguments, path) if path else None
    if model and (beside := [agent for agent in agents if AGENTS[agent].trained and AGENTS[agent].remembers]):
        raise InputError(
            f"agent {beside[0]!r} needs the policy of a run, and '{path}' is a model: name the run. An export with its"
            " planner is played by `reachlab deploy check`."
        )
    run = find_run(path) if path and not model else None
    return Subject(str(path or ""), _settings(arguments, agents, run, model), run, model)


def only_subject(arguments: Subjects, agents: Sequence[str]) -> Subject:
    """The one subject that the flags name.

    Raises:
        InputError: they name several, or see `find_subjects`.
    """
    if len(arguments.runs) > 1:
        raise InputError("this command takes one run at a time: name one.")
    return find_subjects(arguments, agents)[0]


def check_trust(arguments: Subjects) -> None:
    """Make sure that there is a model where the flags say that it is trusted.

    Raises:
        InputError: there is none.
    """
    for name in () if any(map(_is_zip, arguments.runs)) else ("trust", "normaliser"):
        if vars(arguments)[name]:
            raise InputError(f"--{name} goes with a model of Stable-Baselines3: name its .zip, or leave it out.")


def _is_zip(path: Path) -> bool:
    """Whether a path names a model of Stable-Baselines3."""
    return path.suffix == ".zip" and not path.is_dir()


def _is_onnx(path: Path) -> bool:
    """Whether a path names a policy in ONNX, or the folder of an export."""
    return (path.suffix == ".onnx" and not path.is_dir()) or (path / "policy.onnx").is_file()


def _is_lerobot(path: Path) -> bool:
    """Whether a path names the folder of a policy that LeRobot has saved."""
    return (path / "policy_preprocessor.json").is_file()


def is_model(path: Path) -> bool:
    """Whether a path names a model of another library, and no run."""
    return _is_zip(path) or _is_onnx(path) or _is_lerobot(path)


def _find_model(arguments: Subjects, path: Path) -> Model | None:
    """The model of Stable-Baselines3, or the policy in ONNX or of LeRobot, that is named, if one is.

    Raises:
        InputError: it is not trusted or cannot be loaded.
    """
    if _is_onnx(path):
        from reachlab.cli.console import note
        from reachlab.deploy.onnx_network import OnnxNetwork

        if (path / "planner.py").is_file():
            note(f"'{path}' acts without its planner here: `reachlab deploy check` plays both.")
        return OnnxNetwork(path)
    if _is_lerobot(path):
        from reachlab.deploy.lerobot_policy import LeRobotPolicy

        return LeRobotPolicy(path)
    if not _is_zip(path):
        return None
    if not arguments.trust:
        raise InputError(
            f"'{path}' is a model of Stable-Baselines3, which is unpickled and may run any code: add --trust"
            " if you know where it comes from."
        )
    from reachlab.agents.sb3_policy import load_model

    return load_model(path, arguments.normaliser)


def _settings(arguments: Subjects, agents: Sequence[str], run: RunDirectory | None, model: Model | None) -> RunConfig:
    """Settings of the run or the model, or without one those of the task and the robot that the flags name.

    Raises:
        InputError: no such run, one that is missing or not needed, or a robot or a wrench that is not its own.
    """
    arm = {name: value for name in ("robot", "tool", "base", "package") if (value := vars(arguments)[name])}
    named = ({"task": arguments.task} if arguments.task else {}) | arm
    known = model.config if model else None
    if run:
        run.check_there()  # a word too many, as a second task, is taken for a run
    if (run and named) or (known and named not in ({}, {"task": known.task})):
        given = " and ".join(f"--{name}" for name in named)
        raise InputError(f"a run has its own task and robot: leave {given} out, or the run.")
    if (run or known) and arguments.goals.wrench is not None:
        raise InputError("a policy observes the wrench or not as it was trained: leave --wrench out.")
    if run:
        return run.read_config()
    if known:
        return known
    config = override(preset(arguments.task or "tutorial"), **arm)
    if not model and (needing := [agent for agent in agents if AGENTS[agent].trained]):
        others = ", ".join(name for name, entry in AGENTS.items() if not entry.trained)
        raise InputError(
            f"agent {needing[0]!r} needs a run: name its directory or a policy of `reachlab list`, or choose --agent"
            f" among {others}."
        )
    return config
