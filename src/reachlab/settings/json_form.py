"""Configurations changed, compared and as plain data: what `config.json` holds."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

from reachlab.settings.config import DistilRunConfig, RunConfig
from reachlab.settings.validation import InputError, choose, hints

Config = TypeVar("Config", bound=RunConfig)


def override(config: Config, **settings: Any) -> Config:
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


def difference(one: object, other: object) -> tuple[str, Any, Any] | None:
    """Name of the first setting in which two configurations differ, and both values; None if they are the same."""
    for entry in dataclasses.fields(typing.cast("Any", one)):
        a, b = getattr(one, entry.name), getattr(other, entry.name, None)
        if dataclasses.is_dataclass(a):
            if found := difference(a, b):
                return found
        elif a != b:
            return entry.name, a, b
    return None


def to_json(config: RunConfig) -> dict[str, Any]:
    """Plain form of the config, for `json.dump`."""
    return dataclasses.asdict(config)


def flatten(plain: Mapping[str, Any]) -> dict[str, Any]:
    """Every setting of a config's plain form by name, whatever part holds it."""
    flat: dict[str, Any] = {}
    for name, value in plain.items():
        flat |= value if isinstance(value, dict) else {name: value}
    return flat


def from_json(data: Any) -> RunConfig:
    """Config from its plain form; every field must be there, and no other.

    Raises:
        InputError: a field is missing, unknown, of the wrong type or out of range.
    """
    kind = DistilRunConfig if isinstance(data, Mapping) and "dagger" in data else RunConfig
    return _build(kind, data, "the configuration")


def _build(cls: type, data: Any, where: str) -> Any:
    if not isinstance(data, Mapping):
        raise InputError(f"{where} must be an object of settings, got {type(data).__name__}.")
    fields = hints(cls)
    if unknown := sorted(set(data) - set(fields)):
        raise InputError(f"{where} holds an unknown setting {unknown[0]!r}.")
    if missing := sorted(set(fields) - set(data)):
        raise InputError(f"{where} has no setting {missing[0]!r}.")
    values = {}
    for name, value in data.items():
        if dataclasses.is_dataclass(fields[name]):
            values[name] = _build(typing.cast("type", fields[name]), value, f"{where}, {name},")
        else:
            values[name] = tuple(value) if isinstance(value, list) else value
    return cls(**values)
