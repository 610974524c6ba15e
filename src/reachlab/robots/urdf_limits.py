"""Limits of a URDF's joints: those that make no sense are refused, and soft ones are kept."""

from __future__ import annotations

from collections import defaultdict

from reachlab.robots.safe_xml import Element, numbers
from reachlab.settings.validation import InputError

NONE = "Position limits from 0 to 0 are taken as none, so a turn or a metre either way"
SOFT = "Position limits are narrowed to the soft limits of safety_controller"

Noted = defaultdict[str, list[str]]
"""Names of joints by what is noted of their limits, `NONE` or `SOFT`."""


def rewrite_limits(joint: Element, what: str, noted: Noted) -> tuple[float | None, float | None]:
    """Speed and torque limit of a joint, None where it is absent or 0; its position limits become the soft ones.

    Args:
        joint: it is changed in place.
        what: the joint and its file, as an error names them.
        noted: is filled.

    Raises:
        InputError: a limit is negative, or the position limits leave no way to move.
    """
    limit = joint.find("limit")
    if limit is None:
        return None, None
    if joint.get("type") in ("revolute", "prismatic"):
        _narrow(joint, limit, what, noted)
    most = {key: numbers(limit.get(key), 1)[0] for key in ("velocity", "effort")}
    for key, value in most.items():
        if value < 0.0:
            raise InputError(f"{what} has {key}={value:g}, but a limit is a positive number: leave its sign out.")
    if not most["effort"]:
        limit.attrib.pop("effort", None)
    return most["velocity"] or None, most["effort"] or None


def _narrow(joint: Element, limit: Element, what: str, noted: Noted) -> None:
    low, high = (numbers(limit.get(key), 1)[0] for key in ("lower", "upper"))
    if low == high == 0.0:
        noted[NONE].append(joint.get("name", ""))
        return
    if low >= high:
        raise InputError(f"{what} has the position limits {low:g} to {high:g}: the upper one has to be the larger one.")
    safety = joint.find("safety_controller")
    stated = {} if safety is None else safety.attrib
    soft_low, soft_high = (
        numbers(stated.get(f"soft_{key}_limit"), 1, hard)[0] for key, hard in (("lower", low), ("upper", high))
    )
    if soft_low == soft_high == 0.0:
        return  # as URDF writes that there are none
    if max(low, soft_low) >= min(high, soft_high):
        raise InputError(
            f"{what} has the position limits {low:g} to {high:g} and the soft limits {soft_low:g} to {soft_high:g},"
            " which leave no way to move: correct its <safety_controller>."
        )
    if soft_low > low or soft_high < high:
        limit.set("lower", repr(max(low, soft_low)))
        limit.set("upper", repr(min(high, soft_high)))
        noted[SOFT].append(joint.get("name", ""))
