"""The step of a policy and its motion limits as sources in C99."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import ShapeDtypeStruct

from reachlab.control.motion_limits import Motion, MotionLimits
from reachlab.deploy.c_library import OWN
from reachlab.deploy.onboard.aiming import NEARBY
from reachlab.deploy.onboard.controller import ASIDE
from reachlab.emit.behaviour import AFTER, Behaviour
from reachlab.emit.braced import c_declarations, c_function, c_numbers
from reachlab.emit.program import Program
from reachlab.emit.tracing import trace
from reachlab.runs.provenance import versions

FILES = ("reachlab_policy.h", "reachlab_policy.c", "main.c")
"""What is written; `main.c` is an example of how it is called."""


READ = frozenset({"q", "qd", "goal_position", "goal_quaternion", "goal_joints", "goal_velocity", "wrench"})
"""Inputs that it takes from a log."""


def motion_program(limits: MotionLimits) -> Program:
    """The program of `MotionLimits.advance` for one arm, in double precision."""
    with jax.enable_x64(True):
        n = ShapeDtypeStruct((limits.n,), jnp.float64)
        shapes = dict.fromkeys((*Motion._fields, "wanted"), n)
        shapes |= {"stop_step": ShapeDtypeStruct((limits.n,), jnp.int32), "brake": ShapeDtypeStruct((1,), jnp.bool_)}

        def advance(wanted: Any, brake: Any, **motion: Any) -> dict[str, Any]:
            moved = limits.advance(Motion(**motion), wanted, brake[0], xp=jnp)
            return {f"next_{name}": part for name, part in moved._asdict().items()}

        return trace("advance", advance, shapes)


def c_sources(facts: dict[str, Any], limits: MotionLimits, step: Behaviour) -> dict[str, str]:
    """Contents of `FILES` by name, for what `describe` says of a policy."""
    motion, decide = motion_program(limits), step.decide
    inputs = [one for one in decide.inputs if one.name not in OWN]
    fields = {
        name: f"{'int' if name == 'stop_step' else 'reachlab_real'} {name}[{limits.n}];" for name in Motion._fields
    }
    of_state = {name: f"state->{'position' if name == 'command' else name}" for name in OWN}
    decided = [of_state.get(one.name, f"input->{one.name}") for one in decide.inputs]
    memory = sum(len(one.atoms) for one in decide.outputs if one.name == AFTER)
    moved = [{"wanted": "wanted", "brake": "stops"}.get(one.name, f"state->{one.name}") for one in motion.inputs]
    moved += [f"next.{one.name.removeprefix('next_')}" for one in motion.outputs]
    programs = [decide, motion, *([step.place] if step.place else [])]
    text = {
        "title": f"{facts['task']} for {facts['robot']}".replace("*/", ""),
        "version": versions()["reachlab"],
        "joints": ", ".join(joint["name"] for joint in facts["joints"]).replace("*/", ""),
        "period": repr(facts["control_period"]),
        "commands": str(limits.n),
        "actions": str(len(decide.outputs[0].atoms)),
        "input": "\n".join(f"    {one};" for one in c_declarations(inputs, "reachlab_real")),
        "state": "\n".join(f"    {one}" for one in fields.values()),
        "functions": "\n".join(map(c_function, programs)),
        "lower": c_numbers(limits.lower),
        "upper": c_numbers(limits.upper),
        "home": ", ".join(map(repr, facts["arm"]["home"])),
        "rested": c_numbers(np.full(limits.n, limits.steps)),
        "checked": " && ".join(f"all_finite(input->{one.name}, {one.size})" for one in inputs if one.kind == "real"),
        "aside": repr(ASIDE),
        "decided": ", ".join(decided),
        "memory": f"\n    reachlab_real memory[{memory}];" if memory else "",
        "remembers": ", next.memory" if memory else "",
        "remembered": f" || !all_finite(next.memory, {memory})" if memory else "",
        "moved": ", ".join(moved),
        "refused": _refused([one.name for one in inputs if one.name not in READ]),
        "goal": "\n".join(" " * 8 + line for line in _example([one.name for one in inputs])),
    }
    text |= _outside(facts["goal"], [one.name for one in inputs])
    text |= _placing(step.place) if step.place else {"place": "", "placing": ""}
    return {name: _filled(name, text) for name in FILES}


def _placing(place: Program) -> dict[str, str]:
    """Declaration and definition of what puts a goal at a place."""
    about = (
        "/* The goal with joints near those of the arm that have it, exactly as they have it; 0 if there are none: then"
        " brake. */"
    )
    given = ", ".join(f"const {one}" for one in c_declarations(place.inputs, "reachlab_real"))
    head = f"\n{about}\nint reachlab_place({given}, reachlab_input *input)"
    passed = [one.name for one in place.inputs]
    passed += [one.name.replace("placed_", "input->goal_") for one in place.outputs]  # and `reached` as it is
    body = f"    int reached[1];\n    place({', '.join(passed)});\n    return reached[0];"
    return {"place": f"{head};\n", "placing": f"{head}\n{{\n{body}\n}}"}


def _outside(goal: dict[str, Any], names: Sequence[str]) -> dict[str, str]:
    """What the step does with a goal that is none of the policy's, and how the header says it; nothing without one.

    Of a policy whose goal may not be seen the place is that of the tool then.
    """
    if "goal_position" not in names or goal["hidden"]:
        return {"outside": "", "asked": ""}
    low, high = np.array(goal["low"]) - NEARBY, np.array(goal["high"]) + NEARBY
    between = " to ".join("(" + ", ".join(f"{one:.3f}" for one in corner) + ")" for corner in (low, high))
    return {
        "asked": f",\n * or the goal is not in the box from {between} m",
        "outside": (
            "    if (problem == REACHLAB_OK && !brake) {\n"
            f"        static const real low[3] = {c_numbers(low)}, high[3] = {c_numbers(high)};\n"
            "        for (int i = 0; i < 3; ++i)\n"
            "            if (input->goal_position[i] < low[i] || input->goal_position[i] > high[i])"
            " problem = REACHLAB_OUTSIDE;\n"
            "    }\n"
        ),
    }


def _refused(names: Sequence[str]) -> str:
    """What the example does where a log does not have these inputs as they are."""
    if not names:
        return ""
    told = f"this example does not read {', '.join(names)}: fill them into reachlab_input in a loop of your own"
    return f'    fprintf(stderr, "{told}\\n");\n    return 2;\n'


def _example(names: Sequence[str]) -> list[str]:
    """How the example fills in a goal and what is felt."""
    felt = ['brake |= numbers(line, "wrench", input.wrench, 6) != 6;'] * ("wrench" in names)
    if "goal_joints" in names:
        place = "goal, goal + 3" if "goal_quaternion" in names else "goal"
        return [
            "static reachlab_real before[7];",
            "static int placed;",
            f"if (memcmp(before, goal, sizeof goal)) placed = reachlab_place(state.position, {place}, &input);",
            "memcpy(before, goal, sizeof goal);",
            "brake |= !placed;",
            *felt,
        ]
    lines = ["memcpy(input.goal_position, goal, sizeof input.goal_position);"]
    if "goal_velocity" in names:
        lines.append('numbers(line, "velocity", input.goal_velocity, 3);')
    return lines + felt


def _filled(name: str, text: dict[str, str]) -> str:
    content = (Path(__file__).parent / "c" / name).read_text(encoding="utf-8")
    for key, value in text.items():
        content = content.replace("{{" + key + "}}", value)
    return content
