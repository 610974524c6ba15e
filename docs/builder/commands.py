"""Tables of the command line's flags, from the dataclasses that they are made of."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import tyro

from builder.docstrings import field_docstrings
from builder.markdown import code, table
from reachlab.cli.flags import Train
from reachlab.cli.sweep_flags import Sweep
from reachlab.cli.verbs import VERBS
from reachlab.envs.presets import preset
from reachlab.settings.config import RunConfig
from reachlab.settings.validation import hints
from reachlab.tasks import TASKS


@dataclass(frozen=True)
class Flag:
    """A flag, or a word without one: how it is written, its default, what it is, and the heading of its group."""

    written: str
    default: str
    text: str
    group: str


def flags(cls: type, default: Any, group: str = "") -> Iterator[Flag]:
    """Flags of a dataclass, those of the dataclasses in it after its own."""
    parts = []
    for entry in dataclasses.fields(cls):
        kind, told, positional = _annotation(hints(cls)[entry.name])
        if entry.name == "imports":
            continue  # a run notes it for itself, of --import
        value = getattr(default, entry.name, entry.default)
        if entry.default_factory is not dataclasses.MISSING and value is dataclasses.MISSING:
            value = entry.default_factory()
        if dataclasses.is_dataclass(value):
            inner = type(value)
            if inner is RunConfig and cls is not Train:
                continue  # said of `train`
            parts.append((inner, value, group if told.get("name") == "" else inner.__doc__ or ""))
            continue
        text = told.get("help") or field_docstrings(cls).get(entry.name, "")
        yield Flag(_written(entry.name, kind, positional, value), _value(value), text, group)
    for inner, value, heading in parts:
        yield from flags(inner, value, heading)


def _annotation(hint: Any) -> tuple[Any, dict[str, Any], bool]:
    """Kind of a field, what tyro is told of it, and whether it is given without a flag."""
    marks = getattr(hint, "__metadata__", ())
    kind = hint.__origin__ if marks else hint
    told = {key: value for mark in marks for key, value in vars(mark).items() if value is not None} if marks else {}
    return kind, told, any(mark is tyro.conf.Positional for mark in marks)


def _written(name: str, kind: Any, positional: bool, default: Any) -> str:
    """How a flag is written; of a truth value that is true by default both of its two flags."""
    if positional:
        return name.upper()
    flag = name.replace("_", "-")
    return f"--{flag} / --no-{flag}" if kind is bool and default else f"--{flag}"


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or value is dataclasses.MISSING or value == ():
        return "–"
    words = [
        f"{one:.6g}" if isinstance(one, float) else str(one) for one in (value if isinstance(value, tuple) else [value])
    ]
    return code(" ".join(words))


def _command(verb: str) -> str:
    """What a verb does, and a table of flags for each group."""
    cls = VERBS[verb].flags
    groups: dict[str, list[Flag]] = {}
    for flag in flags(cls, cls(run=preset()) if cls is Train else None):
        groups.setdefault(flag.group, []).append(flag)
    if cls is Train:
        groups |= _of_other_tasks()
    text = f"{(cls.__doc__ or '').strip()}\n"
    if cls is Sweep:
        text += "\nAll settings of `reachlab train` are flags too, and hold for every training.\n"
    for heading, members in groups.items():
        rows = [[code(flag.written), flag.default, flag.text] for flag in members]
        text += f"\n{heading}\n\n{table(['flag', 'default', 'what it is'], rows)}"
    return text


def _of_other_tasks() -> dict[str, list[Flag]]:
    """Flags that each task has beside those of the tasks before it."""
    groups: dict[str, list[Flag]] = {}
    known: set[str] = set()
    for task in TASKS:
        rules = preset(task).rules
        group = f"Settings that task `{task}` has too."
        groups[group] = [flag for flag in flags(type(rules), rules, group) if flag.written not in known]
        known |= {flag.written for flag in groups[group]}
    return {group: members for group, members in list(groups.items())[1:] if members}


def _commands() -> str:
    rows = [[f"[`reachlab {verb}`](#reachlab-{verb})", entry.flags.__doc__ or ""] for verb, entry in VERBS.items()]
    return table(["command", "what it does"], rows)


def _every_command() -> str:
    return "\n".join(f"## `reachlab {verb}`\n\n{_command(verb)}" for verb in VERBS)


COMMANDS: dict[str, Callable[[], str]] = {"commands": _commands, "every command": _every_command}
"""Functions that give a table of all commands, and the reference of each, by name."""
