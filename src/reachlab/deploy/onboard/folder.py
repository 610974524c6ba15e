"""An exported folder, read with care: its parts belong together, and its limits are no wider than those exported."""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

FORMAT = 3
"""Of `policy.json`. In format 1 each limit stood twice, and none was protected; before 3 there was no `step.py`, and
the controller itself held every formula."""

LIMITS = ("lower", "upper", "speed", "acceleration", "jerk")
"""Limits of a joint."""

FREE = ("limits", "sha256")
"""What the fingerprint of `policy.json` leaves out: the limits, which may be lowered, and the fingerprint."""


MOST = 2**28
"""Largest file of an exported folder [bytes]."""


def content_of(file: Path) -> bytes:
    """The bytes of a file of an exported folder; a pipe or a device is not waited for.

    Raises:
        OSError: it cannot be read, is not a regular file or is larger than `MOST`.
    """
    if file.exists() and not file.is_file():
        raise OSError(f"'{file}' is not a regular file")
    with file.open("rb") as opened:
        content = opened.read(MOST + 1)
    if len(content) > MOST:
        raise OSError(f"'{file}' is larger than {MOST >> 20} MB")
    return content


def fingerprint(facts: dict[str, Any]) -> str:
    """SHA-256 of the content of `policy.json` but for its limits, however its text is laid out."""
    kept = json.dumps({name: value for name, value in facts.items() if name not in FREE})
    plain = json.loads(kept, parse_int=_number, parse_float=_number)
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def _number(text: str) -> float:
    """A number of which some editors write 1.0 as 1, and -0.0 as 0."""
    return float(text) + 0.0


def read_folder(folder: Path) -> dict[str, Any]:
    """Content of the `policy.json` of an exported folder, in today's form.

    Raises:
        ValueError: it cannot be read, the folder's parts are of different exports or were changed, or a limit is wider
            than the one that was exported.
    """
    file = folder / "policy.json"
    try:
        facts = json.loads(content_of(file))
        known = facts["format"] in range(1, FORMAT + 1)
    except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
        why = (error.strerror if isinstance(error, OSError) else "") or repr(error)
        raise ValueError(
            f"'{file}' cannot be read as what `reachlab export` wrote ({why}): name a folder that it wrote."
        ) from None
    if not known:
        raise ValueError(
            f"'{file}' has format {facts['format']!r}, and formats 1 to {FORMAT} are read here: use the controller.py"
            " of its own folder, or export again."
        )
    try:
        if facts["format"] == 1:
            facts = _from_format_1(facts)
        elif fingerprint(facts) != facts["sha256"]:
            raise ValueError(
                f"'{file}' was changed beside its `limits`, the only part that may be: copy the exported folder again,"
                " or export again."
            )
        _check_files(folder, facts["files"])
        check_limits(file, facts)
    except (AttributeError, LookupError, TypeError, OSError) as error:
        raise ValueError(f"'{file}' is not complete ({error!r}): copy the exported folder again.") from None
    return facts


def _check_files(folder: Path, files: dict[str, str]) -> None:
    """Refuse a file that was not exported together with `policy.json`; one that is not needed may be absent."""
    for name, expected in files.items():
        file = folder / name
        if file.exists() and hashlib.sha256(content_of(file)).hexdigest() != expected:
            raise ValueError(
                f"'{file}' is not the file that was exported with the policy.json beside it: the folder is made of"
                " different exports, or the file was changed; copy the whole folder again."
            )


def check_limits(file: Path, facts: dict[str, Any]) -> None:
    """Refuse limits from a file that are not those of the joints, or wider than what was exported.

    Raises:
        ValueError: they are.
        AttributeError, LookupError, TypeError: they are not complete.
    """
    limits, names = facts["limits"], [joint["name"] for joint in facts["joints"]]
    if sorted(limits) != sorted(names):
        raise ValueError(f"`limits` in '{file}' must be those of the joints {', '.join(names)}, got {list(limits)}.")
    for joint in facts["joints"]:
        if wrong := _wrong_limits(limits[joint["name"]], joint["widest"]):
            raise ValueError(
                f"`limits` of joint {joint['name']!r} in '{file}': {wrong} Limits may be lowered there, never widened."
            )


def limits_of(facts: dict[str, Any], *, widest: bool = False) -> dict[str, np.ndarray]:
    """Limits `[n]` by name that `policy.json` says: those that hold, or those that were exported."""
    rows = [joint["widest"] if widest else facts["limits"][joint["name"]] for joint in facts["joints"]]
    return {name: np.array([row[name] for row in rows], float) for name in LIMITS}


def _wrong_limits(limits: dict[str, Any], widest: dict[str, float]) -> str:
    """What is wrong with the limits of a joint, empty where nothing is."""
    if set(limits) != set(LIMITS):
        return f"they must be {', '.join(LIMITS)}, got {', '.join(limits)}."
    for name, value in limits.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < math.inf:
            return f"{name} must be a finite number, got {value!r}."
        if name in ("lower", "upper"):
            if not widest["lower"] <= value <= widest["upper"]:
                return f"{name} must be {widest['lower']:.6g} to {widest['upper']:.6g}, got {value!r}."
        elif not 0.0 < value <= widest[name]:
            return f"{name} must be above 0 and at most {widest[name]:.6g}, got {value!r}."
    return "" if limits["lower"] < limits["upper"] else "lower must be below upper."


def _from_format_1(facts: dict[str, Any]) -> dict[str, Any]:
    """Facts in today's form: of limits that stood at the joint and at the arm, the lower one holds."""
    arm, limits, joints = facts["arm"], {}, []
    for i, joint in enumerate(facts["joints"]):
        one = {name: joint[name] for name in LIMITS}
        one["lower"] = max(one["lower"], arm["lower"][i])
        one["upper"], one["speed"] = (min(one[name], arm[name][i]) for name in ("upper", "speed"))
        limits[joint["name"]] = one
        joints.append({**joint, "widest": one})
    return {**facts, "limits": limits, "joints": joints}
