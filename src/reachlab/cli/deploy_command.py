"""The verbs `export` and `deploy`."""

from __future__ import annotations

import json as jsonlib
import re
from collections.abc import Mapping
from pathlib import Path
from shlex import quote

from reachlab.cli.deploy_flags import Deploy, Export
from reachlab.cli.preparation import prepare
from reachlab.settings.validation import InputError

NODE = {"topics", "trajectory", "joint_names", "frame"}
"""Flags of the node; the others are of the check."""

FAILED = 0.9
"""Success below which a check says what may be the cause."""

IN_TIME = 0.99
"""Share of commands in time below which a check says that the computer is at fault."""


def export(arguments: Export) -> None:
    """Run `reachlab export`."""
    prepare()
    from reachlab.cli.console import say
    from reachlab.cli.eval_subjects import other_goals
    from reachlab.deploy.check import read_facts
    from reachlab.deploy.export import SITUATIONS, TOLERANCES, export

    done = export(arguments.run, arguments.out, arguments.agent, arguments.limits, **other_goals(arguments))
    if arguments.json:
        print(jsonlib.dumps({"folder": str(done.folder), "files": done.files, "differences": done.differences}))
        return
    sizes = ", ".join(f"{name} ({size / 1000:.0f} kB)" for name, size in done.files.items())
    worst = ", ".join(
        f"{name} {value:.0e} {TOLERANCES[name][1]} ({TOLERANCES[name][0]:.0e} allowed)"
        for name, value in done.differences.items()
    )
    say(f"Written: {done.folder}: {sizes}.")
    say(f"Largest differences in {SITUATIONS:,} situations: {worst}.")
    if "reachlab_policy.c" not in done.differences:
        say("The C sources were not tried: no compiler was found, or the policy gets pictures.")
    if "planner.py" in done.files:
        say("The controller starts a planner, which needs mujoco, ompl and toppra on the robot; or --agent trained.")
    pictured = read_facts(done.folder)["observation"]["pictured"]
    if not pictured:
        _say_unshaped(done.folder)
    _say_evaluated(done.folder)
    what = ("eval", arguments.run) if pictured else ("deploy check", done.folder)
    say(f"Next: reachlab {what[0]} {quote(str(what[1]))}")


def deploy(arguments: Deploy) -> None:
    """Run `reachlab deploy`.

    Raises:
        InputError: a flag that does not go with what is done.
    """
    usual = vars(Deploy(arguments.how, arguments.policy))
    changed = {name for name, value in vars(arguments).items() if value != usual[name]}
    if foreign := sorted(changed - NODE if arguments.how == "ros2" else changed & NODE):
        raise InputError(f"deploy {arguments.how} makes no use of --{foreign[0].replace('_', '-')}: leave it out.")
    if arguments.how == "ros2":
        from reachlab.deploy.ros2 import run_node

        run_node(arguments.policy, **{flag: getattr(arguments, flag) for flag in NODE})
        return
    prepare()
    from reachlab.deploy.check import check, read_facts
    from reachlab.deploy.ros2_check import check_over_ros2

    run = check_over_ros2 if arguments.over_ros2 else check
    given = {"sim": arguments.sim, "episodes": arguments.episodes, "seed": arguments.seed, "faults": arguments.faults}
    outcome = run(arguments.policy, **given).to_json()
    if arguments.json:
        print(jsonlib.dumps(outcome))
        return
    from reachlab.cli.console import say

    low, high = outcome["success_interval"]
    sim = arguments.sim or read_facts(arguments.policy)["settings"]["sim"]
    say(
        f"{outcome['episodes']} held-out episodes in real time, in {sim}: success {100 * outcome['success_rate']:.1f} %"
        f" (95 % interval {100 * low:.1f} to {100 * high:.1f})."
    )
    say(
        f"Commands in time: {100 * outcome['in_time']:.2f} % of {outcome['cycles']:,} cycles; past a limit:"
        f" {outcome['broken']}."
    )
    if outcome["rest_s"] is not None:
        say(f"At rest at most {outcome['rest_s']:.2f} s after the last measurement.")
    if outcome["in_time"] < IN_TIME and arguments.faults == usual["faults"]:
        say("This computer is too slow or busy for the control period: the result tells little of the policy.")
    if not outcome["in_time"]:
        say("The controller gave no command: no measurement came to it.")
    for example, count in _by_kind(outcome["problems"]).items():
        say(f"The controller said in {count:,} cycles: {example}{'' if example.endswith('?') else '.'}")
    if arguments.faults.delay and outcome["success_rate"] < FAILED:
        say(
            "An arm swings about its goal where measurements are later than its policy knows them: --randomise delay in"
            " training makes them a control period late, and up to 10 ms more."
        )
    _say_unshaped(arguments.policy)


def _by_kind(problems: Mapping[str, int]) -> dict[str, int]:
    """How often problems came that differ in their numbers alone, by the most frequent one of each kind."""
    kinds: dict[str, list[str]] = {}
    for problem in sorted(problems, key=lambda one: -problems[one]):
        kinds.setdefault(re.sub(r"[\d.]+", "#", problem), []).append(problem)
    return {same[0]: sum(problems[one] for one in same) for same in kinds.values()}


def _say_evaluated(folder: Path) -> None:
    """Say how well a policy does, as far as its run knows."""
    from reachlab.cli.console import note, say
    from reachlab.deploy.card import evaluated_with
    from reachlab.deploy.check import read_facts

    if reports := (facts := read_facts(folder))["held_out"]:
        told = f"success in {100 * reports[0]['success_rate']:.4g} % of {reports[0]['episodes']:,} episodes"
        say(f"Its run says: {', '.join(filter(None, (told, evaluated_with(facts))))}.")
    else:
        note("The policy was never evaluated: its training has not ended. Try it with reachlab eval before a robot.")


def _say_unshaped(folder: Path) -> None:
    """Say where a policy does not know the limits that its controller keeps."""
    from reachlab.cli.console import note
    from reachlab.deploy.check import read_facts

    settings = (facts := read_facts(folder))["settings"]
    if not settings["physics"]["shaping"]:
        varied = "objects sight delay" if facts.get("objects") else "dynamics delay lag"
        moved = settings["sim"] == "mujoco"
        scene = settings["rules"].get("scene") if moved else None
        asked = ["--task", settings["task"] if moved else "precise", "--robot", settings["robot"]]
        asked += ["--scene", *scene] if scene else []
        note(
            "The policy was trained without the limits of acceleration and jerk that its controller keeps, and may fail"
            f" within them: for a robot, train with {' '.join(map(quote, asked))} --shaping --randomise {varied}."
        )
