"""Configurations changed, compared and as plain data: what `config.json` holds."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

from reachlab.settings.config import RunConfig
from reachlab.settings.validation import InputError, choose, hints

Config = TypeVar("Config", bound=RunConfig)


def override(config: Config, /, **settings: Any) -> Config:
    """A configuration with the named settings changed.

    Raises:
        InputError: a name that is no setting, or a value that is not allowed.
    """
    sections = _sections(config)
    for name in settings:
        choose("setting", name, sections)
    changed: dict[str | None, dict[str, Any]] = {}
    for name, value in settings.items():
        changed.setdefault(sections[name], {})[name] = value
    top = changed.pop(None, {})
    nested = {part: dataclasses.replace(getattr(config, part), **values) for part, values in changed.items() if part}
    return dataclasses.replace(config, **top, **nested)


def _sections(config: RunConfig) -> dict[str, str | None]:
    """For every setting but the preset's name, the part of `RunConfig` that holds it; None for itself."""
    sections: dict[str, str | None] = {}
    for outer in dataclasses.fields(config):
        value = getattr(config, outer.name)
        if dataclasses.is_dataclass(value):
            sections |= dict.fromkeys((inner.name for inner in dataclasses.fields(value)), outer.name)
        elif outer.name != "task":
            sections[outer.name] = None
    return sections


def difference(one: RunConfig, other: RunConfig) -> tuple[str, Any, Any] | None:
    """Name of the first setting in which two configurations differ, and both values; None if they are the same."""
    here, there = flatten(to_json(one)), flatten(to_json(other))
    return next(((name, here[name], there.get(name)) for name in here if here[name] != there.get(name)), None)


FORMAT = 2
"""Version of the plain form."""


def to_json(config: RunConfig) -> dict[str, Any]:
    """Plain form of the config, for `json.dump`."""
    return {"format": FORMAT, **dataclasses.asdict(config)}


def flatten(plain: Mapping[str, Any]) -> dict[str, Any]:
    """Every setting of a config's plain form by name, whatever part holds it."""
    flat: dict[str, Any] = {}
    for name, value in plain.items():
        flat |= value if isinstance(value, dict) else {name: value}
    flat.pop("format", None)
    return flat


def build(cls: type, data: Any, where: str, **known: Any) -> Any:
    """A dataclass of its plain form; what is missing has its default. Fields that are `known` are taken as they are.

    Raises:
        InputError: a field is unknown, of the wrong type or out of range.
    """
    if not isinstance(data, Mapping):
        raise InputError(f"{where} must be an object of settings, got {type(data).__name__}.")
    fields = hints(cls)
    if unknown := sorted(set(data) - set(fields)):
        raise InputError(f"{where} holds an unknown setting {unknown[0]!r}.")
    values = dict(known)
    for name in data.keys() - known.keys():
        value = data[name]
        if dataclasses.is_dataclass(fields[name]):
            values[name] = build(typing.cast("type", fields[name]), value, f"{where}, {name},")
        else:
            values[name] = value
    return cls(**values)
