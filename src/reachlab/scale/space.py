"""The settings that a sweep varies, read from a TOML file."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from reachlab.envs.consistency import check_names
from reachlab.envs.uses import MILD, unused, users
from reachlab.robots.loading import load_robot
from reachlab.settings.config import RunConfig
from reachlab.settings.json_form import flatten, override, to_json
from reachlab.settings.reading import MOST_TEXT, read_regular
from reachlab.settings.validation import InputError

TABLE = "space"
"""Table of the file that holds the settings."""

EXAMPLE = "learning_rate = { low = 1e-5, high = 3e-3, log = true }"
"""What an entry looks like."""


class Dimension(NamedTuple):
    """A setting that varies: within limits, or among choices if there are any."""

    name: str
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    whole: bool = False
    choices: tuple[Any, ...] = ()


def read_space(path: Path, config: RunConfig) -> dict[str, Any]:
    """What a file says of the settings that vary, in plain form; see `dimensions`.

    Raises:
        InputError: it cannot be read, or says nothing of any.
    """
    try:
        data = tomllib.loads(read_regular(path, MOST_TEXT)[0].decode())
    except OSError as error:
        raise InputError(f"space '{path}' cannot be read: {error.strerror or error}.") from None
    except RecursionError:
        raise InputError(f"space '{path}' nests lists or tables too deep.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"space '{path}' is no TOML file: {error}.") from None
    space = data.get(TABLE)
    if not isinstance(space, dict) or not space or len(data) > 1:
        raise InputError(f"space '{path}' must hold the table [{TABLE}] alone, with an entry a setting, as {EXAMPLE}")
    dimensions(space, config)
    return space


def dimensions(space: Mapping[str, Any], config: RunConfig) -> list[Dimension]:
    """The settings that vary; limits and choices are checked like flags.

    Raises:
        InputError: a name that is no setting, or values that are not allowed.
    """
    if not space:
        raise InputError(f"space must name a setting that varies, as {{'learning_rate': [1e-3, 3e-3]}}, got {space!r}.")
    idle = unused(flatten(to_json(config)))
    for name in space:
        if (choice := idle.get(name)) and choice not in space and choice not in MILD:
            sentence = f"space varies {name}, which has an effect only with {users(name, choice)}"
            raise InputError(f"{sentence}: leave it out, or choose that.")
    return [_dimension(name, entry, config) for name, entry in space.items()]


def _dimension(name: str, entry: Any, config: RunConfig) -> Dimension:
    if name == "task":
        raise InputError("space varies task, whose settings are others: sweep each of them by itself.")
    if name == "seed":
        raise InputError("space varies seed, which is no setting to choose: take several seeds of each with --seeds.")
    if isinstance(entry, list):
        choices = [_choice(name, tuple(one) if isinstance(one, list) else one, config) for one in entry]
        if len(set(choices)) < 2:
            raise InputError(f"space has fewer than two choices for {name}: leave it out, and set it by its flag.")
        return Dimension(name, choices=tuple(choices))
    if not isinstance(entry, dict) or not {"low", "high"} <= set(entry) <= {"low", "high", "log"}:
        raise InputError(f"space must give {name} limits or a list of choices, as {EXAMPLE}")
    low, high, log = entry["low"], entry["high"], entry.get("log", False)
    numbers = all(isinstance(limit, int | float) and not isinstance(limit, bool) for limit in (low, high))
    if not numbers or not isinstance(log, bool):
        raise InputError(
            f"space must give {name} a list of choices, as its values are no numbers, or log true or false."
        )
    if not low < high or (log and low <= 0):
        above = " above 0" if log else ""
        raise InputError(f"space must give {name} a low{above} below its high, got {low} and {high}.")
    for limit in (low, high):
        override(config, **{name: limit})
    now = flatten(to_json(config)).get(name)
    whole = isinstance(now, int) and isinstance(low, int) and isinstance(high, int)
    return Dimension(name, low, high, log, whole)


def _choice(name: str, choice: Any, config: RunConfig) -> Any:
    """A choice as the settings have it: a robot's file by its absolute path, wherever the sweep is resumed."""
    # What it names has to be there; what it contradicts alone may fit other choices.
    check_names(chosen := override(config, **{name: choice}))
    if name != "robot":
        return choice
    load_robot(chosen.robot)
    return chosen.robot


def size(space: Sequence[Dimension]) -> float:
    """How many settings a space holds; infinity where one of them is a real number."""
    return math.prod(len(one.choices) or (one.high - one.low + 1 if one.whole else math.inf) for one in space)


def label(choice: Any) -> str:
    """A choice as the study writes it down."""
    return json.dumps(choice)
