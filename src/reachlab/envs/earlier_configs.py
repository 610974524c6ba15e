"""Configurations as they were saved, by this version and by earlier ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from reachlab.settings.config import DistilRunConfig, RunConfig
from reachlab.settings.extensions import import_installed, import_remembered
from reachlab.settings.json_form import FORMAT, build
from reachlab.settings.validation import InputError, choose, hints
from reachlab.tasks import TASKS

Plain = dict[str, Any]
"""A configuration in its plain form."""


def from_json(data: Any) -> RunConfig:
    """Configuration of its plain form, of this version or an earlier one; what is missing has its default.

    Raises:
        InputError: a setting is unknown, of the wrong type or out of range, or the format is of a later version.
    """
    where = "the configuration"
    if not isinstance(data, Mapping):
        raise InputError(f"{where} must be an object of settings, got {type(data).__name__}.")
    plain = dict(data)
    written = plain.pop("format", 1)
    if not isinstance(written, int) or not 1 <= written <= FORMAT:
        raise InputError(f"{where} has format {written!r}, and this version reads 1 to {FORMAT}: install a newer one.")
    for older in range(written, FORMAT):
        plain = UPGRADES[older](plain)
    import_installed()
    if isinstance(names := plain.get("imports", ()), list) and all(isinstance(name, str) for name in names):
        import_remembered(tuple(names))
    task = plain.get("task", "tutorial")
    if not isinstance(task, str):
        raise InputError(f"task must be a name, got {task!r}.")
    try:
        kind = TASKS[choose("task", task, TASKS)].load()
    except InputError as error:
        raise InputError(f"{error} One of your own is imported first: by --import FILE, or in Python.") from None
    rules = build(kind, plain.get("rules", {}), f"{where}, rules,")
    return build(DistilRunConfig if "dagger" in plain else RunConfig, plain, where, rules=rules)


def _of_typed_tasks(plain: Plain) -> Plain:
    """Format 1 had all settings of all tasks in `rules`; with those of another task a run is now one of that task."""
    rules = plain.get("rules")
    if not isinstance(rules, Mapping) or not isinstance(plain.get("task"), str):
        return plain
    rules, task = dict(rules), plain["task"]
    turned = rules.get("targets") == "any" or rules.get("target_turn") is not None
    if task in ("tutorial", "precise") and (turned or (task == "tutorial" and rules.get("hold_steps"))):
        if task == "tutorial" and not rules.get("tool"):
            rules["tool"] = _tutorial_tool(plain)
        task = "pose" if turned else "precise"
    if task == "pose" and not turned:
        task = "precise"
    if task not in TASKS:
        return plain
    known = hints(TASKS[task].load())
    kept = {name: value for name, value in rules.items() if name in known}
    if kept.get("target_turn", ()) is None:
        del kept["target_turn"]
    return {**plain, "task": task, "rules": kept}


def _tutorial_tool(plain: Plain) -> str | None:
    """Tool frame of the tutorial's task, where a robot of the catalogue has one of its own for it."""
    from reachlab.robots.catalogue import ROBOTS

    known = ROBOTS.get(plain.get("robot", ""))
    return known.tools.get("wrist") if known else None


UPGRADES: dict[int, Callable[[Plain], Plain]] = {1: _of_typed_tasks}
"""By format what makes the next one of it."""
