"""The Python reference: directives of autodoc for every public name, and for the records that they take and give."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import reachlab

RECORDS = (
    "tasks.tutorial.Tutorial",
    "settings.config.SimConfig",
    "settings.config.LoopConfig",
    "settings.config.LearnerConfig",
    "settings.config.PPOConfig",
    "settings.config.DistilRunConfig",
    "settings.config.DaggerConfig",
    "robots.kinematics.forward.Pose",
    "robots.kinematics.inverse.IKSolution",
    "envs.functions.EnvState",
    "envs.functions.Transition",
    "watch.video.Clip",
    "scale.sweep.SweepResult",
)
"""What public functions take and give beside public names; it is imported from its module."""


def _entry(name: str, kind: str) -> str:
    """Heading and directive of one name, given below the package."""
    members = (
        "   :members:\n   :undoc-members:\n" if name == "RunConfig" else "   :members:\n" if kind == "class" else ""
    )
    return f"### `{name.rpartition('.')[2]}`\n\n```{{eval-rst}}\n.. auto{kind}:: reachlab.{name}\n{members}```\n"


def _reference() -> str:
    names = {name: getattr(reachlab, name) for name in reachlab.__all__}
    functions = [_entry(name, "function") for name, one in names.items() if not inspect.isclass(one)]
    classes = [
        _entry(name, "class") for name, one in names.items() if inspect.isclass(one) and one is not reachlab.InputError
    ]
    errors = [_entry("InputError", "exception")]
    records = [_entry(name, "class") for name in RECORDS]
    parts = {"Functions": functions, "Classes": classes + errors, "Records that they take and give": records}
    return "\n".join(f"## {heading}\n\n" + "\n".join(entries) for heading, entries in parts.items())


REFERENCE: dict[str, Callable[[], str]] = {"python reference": _reference}
"""The function that gives the reference, by its name."""
