"""Rows of measurements, the table that is made of them, and the machine that they were taken on."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from reachlab.runs.provenance import versions

Row = dict[str, Any]
"""A measurement: name, value, unit, config."""

THOUSAND = 1000
"""From here on tables show numbers without decimals."""


def row(name: str, value: float, unit: str, **config: object) -> Row:
    """A measurement."""
    return {"name": name, "value": float(value), "unit": unit, "config": config}


def to_markdown(rows: Sequence[Row]) -> str:
    """Table of measurements: what is called `a/b` stands in line `a` and column `b`; with the machine and versions."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for one in rows:
        line, _, column = one["name"].partition("/")
        cells.setdefault((line, one["unit"]), {})[column] = cell(one)
    columns = list(dict.fromkeys(column for line in cells.values() for column in line))
    lines = [["", *columns], ["---", *["---:"] * len(columns)]]
    for (line, unit), values in cells.items():
        name = line if unit == "rate" else f"{line} [{unit}]"
        lines.append([name, *[values.get(column, "–") for column in columns]])
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    brackets = " In brackets: the lowest seed." if any("lowest_seed" in one["config"] for one in rows) else ""
    made = ", ".join(f"{name} {number}" for name, number in versions().items() if name != "machine")
    return f"{table}\n\nOn {machine()}; {made}.{brackets}\n"


def cell(one: Row) -> str:
    """A measurement's value, as people read it."""
    if one["unit"] != "rate":
        return f"{one['value']:.3g}" if abs(one["value"]) < THOUSAND else f"{one['value']:,.0f}"
    lowest = one["config"].get("lowest_seed")
    return f"{100 * one['value']:.2f} %" + (f" ({100 * lowest:.2f})" if lowest is not None else "")


def settings(one: Row) -> str:
    """What a measurement was taken with, as people read it."""
    return ", ".join(f"{name} {value}" for name, value in one["config"].items())


def machine() -> str:
    """The machine in words: its cores, processor and system."""
    return f"{os.cpu_count()} cores of {_processor()}, {versions()['machine']}"


def _processor() -> str:
    """Name of the processor, or its architecture where the system does not tell."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text(encoding="utf-8").splitlines() if information.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(iter(names), platform.machine())
