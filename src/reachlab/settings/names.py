"""Names that the command line's help lists, of things that live in modules too heavy for it to load."""

from __future__ import annotations

AGENTS = ("trained", "random", "zero", "ik", "ik_open")
"""Agents, in the order of `evaluation.AGENTS`."""

SUITES = (
    "speed",
    "kinematics",
    "learning",
    "start",
    "simulators",
    "precise",
    "soak",
    "trust",
    "camera",
    "pixels",
)
"""Suites of measurements, in the order of `bench.SUITES`."""
