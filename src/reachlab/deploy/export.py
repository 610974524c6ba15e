"""Export of a run: a folder with all that a robot's computer needs."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from reachlab.agents.acting import make_act
from reachlab.agents.policy import Policy
from reachlab.deploy.bundle import controller_source
from reachlab.deploy.card import model_card
from reachlab.deploy.facts import describe, refuse_unknown
from reachlab.deploy.onboard.folder import fingerprint, read_folder
from reachlab.deploy.onboard.network import Network, read_weights
from reachlab.deploy.onnx_network import OnnxNetwork
from reachlab.deploy.weights import named_weights, onnx_model
from reachlab.envs.core import Env
from reachlab.envs.random_streams import REPORT_STREAM, episode_keys
from reachlab.envs.setup import in_evaluation
from reachlab.learn.load import load_saved
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import read_json
from reachlab.runs.shipped import find_run
from reachlab.runs.versions import versions
from reachlab.settings.validation import InputError, installing
from reachlab.tasks.actions import bounded
from reachlab.tasks.schema import Observed

SITUATIONS, TOGETHER = 1000, 50
"""Situations in which an export is compared with its policy, and how many episodes they are taken from."""

CHECK_SEED = 4000
"""Seed of the held-out goals of these episodes."""

TOLERANCE = 5e-6
"""Largest difference that is allowed between an export's and the policy's actions, in those of the action's box."""

FIGURES = ("success_rate", "success_interval", "success_within", "final_error_mm", "final_angle_rad", "tracking")
FIGURES += ("time_to_reach_s", "contact", "self_contact", "sim", "seed", "episodes", "randomised")
"""Figures of a report that go with a policy."""


@dataclass(frozen=True)
class Export:
    """What was written.

    Attributes:
        folder: where.
        files: names and sizes [bytes].
        differences: largest difference from the policy, in actions of the action's box, by what computed it.
    """

    folder: Path
    files: dict[str, int]
    differences: dict[str, float]


def export(run: RunDirectory | str | Path, out: str | Path) -> Export:
    """Write the policy of a run, or one that comes with reachlab, into a folder that does not exist or is empty.

    Args:
        run: the run directory.
        out: the folder.

    Raises:
        InputError: the folder exists and is not empty, the run cannot be read, its observation or action is one that
            the controller does not know, the extra 'deploy' is missing, or what was written computes other actions than
            the policy.
    """
    run, out = run if isinstance(run, RunDirectory) else find_run(run), Path(out)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"'{out}' exists and is not empty: choose another --out, or remove it.")
    trained = run.read_config()
    refuse_unknown(trained)
    env = Env(in_evaluation(trained, trained.sim), TOGETHER)
    try:
        saved = load_saved(run, env)
        facts = describe(env, saved.policy) | {
            "run": saved.checkpoint,
            "held_out": _held_out(run),
            "versions": versions(),
        }
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "policy"
            folder.mkdir()
            write_files(folder, env, saved.policy, facts)
            differences = compare(folder, env, saved.policy)
            for what, difference in differences.items():
                if not difference <= TOLERANCE:
                    raise InputError(
                        f"nothing is exported: {what} gives actions that differ from the policy's by"
                        f" {difference:.1e} of their box, and {TOLERANCE:.0e} are allowed."
                    )
            out.mkdir(parents=True, exist_ok=True)
            for file in folder.iterdir():
                shutil.copyfile(file, out / file.name)
    finally:
        env.close()
    return Export(out, {file.name: file.stat().st_size for file in sorted(out.iterdir())}, differences)


def _held_out(run: RunDirectory) -> list[dict[str, Any]]:
    """Figures of the run's policy: of the report at the end of its training, and of later evaluations."""
    reports = [report for report, _ in run.read_reports()]
    if run.report_file.exists():
        reports.insert(0, read_json(run.report_file))
    return [{name: one[name] for name in FIGURES if name in one} for one in reports if one.get("agent") == "trained"]


def write_files(folder: Path, env: Env, policy: Policy, facts: dict[str, Any]) -> None:
    """Write a policy and what `describe` says of it into an empty folder.

    Raises:
        InputError: the extra 'deploy' is missing.
    """
    try:
        from safetensors.numpy import save_file
    except ModuleNotFoundError:
        raise InputError(f"an export needs the extra 'deploy': {installing('deploy')}.") from None

    model = onnx_model(policy, env.action_bounds, clips=env.setup.rules.clip_actions)
    weights = {name: np.ascontiguousarray(array) for name, array in named_weights(policy, env.action_bounds).items()}
    (folder / "policy.onnx").write_bytes(model.SerializeToString())
    save_file(weights, folder / "policy.safetensors")
    (folder / "controller.py").write_text(controller_source(), encoding="utf-8")
    facts["files"] = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.iterdir())}
    facts["sha256"] = fingerprint(facts)
    text = {"policy.json": json.dumps(facts, indent=1, ensure_ascii=False) + "\n", "README.md": model_card(facts)}
    for name, content in text.items():
        # A file's name may hold bytes that are no text, and a robot is named after its file.
        (folder / name).write_text(content, encoding="utf-8", errors="backslashreplace")


def compare(folder: Path, env: Env, policy: Policy, situations: int = SITUATIONS) -> dict[str, float]:
    """Largest differences of an export's actions from a policy's in so many held-out situations, in their box's size.

    By what computes them: ONNX Runtime and NumPy.
    """
    facts = read_folder(folder)
    network, onnx = Network(read_weights(folder / "policy.safetensors"), facts["network"]), OnnxNetwork(folder)
    size = env.action_bounds[1] - env.action_bounds[0]
    worst = {"ONNX Runtime": 0.0, "NumPy": 0.0}
    act = jax.jit(lambda policy, seen: bounded(env.setup, policy.act(seen)))
    for seen in _situations(env, policy, -(-situations // env.num_envs)):
        expected = np.asarray(act(policy, seen))
        picture, vector = env.schema.split(seen)
        given = {"ONNX Runtime": onnx.act(seen), "NumPy": network.act(vector, picture)}
        for what, actions in given.items():
            difference = np.abs(actions - expected).max(axis=0) / size
            worst[what] = max(worst[what], float(difference.max()))
    return worst


def _situations(env: Env, policy: Policy, steps: int) -> Any:
    """Observations `[B, ...]` of so many steps of held-out episodes, in NumPy."""
    state = env.compile_whole(env.init)(episode_keys(CHECK_SEED, REPORT_STREAM, 0, env.num_envs))
    act, key = make_act(env, "trained"), jax.random.key(0)
    step = env.compile_whole(act)
    for _ in range(steps):
        seen: Observed = jax.tree.map(np.asarray, env.observe_now(state))
        yield seen
        state, _, key = step(policy, state, key)
