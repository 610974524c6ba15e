"""Policies that come with reachlab, trained again and compared; with --replace they take the place of the old ones."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path
from typing import Any

import reachlab
from reachlab.envs.core import Env
from reachlab.envs.presets import preset
from reachlab.envs.setup import in_evaluation
from reachlab.evaluation.episodes import BATCH
from reachlab.evaluation.report import examine
from reachlab.jax_setup import use_compilation_cache
from reachlab.learn.load import POLICY, load_policy
from reachlab.robots.catalogue import ROBOTS
from reachlab.runs import checkpoint
from reachlab.runs.directory import RunDirectory
from reachlab.runs.files import read_json, write_json
from reachlab.runs.shipped import SHIPPED, shipped
from reachlab.settings.json_form import override, to_json
from reachlab.tasks import TASKS

SOME = {"push": ("panda", "so101"), "lift": ("panda",), "place": ("panda",), "slide": (), "clutter_pose": ()}
"""Tasks for which only some arms have one."""

NAMES = [f"{robot}/{task}" for task in TASKS for robot in SOME.get(task, tuple(ROBOTS))]
"""All that there should be."""

EPISODES, SEED = 2000, 5000
"""Held-out episodes of a policy's report, and the seed of their goals."""


def trained(name: str, runs: Path) -> RunDirectory:
    """The finished run of a policy, trained now unless it lies in `runs`."""
    robot, task = name.split("/")
    run = RunDirectory(runs / f"{robot}-{task}")
    if not run.finished:
        print(f"{name}: trains", flush=True)  # noqa: T201
        reachlab.train(override(preset(task), robot=robot), run.path)
    return run


def reduced(run: RunDirectory, out: Path) -> dict[str, Any]:
    """Write a run without what only training needs, and give the report of its policy."""
    config, manifest = run.read_config(), run.newest_manifest()
    assert manifest is not None, run.path
    env = Env(in_evaluation(config, config.sim), BATCH)
    policy = load_policy(run, env)
    small = RunDirectory(out)
    small.create(config)
    small.checkpoints.mkdir()
    top, inner = POLICY.split("/")
    checkpoint.write(small.checkpoints, {top: {inner: policy}}, manifest.counters, to_json(config))
    kept = small.newest_manifest()
    assert kept is not None, out
    report, _ = examine(env, "trained", policy, seed=SEED, episodes=EPISODES, checkpoint=kept.identity)
    env.close()
    write_json(small.report_file, report.to_json())
    return report.to_json()


def compared(name: str, report: dict[str, Any]) -> tuple[bool, str]:
    """Whether a policy trained again is as good as the one that there is, and both in a sentence."""
    again = f"{report['success_rate']:.2%} of {EPISODES:,}"
    there = shipped().get(name)
    if there is None:
        return True, f"{again}; there was none"
    known = read_json(there.report_file)
    as_good = report["success_interval"][1] >= known["success_interval"][0]
    same = "the same bit for bit" if known["checkpoint"] == report["checkpoint"] else "other weights"
    return as_good, f"{again}, before {known['success_rate']:.2%}; {same}{'' if as_good else ': WORSE'}"


def main() -> bool:
    """Whether all are as good as those that there are."""
    parser = argparse.ArgumentParser(prog="shipped_policies")
    parser.add_argument("names", nargs="*", default=NAMES, help="arm/task; all without any")
    parser.add_argument(
        "--runs", type=Path, default=Path("runs/policies"), help="where runs are trained, or lie already"
    )
    parser.add_argument("--replace", action="store_true", help="put them in the place of those that there are")
    chosen = parser.parse_args()
    use_compilation_cache()
    chosen.runs.mkdir(parents=True, exist_ok=True)
    good = True
    for name in chosen.names:
        out = chosen.runs / f"reduced-{name.replace('/', '-')}"
        shutil.rmtree(out, ignore_errors=True)
        as_good, sentence = compared(name, reduced(trained(name, chosen.runs), out))
        print(f"{name}: {sentence}", flush=True)  # noqa: T201
        good &= as_good
        if chosen.replace:
            shutil.rmtree(SHIPPED / name, ignore_errors=True)
            (SHIPPED / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.move(out, SHIPPED / name)
    return good


if __name__ == "__main__":
    sys.exit(not main())
