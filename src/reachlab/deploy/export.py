"""Export of a run: a folder with all that a robot's computer needs."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from safetensors.numpy import save_file

from reachlab.agents.acting import make_act
from reachlab.agents.policy import Policy
from reachlab.control.contact_model import arm_of
from reachlab.control.motion_limits import MotionLimits
from reachlab.deploy.bundle import controller_source, planner_source
from reachlab.deploy.c_library import OWN, CPolicy, compiler
from reachlab.deploy.c_source import c_sources
from reachlab.deploy.card import model_card
from reachlab.deploy.facts import describe
from reachlab.deploy.onboard.aiming import NEARBY
from reachlab.deploy.onboard.folder import check_limits, fingerprint, limits_of, read_folder
from reachlab.deploy.onboard.reading import in_words
from reachlab.deploy.onboard.step import load_step
from reachlab.deploy.onnx_network import OnnxNetwork
from reachlab.deploy.weights import named_weights, onnx_model
from reachlab.emit.behaviour import as_measured, behaviour, decision, rows_of
from reachlab.emit.program import constants_of
from reachlab.emit.python import to_python
from reachlab.envs.core import Env
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.envs.setup import in_evaluation
from reachlab.learn.load import load_saved
from reachlab.robots.catalogue import find_model_file
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import read_json
from reachlab.runs.provenance import versions
from reachlab.runs.shipped import find_run
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, override, to_json
from reachlab.settings.validation import InputError, choose

SITUATIONS, TOGETHER = 1000, 50
"""Situations in which an export is compared with its policy, and how many episodes they are taken from."""

CHECK_SEED = 4000
"""Seed of the held-out goals of these episodes."""

TOLERANCES = {
    "ONNX Runtime": (5e-6, "of the action's box"),
    "step.py": (1e-4, "rad or m"),
    "reachlab_policy.c": (1e-9, "rad or m"),
}
"""Largest differences that are allowed, and their units: the printed step computes in double precision, and training in
single; both printed steps in the same."""

FIGURES = ("success_rate", "success_interval", "success_within", "final_error_mm", "final_angle_rad", "tracking")
FIGURES += ("time_to_reach_s", "contact", "self_contact", "sim", "seed", "episodes", "randomised")
"""Figures of a report that go with a policy."""


@dataclass(frozen=True)
class Export:
    """What was written.

    Attributes:
        folder: where.
        files: names and sizes [bytes].
        differences: largest ones, by what computed something, see `compare` and `TOLERANCES`.
    """

    folder: Path
    files: dict[str, int]
    differences: dict[str, float]


def export(
    run: RunDirectory | str | Path,
    out: str | Path,
    agent: str | None = None,
    limits: str | Path | None = None,
    **goals: Any,
) -> Export:
    """Write the policy of a run, or one that comes with reachlab, into a folder that does not exist or is empty.

    Args:
        run: the run directory.
        out: the folder.
        agent: `trained`, or `hybrid` for a planner beside the policy; by default that among bodies that stay.
        limits: a file with lowered `limits` of the joints, as the `policy.json` of an export before; also C keeps them.
        goals: settings of what will be asked for, as of an evaluation, where that is something else than in training.

    Raises:
        InputError: a setting does not exist or fit, limits are wider than the arm's, the folder exists and is not
            empty, the run cannot be read, its task computes what cannot be printed or planned, the extra 'deploy' is
            missing, or what was written computes anything else than the policy.
    """
    run, out = run if isinstance(run, RunDirectory) else find_run(run), Path(out)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"'{out}' exists and is not empty: choose another --out, or remove it.")
    trained = run.read_config()
    # Its controller counts on measurements as late as they were in training, and on joints that follow as late.
    late = [varies for varies in trained.randomise if varies in ("delay", "lag")]
    asked = override(in_evaluation(trained, trained.sim, **goals), randomise=late)
    env = Env(override(asked, shaping=True), TOGETHER)  # as its controller shapes what it commands
    try:
        saved, planner = load_saved(run, env), _planner(env, agent)
        more = {"run": saved.checkpoint, "held_out": _held_out(run), "versions": versions()} | planner
        more["evaluated_with"] = _evaluated_with(trained, asked, goals)
        more["settings"] = to_json(asked)
        more["robot_sha256"] = find_model_file(trained.robot, trained.package).digest
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "policy"
            folder.mkdir()
            write_files(folder, env, saved.policy, more, Path(limits) if limits else None)
            differences = compare(folder, env, saved.policy)
            for what, difference in differences.items():
                allowed, unit = TOLERANCES[what]
                if not difference <= allowed:
                    raise InputError(
                        f"nothing is exported: {what} differs from the policy by {difference:.1e} {unit}, and"
                        f" {allowed:.0e} are allowed."
                    )
            _copy(folder, out)
    finally:
        env.close()
    return Export(out, {file.name: file.stat().st_size for file in sorted(out.iterdir())}, differences)


def _copy(folder: Path, out: Path) -> None:
    """Copy the files of a folder, all or none.

    Raises:
        InputError: there is no room for them, or they may not be written.
    """
    there, copied = out.is_dir(), list[Path]()
    try:
        out.mkdir(parents=True, exist_ok=True)
        for file in folder.iterdir():
            copied.append(out / file.name)
            shutil.copyfile(file, copied[-1])
    except OSError as error:
        with contextlib.suppress(OSError):
            for file in copied:
                file.unlink(missing_ok=True)
            if not there:
                out.rmdir()
        raise InputError(f"the export cannot be written to '{out}': {error.strerror or error}.") from None


def _planner(env: Env, agent: str | None) -> dict[str, Any]:
    """What a planner has to know, by the name `planner`; nothing where there is none.

    Raises:
        InputError: no agent of that name can be exported, or it has nothing to plan.
    """
    setup, scene = env.setup, env.setup.scene
    plannable = "joints" in setup.rules.gives and not (scene.moved or scene.objects or scene.wrench)
    agent = agent or ("hybrid" if plannable and scene.fixed else "trained")
    if choose("agent of an export", agent, ("trained", "hybrid")) == "trained":
        return {}
    if not plannable:
        raise InputError(
            "agent 'hybrid' is exported for goals whose joints are known, among bodies that stay, without a wrench."
        )
    arm = arm_of(setup.robot, setup.lag, setup.period)._asdict()
    plain = {name: np.asarray(part).tolist() for name, part in arm.items()}
    return {"planner": {"arm": plain, "bodies": scene.bodies, "turns": setup.rules.asks_orientation}}


def _evaluated_with(trained: RunConfig, asked: RunConfig, names: Iterable[str]) -> dict[str, Any]:
    """Settings by name of what the run was evaluated in, where the export asks for something else."""
    was, now = (flatten(to_json(one)) for one in (trained, asked))
    return {name: was.get(name) for name in names if was.get(name) != now.get(name)}


def _held_out(run: RunDirectory) -> list[dict[str, Any]]:
    """Figures of the run's policy: of the report at the end of its training, and of later evaluations."""
    reports = [report for report, _ in run.read_reports()]
    if run.report_file.exists():
        reports.insert(0, read_json(run.report_file))
    return [{name: one[name] for name in FIGURES if name in one} for one in reports if one.get("agent") == "trained"]


def _lowered(facts: dict[str, Any], file: Path) -> dict[str, Any]:
    """What is said of a policy, with the limits of a file, or of the export in a folder."""
    file = file / "policy.json" if file.is_dir() else file
    if not file.is_file():
        raise InputError(f"limits are read from the policy.json of an export before, and there is no file '{file}'.")
    known = read_json(file)
    try:
        lowered = facts | {"limits": known["limits"]}
        check_limits(file, lowered)
    except (AttributeError, LookupError, TypeError):
        raise InputError(f"'{file}' has no `limits` of joints: name the policy.json of an export before.") from None
    except ValueError as error:
        raise InputError(str(error)) from None
    return lowered


def write_files(folder: Path, env: Env, policy: Policy, more: dict[str, Any], limits: Path | None = None) -> None:
    """Write a policy, its step and what `describe` says of it, and `more`, into an empty folder; limits see `export`.

    Raises:
        InputError: the extra 'deploy' is missing, the step cannot be printed, or limits do not fit.
    """
    model = onnx_model(policy, env.action_bounds, clips=env.setup.rules.clip_actions)
    weights = named_weights(policy, env.action_bounds)
    step = behaviour(env, policy, weights)
    facts, arrays = describe(env, policy, step) | more, constants_of(step.programs) | weights
    (folder / "policy.onnx").write_bytes(model.SerializeToString())
    save_file({name: np.ascontiguousarray(array) for name, array in arrays.items()}, folder / "policy.safetensors")
    (folder / "controller.py").write_text(controller_source(), encoding="utf-8")
    if "planner" in more:
        (folder / "planner.py").write_text(planner_source(), encoding="utf-8")
    (folder / "step.py").write_text(to_python(step.programs, pausing={"place"}), encoding="utf-8")
    facts = _lowered(facts, limits) if limits else facts
    for name, text in c_sources(facts, MotionLimits(**limits_of(facts), period=env.setup.period), step).items():
        (folder / name).write_text(text, encoding="utf-8", errors="backslashreplace")
    facts["files"] = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.iterdir())}
    facts["sha256"] = fingerprint(facts)
    text = {"policy.json": json.dumps(facts, indent=1, ensure_ascii=False) + "\n", "README.md": model_card(facts)}
    for name, content in text.items():
        # A file's name may hold bytes that are no text, and a robot is named after its file.
        (folder / name).write_text(content, encoding="utf-8", errors="backslashreplace")


def compare(folder: Path, env: Env, policy: Policy, situations: int = SITUATIONS) -> dict[str, float]:
    """Largest differences of an export from a policy in so many situations of held-out episodes, by what computes it.

    Of ONNX Runtime's actions in the size of their box, of the commands of the printed step [rad or m], and, where a
    compiler is there, of those of the C sources from those of the shell [rad or m], and of their actions [of the box].
    """
    onnx, facts, functions = OnnxNetwork(folder), read_folder(folder), as_measured(env.functions)
    printed, limits = load_step(folder)["decide"], MotionLimits(**limits_of(facts), period=env.setup.period)
    low = env.action_bounds[0]
    size, worst = env.action_bounds[1] - low, defaultdict[str, float](float)

    def note(what: str, difference: Any) -> None:
        worst[what] = max(worst[what], float(np.abs(difference).max()))

    # It is given joints as they are.
    decide = jax.jit(lambda state, picture: decision(functions, policy, replace(state, sensed=None), picture))
    with tempfile.TemporaryDirectory() as build:
        c = CPolicy(folder, facts["inputs"], limits.n, Path(build)) if compiler() and not env.pictured else None
        for state, picture in _situations(env, policy, -(-situations // env.num_envs)):
            _check_goals(facts["goal"], np.asarray(state.goal.position))
            seen, actions, commands, memory = jax.tree.map(np.asarray, decide(state, picture))
            computed, *after = onnx.decide(seen, state.memory)
            for difference in ((computed - actions) / size, *(one - memory for one in after)):
                note("ONNX Runtime", difference)
            for row, given in enumerate(rows_of(state, picture, facts["inputs"])):
                action, wanted, *after = map(np.array, printed(**given))
                note("step.py", wanted - commands[row])
                for one in after:  # what a policy with a memory remembers then
                    note("step.py", one - np.asarray(memory)[row])
                if c is not None:
                    motion = limits.at_rest(np.array(given.pop("command")))
                    kept = {name: given.pop(name) for name in OWN[1:] if name in given}
                    c.set(c.state, **motion._asdict(), **kept)
                    c.set(c.input, **given)
                    note("reachlab_policy.c", c.step()[0] - limits.advance(motion, wanted).position)
                    # One step from rest is as long as limits allow, whatever is wanted: the action says what is.
                    note("reachlab_policy.c", (np.array(c.state.last_action) - action) / size)
                    for one in after:
                        note("reachlab_policy.c", np.array(c.state.memory) - one.ravel())
    return dict(worst)


def _check_goals(goal: dict[str, Any], places: np.ndarray) -> None:
    """Refuse an export whose controller would refuse goals `[B, 3]` m of its own task."""
    low, high = np.array(goal["low"]) - NEARBY, np.array(goal["high"]) + NEARBY
    if (outside := ((places < low) | (places > high)).any(axis=1)).any():
        box = f"{in_words(np.array(goal['low']))} to {in_words(np.array(goal['high']))}"
        raise InputError(
            f"a goal of the task is at {in_words(places[outside][0])} m, out of its `goal_box`, {box} m, by more than"
            f" {NEARBY:g} m, where a controller brakes: make the box larger."
        )


def _situations(env: Env, policy: Policy, steps: int) -> Any:
    """States and pictures `[B, ...]` of so many steps of held-out episodes."""
    state = env.compile_whole(env.init_held_out)(episode_keys(CHECK_SEED, REPORT_STREAM, 0, env.num_envs))
    act, key = make_act(env, "trained"), jax.random.key(0)
    step = env.compile_whole(act)
    for _ in range(steps):
        picture = env.render_observation(state) if env.pictured else None
        yield state, picture
        state, _, key = step(policy, state, key)
