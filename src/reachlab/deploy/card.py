"""The model card of an exported policy, in the form of the Hugging Face Hub."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from reachlab.deploy.surroundings import ASIDE
from reachlab.robots.derive.frame import Frame

EXAMPLE = """```python
from controller import Controller

controller = Controller(".")
controller.reset(controller.home)  # joints of the arm, at rest
q, qd = controller.home, 0 * controller.home  # what is measured: here an arm that follows at once
for step in range({steps}):
    command = controller.step(q, qd, {goal}, step * controller.period{beside})
    q, qd = command, (command - q) / controller.period
print(dict(zip(controller.joints, command.round(3).tolist())), controller.problem or "no problem")
print(f"{{controller.arrival.distance:.4f}} m from the goal")
```"""


PLANNER = (
    "| `planner.py` | plans where the policy does not get through; a process that needs MuJoCo, OMPL and TOPP-RA |"
)
"""Row of the planner among the files."""

MET = "episodes in which links of the arm touched at any step, by the shapes in its file (meshes by their hulls)"
"""What the share of self-contact is."""


def model_card(facts: dict[str, Any]) -> str:
    """Content of `README.md`, of what `policy.json` says."""
    title = f"{facts['task']} for {facts['robot']}"
    return "\n".join([_metadata(facts, title), f"# {title}", "", *_sections(facts)]) + "\n"


def _metadata(facts: dict[str, Any], title: str) -> str:
    """The block of metadata, in YAML."""
    lines = ["---", "library_name: reachlab", "pipeline_tag: robotics", "tags:"]
    lines += [
        f"- {_yaml(tag)}" for tag in ("robotics", "reinforcement-learning", "onnx", facts["robot"], facts["task"])
    ]
    if facts["held_out"] and not facts.get("evaluated_with"):
        report = facts["held_out"][0]
        result = {
            "task": {"type": "reinforcement-learning", "name": facts["task"]},
            "dataset": {"name": f"held-out goals of seed {report['seed']}, {report['sim']}", "type": facts["task"]},
            "metrics": [{"type": "success_rate", "value": report["success_rate"], "name": "success rate"}],
        }
        lines.append(f"model-index: {_yaml([{'name': title, 'results': [result]}])}")
    return "\n".join([*lines, "---", ""])


def _yaml(value: Any) -> str:
    """JSON that is YAML too, which has no surrogates, and allows no other character that cannot be printed."""
    text = json.dumps(value, ensure_ascii=False)
    return "".join(one if one.isprintable() else f"\\U{ord(one):08x}" for one in text)


def _sections(facts: dict[str, Any]) -> list[str]:
    goal = facts["goal"]
    numbers = "position [m] and quaternion wxyz" if goal["orientation"] else "position [m]"
    low, high = (", ".join(f"{value:.3g}" for value in goal[side]) for side in ("low", "high"))
    middle = [round((a + b) / 2, 3) for a, b in zip(goal["low"], goal["high"], strict=True)]
    held = facts["arm"]["held_quaternion"] if goal["orientation"] else []
    lines = [
        (
            f"What is asked: {goal['asks']}. The goal is the {numbers} of `{goal['tool']}` in"
            f" {Frame(**goal['base']).in_words()}, between ({low}) and ({high}) m."
        ),
        "",
        "| file | what it is |",
        "| --- | --- |",
        "| `controller.py` | runs the policy with NumPy alone (Python ≥ 3.9), within the limits below |",
        *([PLANNER] if "planner" in facts else []),
        "| `step.py` | its decision as straight code: observation, network, action, control; printed from training's |",
        "| `reachlab_policy.c`, `.h`, `main.c` | the same step and limits in C99, and an example |",
        "| `policy.onnx` | the network, with normaliser and clipping inside |",
        "| `policy.safetensors` | the same weights by name |",
        "| `policy.json` | `limits`, which may be lowered; fixed: observation, action, arm, settings, hashes |",
        "",
        "## Example",
        "",
        EXAMPLE.format(steps=round(2 / facts["control_period"]), goal=[*middle, *held], beside=_beside(facts, middle)),
        "",
        "## Held-out figures",
        "",
    ]
    if not facts["held_out"]:
        lines.append("None: the run was not evaluated.")
    else:
        lines += [
            "| simulator | varied | episodes, seed | success | 95 % interval | median error | links met |",
            "| --- " * 7 + "|",
        ]
    for report in facts["held_out"]:
        low, high = report["success_interval"]
        error, met = report["final_error_mm"]["median"], report.get("self_contact")
        lines.append(
            f"| {report['sim']} | {', '.join(report['randomised']) or 'nothing'} | {report['episodes']:,},"
            f" {report['seed']} | {100 * report['success_rate']:.2f} % | {100 * low:.1f} to {100 * high:.1f} |"
            f" {'not held' if error is None else f'{error:.3g} mm'} | {'' if met is None else f'{100 * met:.2f} %'} |"
        )
    if any(report.get("self_contact") is not None for report in facts["held_out"]):
        lines += ["", f"Links met: {MET}."]
    if told := evaluated_with(facts):
        lines += ["", f"They are {told}. Evaluate what this export asks for before it is used."]
    return [*lines, "", *_limits(facts)]


def evaluated_with(facts: dict[str, Any]) -> str:
    """Of what held-out figures are, where it is not all that is exported; empty where it is, or there are none."""
    parts = ["of the policy alone, without its planner"] * ("planner" in facts)
    if other := facts.get("evaluated_with"):
        was = [" ".join(map(str, (name, *np.atleast_1d(one)))) for name, one in other.items()]
        parts.append(f"not of what is asked for here: with {', '.join(was)}")
    if not facts["settings"]["physics"]["shaping"]:
        parts.append("without the limits of acceleration and jerk that the controller keeps")
    return ", and ".join(parts) if facts["held_out"] else ""


def sees(facts: dict[str, Any]) -> bool:
    """Whether the policy has to be told of bodies beside the arm."""
    return facts["inputs"].get("bodies_kind", [0]) != [len(facts.get("objects", []))]


def _beside(facts: dict[str, Any], place: Sequence[float]) -> str:
    """What the example's step is told of beside the arm: one small body at its side; an object at a place."""
    told: dict[str, Any] = dict(ASIDE) if sees(facts) else {}
    if objects := [{"position": list(place), "velocity": [0.0, 0.0, 0.0]}] * len(facts.get("objects", [])):
        told["objects"] = objects
    return "".join(f", {name}={json.dumps(bodies)}" for name, bodies in told.items())


def _limits(facts: dict[str, Any]) -> list[str]:
    knows = "the arm's joints" + ", and the bodies that it is told of" * sees(facts)
    rows = [
        f"| `{one['name']}` | {one['widest']['lower']:.4g} to {one['widest']['upper']:.4g} {one['unit']},"
        f" {one['sources']['position']} | "
        + " | ".join(f"{one['widest'][what]:.4g}, {one['sources'][what]}" for what in ("speed", "acceleration", "jerk"))
        + " |"
        for one in facts["joints"]
    ]
    return [
        "## Limits",
        "",
        (
            f"Commands are {1 / facts['control_period']:.4g} Hz joint positions, and keep these limits whatever is"
            " measured or asked; a `default` was chosen by reachlab and is not the maker's. These are the limits that"
            " were exported. Those that `controller.py` keeps are `limits` in `policy.json`: lower them there, for a"
            " careful first run. The C source has those of the export compiled in: `reachlab export --limits"
            " policy.json --out another` writes it with lowered ones. Limits that are wider than these, any other"
            " change of `policy.json`, and files of another export are refused when the folder is loaded."
        ),
        "",
        "| joint | position | speed [/s] | acceleration [/s²] | jerk [/s³] |",
        "| --- " * 5 + "|",
        *rows,
        "",
        "## Limits of use",
        "",
        (
            f"Trained and judged in simulation alone. The controller knows {knows}, not what is around it: it"
            " does not see people, tables or cables, does not keep the arm's links from each other, does not measure"
            " forces, and is no safety function in the sense of any standard. Keep the arm's own limits, its emergency"
            " stop and a fence."
        ),
    ]
